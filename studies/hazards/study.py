"""Attacks on the forty places of `build.py`, and their ranking: ``python study.py FOLDER``.

For each seed and kind of place 50 lawful attacks at moments that are spread, and 50 before
encounters: how often anything happens, and what happens then. The opponent is the vehicle that the
AV is about to meet, if there is one. Results are in FOLDER/SEED/KIND-PREFERENCE; existing ones are
kept. Then what `rank.py` prints of FOLDER/SEED for all seeds.
"""

# ruff: noqa: INP001 - a script beside data, not a package

import argparse
import itertools
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

HERE: Final = Path(__file__).resolve().parent
KINDS: Final = ("left", "merge", "stop", "signal")
WISHES: Final = {
    "version": "S2",
    "rule": "expected",
    "constraints": "[lawful]",
    "opponent": "met",
    "form.candidates": "12",
    "form.goal_candidates": "16",
    "form.reactions": "4",
}
"""Of the adversary: a lawful opponent, and little effort for each attack."""
WHEN: Final = (
    "--from", "0", "--until", "164", "--set", "duration_s=16", "--set", "opponents=one",
)  # fmt: skip
"""Attacks end with the traffic."""


def commands(
    folder: Path, seeds: list[int], moments: int, prefer: list[str], flawed: list[str] | None
) -> Iterator[list[str]]:
    """What is run, one after the other."""
    build = [sys.executable, str(HERE / "build.py"), str(folder / "net")]
    yield build if flawed is None else [*build, "--flawed", *flawed]
    wishes = [
        part for key, value in WISHES.items() for part in ("--set", f"adversary.{key}={value}")
    ]
    attack = [sys.executable, "-m", "deepmf_sumo.cli.main", "attack"]
    for seed, wish, kind in itertools.product(seeds, prefer, KINDS):
        yield [
            *attack, str(folder / "net" / "hazards.sumocfg"), *WHEN,
            "--set", f"source.moments.av_type={kind}",
            "--moments", str(moments), "--seed", str(seed), "--no-pictures",
            "--set", f"source.moments.prefer={wish}", "--resume", *wishes,
            "--out", str(folder / str(seed) / f"{kind}-{wish}"),
        ]  # fmt: skip
    rank = [sys.executable, str(HERE / "rank.py"), *(str(folder / str(seed)) for seed in seeds)]
    yield rank if flawed is None else [*rank, "--flawed", *flawed]


def main() -> int:
    """Run it all; ends with the exit code of what did not go through."""
    parser = argparse.ArgumentParser(description="Do attacks find the planted hazards?")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2], metavar="SEED")
    parser.add_argument("--moments", type=int, default=50, help="a seed, kind and preference")
    parser.add_argument(
        "--prefer",
        nargs="+",
        default=["spread", "encounters"],
        help="`source.moments.prefer` of specs",
    )
    parser.add_argument("--flawed", nargs="*", metavar="PLACE", help="as of build.py")
    given = parser.parse_args()
    for command in commands(given.folder, given.seeds, given.moments, given.prefer, given.flawed):
        code = subprocess.run(command, check=False).returncode
        if code:
            return code
    return 0


if __name__ == "__main__":
    sys.exit(main())
