"""Measured numbers of README and site have a line in `studies.numbers`, and it can be run."""

import argparse
import importlib.util
import re
from pathlib import Path

import pytest

from studies.numbers import __main__ as numbers

TOP = Path(__file__).resolve().parents[2]
KNOWN = numbers.entries()
MEASURES = (
    "README.md",
    "docs/results.md",
    "docs/start/*.md",
    "docs/explain/*.md",
    "docs/howto/*.md",
)
STATED = {
    "docs/explain/avoidability.md: Reference drivers": "constants of published drivers",
    "docs/howto/attack.md: Steer the attack": "limits that a setting stands for",
    "docs/howto/planners.md: Test your planner": "bounds of an action",
}
"""Tables of numbers that were stated, not measured."""


def sections(page):
    """Headings of a page, each with its lines that are not code."""
    found, code = {"": []}, False
    heading = ""
    for line in page.read_text("utf-8").splitlines():
        code ^= line.lstrip().startswith("```")
        if line.startswith("#") and not code:
            heading = line.strip("# ")
            found[heading] = []
        elif not code:
            found[heading].append(line)
    return found


def has_table_of_numbers(lines):
    rows = [line for line in lines if line.startswith("|")]
    return any(len(re.findall(r"(?<![\w`./-])\d+(?:\.\d+)?(?![\w`/])", row)) > 1 for row in rows)


def test_every_table_of_measured_numbers_has_its_entry():
    told = {one for entry in KNOWN.values() for one in entry.sections}
    pages = {page for pattern in MEASURES for page in TOP.glob(pattern)}
    missing = [
        where
        for page in sorted(pages)
        for heading, lines in sections(page).items()
        if has_table_of_numbers(lines)
        and (where := f"{page.relative_to(TOP).as_posix()}: {heading}") not in {*told, *STATED}
    ]
    assert not missing


@pytest.mark.parametrize(
    "where", sorted({*STATED, *(s for e in KNOWN.values() for s in e.sections)})
)
def test_a_section_of_an_entry_is_on_its_page(where):
    page, _, heading = where.partition(": ")
    assert heading in sections(TOP / page)


def what_it_runs(line):
    """What tells a command from others: a study, a plan or a command with its object."""
    words = [one for one in line.split() if not re.match(r"[A-Z_]+=", one)]
    if words[0] == "make":
        return f"make {words[1]}"
    if words[0] == "python":
        return words[2]
    study = [one for one in words if one.startswith("studies/")]
    return study[0] if study else f"deepmf-sumo {words[1]} {words[2] if words[1] == 'data' else ''}"


def test_a_page_names_the_command_behind_its_numbers():
    """Of all commands of a page's entries at least one for each; README points to the results."""
    silent = []
    for name, entry in KNOWN.items():
        for page in {where.partition(": ")[0] for where in entry.sections}:
            text = (TOP / page).read_text("utf-8")
            named = any(what_it_runs(line).strip() in text for line in entry.run)
            if not (named or "results.md" in text or name == "pages"):
                silent.append(f"{page}: {name}")
    assert not silent


@pytest.mark.parametrize("name", KNOWN)
def test_commands_of_an_entry_exist(name):
    entry = KNOWN[name]
    assert entry.run
    assert {*entry.needs} <= {*numbers.NEEDS}
    targets = re.findall(r"^([a-z-]+):", (TOP / "Makefile").read_text("utf-8"), re.MULTILINE)
    commands = {path.stem.rstrip("_") for path in (TOP / "deepmf_sumo/cli").glob("[!_]*.py")}
    for line in entry.run:
        words = [one for one in line.split() if "=" not in one or one.startswith("-")]
        if words[0] == "make":
            assert words[1] in targets
        elif words[0] == "deepmf-sumo":
            assert words[1] in commands
        else:
            assert words[:2] == ["python", "-m"]
            assert importlib.util.find_spec(words[2])
        assert all((TOP / one).is_file() for one in words if one.startswith("studies/"))
    assert all((TOP / table).parent.is_dir() for table in entry.tables)


def entry(*run, **keys):
    return numbers.Entry(about="", run=run, minutes=1, sections=(), **keys)


@pytest.mark.sumo
def test_numbers_are_made_once_for_a_commit_and_tables_are_written(tmp_path, monkeypatch):
    monkeypatch.setattr(numbers, "TOP", tmp_path)
    given = argparse.Namespace(out=tmp_path / "out", scenes=None, quiet=False, jobs=3)
    one = entry("echo {jobs} >> {out}/t.csv", tables={"t.csv": "t.csv"})
    assert numbers.state("a", one, given, "c1").startswith("made (c1)")
    assert numbers.state("a", one, given, "c1") == "kept (c1)"
    assert (tmp_path / "t.csv").read_text() == "3\n"
    assert numbers.state("a", one, given, "c2").startswith("made (c2)")
    assert numbers.state("a", one, given, "c2+").startswith("made (c2+)")
    assert numbers.state("a", one, given, "c2+").startswith("made (c2+)")  # files may differ by now
    assert (tmp_path / "t.csv").read_text() == "3\n" * 4


@pytest.mark.sumo
def test_what_fails_or_cannot_run_is_said_and_writes_no_table(tmp_path, monkeypatch):
    monkeypatch.setattr(numbers, "TOP", tmp_path)
    given = argparse.Namespace(out=tmp_path / "out", scenes=tmp_path, quiet=False, jobs=1)
    bad = entry("echo begun > {out}/t.csv", "exit 3", "echo more", tables={"t.csv": "t.csv"})
    assert numbers.state("a", bad, given, "c1").startswith("failed with 3 ")
    assert not (tmp_path / "t.csv").exists()
    assert not (tmp_path / "out/a/made.json").exists()
    assert "$ echo more" in (tmp_path / "out/a/log.txt").read_text()
    (tmp_path / "val").mkdir()
    needy = entry("true", needs=("scenes", "womd", "quiet"))
    left_out = numbers.state("b", needy, given, "c1")
    assert left_out.startswith("left out: needs weights trained on recordings")
    assert "recordings: --scenes" not in left_out
    assert "nothing else runs" in left_out


@pytest.mark.sumo
def test_the_version_names_the_commit():
    if not (TOP / ".git").exists():
        pytest.skip("no clone of the repository")
    assert re.fullmatch(r"[0-9a-f]{7,}\+?", numbers.version())
