"""``make golden``: do the golden runs give the same files as with the version before?

    python -m tests.golden [--base COMMIT] [--jobs N] [--keep] [--write-table]

Runs the cases of `cases.py` with the code of a commit (once: its files are kept in
`.cache/golden/COMMIT`) and with the code of this checkout, and names the files that differ, timings
and facts of the machine apart. Both run on this machine, in folders of the same name: other
processors give other last digits. What the runs measured is also compared with `table.csv`, which
is committed, to 5e-6: that holds on any machine (one processor moved three values by up to 2e-6).
Ends with 1 where a file or a value differs.
"""

import argparse
import hashlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
import yaml

from tests.golden import cases
from tests.support import same_bytes

ROOT: Final = Path(__file__).resolve().parents[2]
STORE: Final = ROOT / ".cache" / "golden"
PRESENT: Final = "present"
TABLE: Final = Path(__file__).with_name("table.csv")


def main() -> None:
    """Run what has not been run, and compare."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--base", default="HEAD~1", help="the version before (default: HEAD~1)")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--write-table", action="store_true", help="renew table.csv")
    parser.add_argument("--keep", action="store_true", help="keep the files of this checkout")
    options = parser.parse_args()
    commit = _git("rev-parse", "--short=12", options.base)
    listed = hashlib.sha256(Path(cases.__file__).read_bytes()).hexdigest()[:6]
    before = STORE / f"{commit}-{listed}"
    if not before.is_dir():
        _run_all(checkout(commit), before, options.jobs)
    now = STORE / PRESENT
    shutil.rmtree(now, ignore_errors=True)
    _run_all(ROOT, now, options.jobs)
    changed = same_bytes.differences(before / "out", now / "out")
    if options.write_table:
        _measured(now).to_csv(TABLE, index=False)
    moved = _moved(now)
    for name in changed:
        print("differs:", name)
    for name in moved:
        print("not as in table.csv:", name)
    files, runs = _count(now), _count(now, "result.json")
    print(f"{files} files of {runs} runs; {len(changed)} differ from {commit}")
    if not changed and not options.keep:
        shutil.rmtree(now)
    sys.exit(bool(changed or moved))


def _measured(folder: Path) -> pd.DataFrame:
    """Outcome, time of contact and metrics of each run: run, quantity, value."""
    rows = []
    for file in sorted((folder / "out").rglob("result.json")):
        result = json.loads(file.read_text("utf-8"))
        run = str(file.parent.relative_to(folder / "out"))
        rows.append((run, "outcome", result["outcome"]))
        rows += [
            (run, name, f"{metric['value']:.9g}")
            for name, metric in sorted(result["metrics"].items())
            if metric.get("value") is not None
        ]
    return pd.DataFrame(rows, columns=["run", "quantity", "value"], dtype=str)


def _moved(folder: Path) -> list[str]:
    """What is not as in the committed table."""
    keys = ["run", "quantity"]
    there, here = (
        frame.set_index(keys)["value"]
        for frame in (pd.read_csv(TABLE, dtype=str), _measured(folder))
    )
    both = there.index.intersection(here.index)
    a, b = (pd.to_numeric(one[both], errors="coerce").to_numpy() for one in (there, here))
    equal = np.isclose(a, b, rtol=2e-4, atol=1e-9) | (there[both] == here[both]).to_numpy()
    # a last digit moves an acceleration over a border of a histogram
    equal |= both.get_level_values("quantity").str.startswith("acceleration_kl")
    names = [*both[~equal], *there.index.symmetric_difference(here.index)]
    return [" ".join(name) for name in names]


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(ROOT), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def checkout(commit: str) -> Path:
    """The files of a commit, outside the work tree."""
    tree = STORE / "trees" / commit
    if not tree.is_dir():
        tree.mkdir(parents=True)
        archive = subprocess.run(
            ["git", "-C", str(ROOT), "archive", commit], check=True, capture_output=True
        ).stdout
        subprocess.run(["tar", "-x", "-C", str(tree)], input=archive, check=True)
    return tree


def _run_all(tree: Path, kept: Path, jobs: int) -> None:
    """All cases with the code of ``tree``; the folder is moved to ``kept`` when all is there."""
    work = STORE / "work"  # files hold their paths: always the same
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    for name in ("sumo_nets", "scenarios"):
        shutil.copytree(tree / name, work / name)
    cases.write(work, work / "scenarios")
    _leave_out_later(tree, work)
    for command in _commands_of(tree):
        _command(tree, work, command, jobs)
        if "record" in command:
            _python(tree, work, ["late.py"])
    _python(tree, work, ["live.py"])
    work.rename(kept)


def _commands_of(tree: Path) -> tuple[tuple[str, ...], ...]:
    """The commands as the version knows them, from its own list of cases."""
    file = tree / "tests" / "golden" / "cases.py"
    source = importlib.util.spec_from_file_location("cases_of_a_version", file)
    assert source is not None
    assert source.loader is not None
    module = importlib.util.module_from_spec(source)
    source.loader.exec_module(module)
    return module.COMMANDS


def _leave_out_later(tree: Path, work: Path) -> None:
    """Remove the specs whose adversary the version does not have yet, and say so."""
    for file in sorted((work / "specs").rglob("*.yaml")):
        adversary = yaml.safe_load(file.read_text("utf-8"))["adversary"]
        name = adversary if isinstance(adversary, str) else adversary["name"]
        homes = (tree / "deepmf_sumo" / home for home in ("attacks", "baselines", "adversaries"))
        if not any((home / f"{name}.py").exists() for home in homes):
            print(f"{file.stem}: {tree.name} has no adversary '{name}'; its files will differ")
            file.unlink()


def _command(tree: Path, work: Path, command: tuple[str, ...], jobs: int) -> None:
    arguments = list(command)
    if command[0] == "run" and (work / command[1]).is_dir():
        folder = Path(arguments[1])
        specs = sorted(str(path.relative_to(work)) for path in (work / folder).glob("*.yaml"))
        arguments[1:2] = specs
    if command[0] in {"run", "attack", "benchmark"}:
        arguments += ["--jobs", str(jobs), "--no-pictures"]
    said = _python(tree, work, ["-m", "deepmf_sumo.cli.main", *arguments])
    if command[0] == "show":
        (work / "out" / "table.csv").write_text(said, "utf-8")


def _python(tree: Path, work: Path, arguments: list[str]) -> str:
    print(tree.name, *arguments[:3], flush=True)
    home = str(STORE / "home" / tree.name)
    environment = {**os.environ, "PYTHONPATH": str(tree), "DEEPMF_SUMO_HOME": home}
    done = subprocess.run(
        [sys.executable, *arguments], cwd=work, env=environment, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    if done.returncode:
        sys.exit(f"{' '.join(arguments)} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    return done.stdout


def _count(folder: Path, name: str = "*") -> int:
    return sum(path.is_file() for path in (folder / "out").rglob(name))


if __name__ == "__main__":
    main()
