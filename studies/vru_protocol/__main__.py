"""``python -m studies.vru_protocol OUT``.

Runs the ten situations: with the fixed paths of the protocol, and with DeepMF choosing how the same
road user moves; for a planner that never brakes, for a good emergency brake, and for two planners
with manners. Writes ``table.md``: of how many cases each is hit, and what the hits are worth.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from deepmf_sumo import api
from deepmf_sumo.judge.ladder import RUNGS
from deepmf_sumo.results.reader import Results
from deepmf_sumo.tables import to_markdown
from studies.vru_protocol import build
from studies.vru_protocol.cases import SITUATIONS

PLANNERS: Final[dict[str, Any]] = {
    "never brakes": {"name": "constant_velocity", "follow_route": True},
    "emergency brake": {"name": "studies.vru_protocol.aeb:Aeb"},
    "idm": {"name": "idm", "perception": "corridor"},
    "careful": {"name": "studies.planner_faults.careful:Careful"},
}
ATTACKS: Final = ("fixed", "chosen")


def specs(folder: Path, names: tuple[str, ...], attacks: tuple[str, ...]) -> Iterator[Path]:
    """A file for each case, planner and attack."""
    for spec in build.write(folder, names):
        for attack in attacks:
            for planner, settings in PLANNERS.items():
                one = {**spec, "name": f"{spec['name']} {attack} {planner}", "planner": settings}
                if attack == "chosen":
                    opponent = spec["adversary"]["agent"]
                    one["adversary"] = {
                        "name": "deepmf", "version": "S1", "attackers": "all", "opponent": opponent
                    }  # fmt: skip
                yield build.saved(one, folder / f"{one['name'].replace(' ', '_')}.yaml")


def rows(results: Results) -> Iterator[dict[str, Any]]:
    """Of each situation and attack: hits of the planners, and the rungs of these."""
    frame = results.frame("runs")
    frame[["case", "attack", "planner_name"]] = frame["spec"].str.split(" ", n=2, expand=True)
    frame["situation"] = frame["case"].str.split("-").str[0]
    for situation in SITUATIONS:
        for attack in ATTACKS:
            here = frame[(frame["situation"] == situation.name) & (frame["attack"] == attack)]
            if here.empty:
                continue
            row = {"situation": f"{situation.name}: {situation.title}", "path": attack}
            for planner in PLANNERS:
                own = here[here["planner_name"] == planner]
                row[planner] = _said(own)
            yield row


def _said(runs: Any) -> str:
    """Hits of all runs, and how many of these are of each rung."""
    failed = int((runs["status"] != "ok").sum())
    hits = runs[runs["outcome"] == "av_opponent"]
    rungs = [RUNGS[int(number)] for number in hits["rung"].dropna()]
    counts = [f"{rungs.count(letter)} {letter}" for letter in sorted({*rungs})]
    said = f"{len(hits)} of {len(runs)}" + (f" ({', '.join(counts)})" if counts else "")
    return said + (f", {failed} failed" if failed else "")


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m studies.vru_protocol", description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--situations", nargs="*", default=[])
    parser.add_argument("--attacks", nargs="*", default=[*ATTACKS], choices=ATTACKS)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--resume", action="store_true")
    given = parser.parse_args()
    folder = given.out / "cases"
    files = [*specs(folder, tuple(given.situations), tuple(given.attacks))]
    results = api.run(files, given.out / "runs", jobs=given.jobs, resume=given.resume)
    found = [*rows(results)]
    table = "\n".join(to_markdown(list(found[0]), [list(row.values()) for row in found]))
    (given.out / "table.md").write_text(table + "\n", encoding="utf-8")
    sys.stdout.write(table + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
