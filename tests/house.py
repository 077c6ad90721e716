"""Marks of the package's structure: ``python -m tests.house``."""

import ast
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

import click

from deepmf_sumo import plugins
from deepmf_sumo.cli import main

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "deepmf_sumo"
OPTIONAL = ("baselines", "exporters", "live", "roadcheck", "training")
MOST_PARAMETERS = 7


def sources(folder: Path = PACKAGE) -> Iterator[Path]:
    """Python files that people wrote."""
    return (file for file in sorted(folder.rglob("*.py")) if "_pb2" not in file.name)


def repeated_classes() -> dict[str, list[str]]:
    """Names of classes at the top of more than one module; plug-ins share the name ``Settings``."""
    found = defaultdict(list)
    for file in sources():
        for node in ast.parse(file.read_text()).body:
            if isinstance(node, ast.ClassDef) and node.name != "Settings":
                found[node.name].append(str(file.relative_to(PACKAGE)))
    return {name: files for name, files in found.items() if len(files) > 1}


PUBLIC = ("api.py:run", "api.py:attack", "live/attacker.py:__init__")
"""What users call. Keyword-only parameters are its options, as those of commands: each has a
default and is named in the call, and objects that gather them would be one more thing to learn."""


def long_signatures() -> list[str]:
    """Functions with more than `MOST_PARAMETERS`, without those that click fills."""
    return [f"{name} ({count})" for name, count, _ in _signatures() if count > MOST_PARAMETERS]


def public_options() -> dict[str, int]:
    """Keyword-only parameters of what users call."""
    return {name: count for name, _, count in _signatures() if name in PUBLIC}


def _signatures() -> Iterator[tuple[str, int, int]]:
    """Functions with their numbers of parameters and of options."""
    for file in sources():
        for node in ast.walk(ast.parse(file.read_text())):
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            name = f"{file.relative_to(PACKAGE)}:{node.name}"
            plain = [one.arg for one in node.args.posonlyargs + node.args.args]
            options = len(node.args.kwonlyargs)
            if file.parent.name != "cli":
                count = len(set(plain) - {"self", "cls"})
                yield name, count + (0 if name in PUBLIC else options), options


def lines() -> dict[str, int]:
    """Lines of each room, and of ``tests``."""
    found: Counter[str] = Counter()
    for file in sources():
        parts = file.relative_to(PACKAGE).parts
        found[parts[0] if len(parts) > 1 else "(top)"] += len(file.read_text().splitlines())
    found["tests"] = sum(len(one.read_text().splitlines()) for one in sources(ROOT / "tests"))
    return dict(found)


def options() -> dict[str, int]:
    """Options of each command."""
    found: dict[str, int] = {}

    def add(command: click.Command, name: str) -> None:
        if isinstance(command, click.Group):
            context = click.Context(command)
            for each in command.list_commands(context):
                one = command.get_command(context, each)
                assert one is not None
                add(one, f"{name} {each}".strip())
        else:
            found[name] = sum(isinstance(one, click.Option) for one in command.params)

    add(main.commands, "")
    return found


def settings(adversary: str) -> dict[str, int]:
    """Keys of an adversary's settings: how many each has below it, 0 of plain values."""
    keys = plugins.settings_class("adversaries", adversary).model_fields
    below = {name: getattr(key.annotation, "model_fields", {}) for name, key in keys.items()}
    return {name: len(inner) for name, inner in below.items()}


def show() -> None:
    """Print the marks."""
    by_room, by_command = lines(), options()
    optional = sum(by_room[room] for room in OPTIONAL)
    tests = by_room.pop("tests")
    print("class names used more than once:", len(repeated_classes()))
    print(f"functions with more than {MOST_PARAMETERS} parameters:", len(long_signatures()))
    for each in long_signatures():
        print("   ", each)
    print("options of what users call:", public_options())
    print("options of all commands:", sum(by_command.values()), "most:", max(by_command.values()))
    keys = settings("deepmf")
    print("settings of deepmf:", len(keys), "and in its mappings:", sum(keys.values()))
    print("lines of rooms:", ", ".join(f"{name} {count}" for name, count in by_room.items()))
    print("lines:", sum(by_room.values()) - optional, "optional:", optional, "tests:", tests)


if __name__ == "__main__":
    show()
