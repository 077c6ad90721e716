"""``python -m studies.numbers [NAME...]``, from the top folder: makes measured numbers again.

Each entry of `numbers.yaml` has a folder in OUT with what its commands wrote, their log, and
`made.json`, which says for which commit that was. A second call keeps what was made for the present
commit, and repeats the rest; the commands themselves resume. What could not run is left out with
the reason. Tables of the docs are written in place, so that `git diff` shows what changed; figures
in sentences are to be read again in the sections that the last lines name.
"""

# ruff: noqa: T201 - a command

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import yaml

from deepmf_sumo.tables import to_markdown

TOP: Final = Path(__file__).resolve().parents[2]
ENTRIES: Final = Path(__file__).with_name("numbers.yaml")
NEEDS: Final = {
    "scenes": "recordings: --scenes DIR, with scenes in DIR/val",
    "womd": "weights trained on recordings in .weights/womd: make womd-weights",
    "quiet": "a machine on which nothing else runs: --quiet",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """Numbers that belong together; the keys are explained in `numbers.yaml`."""

    about: str
    run: tuple[str, ...]
    minutes: float
    sections: tuple[str, ...]
    needs: tuple[str, ...] = ()
    tables: dict[str, str] = field(default_factory=dict)


def entries() -> dict[str, Entry]:
    """All of the file."""
    read = yaml.safe_load(ENTRIES.read_text("utf-8"))
    lists = ("run", "sections", "needs")
    return {
        name: Entry(**{key: tuple(one) if key in lists else one for key, one in values.items()})
        for name, values in read.items()
    }


def version() -> str:
    """The commit, with a plus where files differ from it."""

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=TOP, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    changed = git("status", "--porcelain", "--untracked-files=no")
    return git("rev-parse", "--short", "HEAD") + "+" * bool(changed)


def lacking(entry: Entry, scenes: Path | None, *, quiet: bool) -> str:
    """What an entry needs and is not there; empty: all is."""
    there = {
        "scenes": scenes is not None and (scenes / "val").is_dir(),
        "womd": (TOP / ".weights/womd").is_dir(),
        "quiet": quiet,
    }
    return "; ".join(NEEDS[need] for need in entry.needs if not there[need])


def make(entry: Entry, out: Path, scenes: Path | None, jobs: int) -> int:
    """Run the commands of an entry, write its tables; the first exit code that is not 0."""
    out.mkdir(parents=True, exist_ok=True)
    here = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    code = 0
    with (out / "log.txt").open("w", encoding="utf-8") as log:
        for command in entry.run:
            line = command.format(out=out, scenes=scenes, jobs=jobs)
            print(f"$ {line}", file=log, flush=True)
            done = subprocess.run(
                ["bash", "-c", line], cwd=TOP, env=here, stdout=log, stderr=log, check=False
            )
            code = code or done.returncode
    if not code:
        for table, made in entry.tables.items():
            shutil.copyfile(out / made, TOP / table)
    return code


def state(name: str, entry: Entry, given: argparse.Namespace, now: str) -> str:
    """Make an entry unless it is made or cannot be; what became of it."""
    if missing := lacking(entry, given.scenes, quiet=given.quiet):
        return f"left out: needs {missing}"
    out = given.out.resolve() / name
    record = out / "made.json"
    made = json.loads(record.read_text("utf-8"))["version"] if record.is_file() else ""
    if made == now and not now.endswith("+"):
        return f"kept ({now})"
    print(f"{name}: {entry.about} (some {entry.minutes:g} minutes)", file=sys.stderr, flush=True)
    begun = time.monotonic()
    code = make(entry, out, given.scenes and given.scenes.resolve(), given.jobs)
    minutes = (time.monotonic() - begun) / 60
    if code:
        return f"failed with {code} after {minutes:.0f} minutes: {out / 'log.txt'}"
    record.write_text(json.dumps({"version": now, "minutes": round(minutes, 1)}), "utf-8")
    return f"made ({now}) in {minutes:.0f} minutes"


def _parser(known: dict[str, Entry]) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m studies.numbers", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="default: all")
    parser.add_argument("--list", action="store_true", help="say what there is, and make nothing")
    parser.add_argument("--out", type=Path, default=TOP / ".cache/numbers")
    parser.add_argument("--scenes", type=Path, help="folder of recordings, with scenes in val")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--quiet", action="store_true", help="nothing else runs: measure time, too")
    parser.epilog = "names: " + ", ".join(known)
    return parser


def main() -> int:
    """Make what is asked; 2 for an unknown name, 3 if anything failed."""
    known = entries()
    parser = _parser(known)
    given = parser.parse_args()
    if unknown := [name for name in given.names if name not in known]:
        parser.error(f"no numbers '{unknown[0]}'; there are {', '.join(known)}")
    chosen = {name: one for name, one in known.items() if name in (given.names or known)}
    if given.list:
        said = {
            name: lacking(one, given.scenes, quiet=given.quiet) or f"{one.minutes:g} minutes"
            for name, one in chosen.items()
        }
    else:
        now = version()
        said = {name: state(name, one, given, now) for name, one in chosen.items()}
    rows = [(name, one.about, said[name], "; ".join(one.sections)) for name, one in chosen.items()]
    text = "\n".join(to_markdown(("numbers", "what", "state", "sections"), rows))
    print(text)
    if not given.list:
        (given.out / "numbers.md").write_text(text + "\n", "utf-8")
    return 3 if any(one.startswith("failed") for one in said.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
