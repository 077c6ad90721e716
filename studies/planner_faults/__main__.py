"""``python -m studies.planner_faults list | halves | measure | causes``, from the top folder."""

# ruff: noqa: T201 - a command

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from deepmf_sumo.errors import DeepmfError
from studies.planner_faults import measure
from studies.planner_faults.faults import FAULTS
from studies.planner_faults.halves import FROZEN, frozen_text, halves
from studies.planner_faults.own_causes import first_cause
from studies.planner_faults.people import FAULTS as OF_PEOPLE


def _list() -> int:
    half = halves(FAULTS)
    print(f"{'name':19} {'half':9} what is wrong")
    for name, fault in FAULTS.items():
        print(f"{name:19} {half[name]:9} {fault.about}")
    for name, fault in OF_PEOPLE.items():
        print(f"{name:21} {'of people':9} {fault.about}")
    return 0


def _halves() -> int:
    print(frozen_text(), end="")
    if FROZEN.read_text("utf-8") == frozen_text():
        return 0
    print(f"{FROZEN} differs.", file=sys.stderr)
    return 1


def _causes(folders: Sequence[Path]) -> int:
    copies = [folder for folder in folders if folder.name in FAULTS]
    found = {folder.name: first_cause(folder.name, folder) for folder in copies}
    for name, first in found.items():
        said = f"{'own' if first.own else 'other'}: {first.sentence}" if first else "no finding"
        print(f"{name:19} {said}")
    number = sum(first is not None and first.own for first in found.values())
    print(f"the first cause is the fault's own: {number} of {len(found)}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m studies.planner_faults")
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="all faults")
    commands.add_parser("halves", help="what held_out.txt contains; 1 where it differs")
    own = commands.add_parser("causes", help="whether the first cause of a folder is its fault's")
    own.add_argument(
        "folders", type=Path, nargs="+", help="result folders; those of faults are named by them"
    )
    run = commands.add_parser("measure", help="which faults the gate reports for one method")
    run.add_argument("--people", action="store_true", help="faults of people, in suite/people")
    run.add_argument("--method", help="an adversary as in a spec, in YAML; default: deepmf")
    run.add_argument("--budget", type=int, help="simulations of an attack")
    run.add_argument("--moments", type=int, help="of each spec that chooses moments")
    run.add_argument("--jobs", type=int, default=1)
    run.add_argument("--seeds", type=int, nargs="+", default=[1])
    run.add_argument(
        "--false-alarms", type=_seeds, nargs="+", default=[(101,), (102,), (103,)], metavar="SEEDS",
        help="of the careful planner's other runs, e.g. 101-104; each is compared with all before",
    )  # fmt: skip
    run.add_argument(
        "--alike", type=int, nargs="*", default=[1, 2, 3], metavar="SEED",
        help="of the errors of equally good planners; each is compared with all before",
    )  # fmt: skip
    run.add_argument(
        "--later-seeds", type=int, nargs="*", default=[],
        help="added for planners that the first seeds do not report",
    )  # fmt: skip
    run.add_argument(
        "--faults", nargs="+", choices=("all", *FAULTS, *OF_PEOPLE), help="default: the open half"
    )
    run.add_argument(
        "--specs", type=Path, nargs="+", help="default: moments of the packaged networks"
    )
    run.add_argument("--thresholds", type=Path, help="default: those of `check`")
    run.add_argument("--out", type=Path, required=True, help="folder of all results; resumed")
    return parser


def _seeds(text: str) -> tuple[int, ...]:
    """One seed, or all from one to another."""
    first, _, last = text.partition("-")
    return tuple(range(int(first), int(last or first) + 1))


def main() -> int:
    """Do what is asked; 2 for what is wrong with it."""
    given = _parser().parse_args()
    if given.command == "list":
        return _list()
    if given.command == "halves":
        return _halves()
    try:
        if given.command == "causes":
            return _causes(given.folders)
        asked = measure.Asked.of(given)
        found = measure.table(measure.measured(asked, lambda line: print(line, file=sys.stderr)))
        print(found)
        (asked.out / "table.md").write_text(found + "\n", "utf-8")
    except DeepmfError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
