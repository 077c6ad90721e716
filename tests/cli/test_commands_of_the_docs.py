"""Every `deepmf-sumo ...` in README, docs and their example files is a command that exists."""

import re
import shlex
from pathlib import Path

import click
import pytest

from deepmf_sumo.cli import main

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / "README.md",
    *sorted(path for path in (ROOT / "docs").rglob("*") if path.suffix in {".md", ".yml"}),
    *sorted(path for path in (ROOT / "studies").rglob("*") if path.suffix in {".md", ".yaml"}),
]
_COMMAND = re.compile(r"(?<![\w/.-])deepmf-sumo( [^`\n;&|>]*)")


def commands_of(text):
    """The arguments of all commands in code blocks, in code between backquotes and in comments."""
    joined = text.replace("\\\n", " ")
    code = [
        *re.findall(r"```[^\n]*\n(.*?)```", joined, re.DOTALL),
        *re.findall(r"`([^`\n]+)`", joined),
    ]
    for piece in code:
        for found in _COMMAND.finditer(piece):
            yield shlex.split(re.sub(r"[\[\]]", "", found[1]).replace("'", ""), comments=True)


def parse(arguments):
    """Let click parse a command line: names, options and choices, not whether files exist."""
    group, context = main.commands, click.Context(main.commands)
    name, rest = arguments[0], arguments[1:]
    command = group.get_command(context, name)
    assert command is not None, f"no command '{name}'"
    if isinstance(command, click.Group):
        if not rest or rest[0].startswith("-"):
            return
        command, rest = command.get_command(context, rest[0]), rest[1:]
        assert command is not None, f"no command '{arguments[:2]}'"
    rest = rest[: rest.index("--")] if "--" in rest else rest
    parser = command.make_parser(click.Context(command))
    values, _, _ = parser.parse_args(args=[one for one in rest if one != "--debug"])
    for option in command.params:
        given = values.get(option.name)
        if isinstance(option.type, click.Choice) and isinstance(given, str) and given.islower():
            option.type.convert(given, option, context)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_commands_of_a_page_exist(page):
    text = page.read_text("utf-8")
    if page.suffix != ".md":
        joined = re.sub(r"\\\n#?", " ", text)
        lines = [line.lstrip(" #-").removeprefix("run: ") for line in joined.splitlines()]
        lines = [line for line in lines if line.startswith("deepmf-sumo ")]
        text = "\n".join(f"`{line}`" for line in lines)
    wrong = []
    for arguments in commands_of(text):
        if arguments and re.fullmatch(r"[a-z]+", arguments[0]):
            try:
                parse(arguments)
            except (AssertionError, click.ClickException) as error:
                message = getattr(error, "message", str(error))
                wrong.append(f"deepmf-sumo {shlex.join(arguments)}: {message}")
    assert wrong == []


def test_the_commands_of_the_makefile_exist():
    text = (ROOT / "Makefile").read_text("utf-8").replace("\\\n", " ")
    text = text.replace("$(TRAIN)", "$(RUN) train").replace("$(RUN)", "deepmf-sumo")
    for _ in range(2):  # variables of make may be nested once
        text = re.sub(r"\$\([^()]*\)", "X", text)
    lines = [
        line.partition("deepmf-sumo ")[2] for line in text.splitlines() if "deepmf-sumo " in line
    ]
    found = [shlex.split(re.split(r" [|&>]", line)[0]) for line in lines]
    assert len(found) > 10
    for arguments in found:
        parse(arguments)


def test_commands_are_found():
    """So that the test above does not pass for want of commands."""
    found = [one for page in PAGES for one in commands_of(page.read_text("utf-8"))]
    assert len(found) > 80
    with pytest.raises(click.NoSuchOption):
        parse(["run", "a.yaml", "--ouch"])
    with pytest.raises(AssertionError, match="no command"):
        parse(["rnu"])
