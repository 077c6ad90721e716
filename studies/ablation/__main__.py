"""``python -m studies.ablation PLAN --out OUT``, from the top folder.

Trains, evaluates and attacks with each variant of PLAN, and writes ablation.csv and ablation.md
after each. The same command resumes an interrupted study.
"""

# ruff: noqa: T201 - a command

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from deepmf_sumo.errors import DeepmfError, exit_code
from studies import ablation


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m studies.ablation", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("plan", type=Path)
    parser.add_argument(
        "--set",
        dest="sets",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="override a key",
    )
    parser.add_argument("--out", type=Path, required=True, help="finished parts in it are kept")
    parser.add_argument(
        "--jobs", type=int, default=1, help="processes that compute features, and that attack"
    )
    parser.add_argument("--threads", type=int, help="of training; default: torch's own")
    parser.add_argument("--cache", type=Path, help="default: of features, as `deepmf-sumo train`")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Do the study; 3 where a run failed, and the code of the error for what is wrong."""
    given = vars(_parser().parse_args(arguments))
    file, sets = given.pop("plan"), given.pop("sets")
    command = " ".join(["python -m studies.ablation", *(arguments or sys.argv[1:])])
    options = ablation.Options(command=command, **given)
    rows: list[ablation.Row] = []
    try:
        plan = ablation.load(file, sets)
        for row in ablation.run(plan, options, lambda line: print(line, file=sys.stderr)):
            rows.append(row)
            ablation.write(options.out, ablation.notes(plan, options.jobs, rows), rows)
    except DeepmfError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    print((options.out / ablation.READABLE).read_text("utf-8"), end="")
    failed = any(attacked.failed for row in rows for attacked in row.attacks)
    return exit_code("failed") if failed else 0


if __name__ == "__main__":
    sys.exit(main())
