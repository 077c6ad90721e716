"""How small reproducers get: ``python -m tests.bench.shrink RESULTS... --out FOLDER``.

Shrinks every hit of the result folders, runs each written spec with `deepmf-sumo run`, and compares
its tracks with those of the search. Printed: a row for each hit, then how many have at most three
vehicles and fail again byte for byte. What cannot be shrunk is a row with its reason.
"""

import argparse
import hashlib
import statistics
import time
from pathlib import Path

from deepmf_sumo import api
from deepmf_sumo.errors import DeepmfError
from deepmf_sumo.results import tracks
from deepmf_sumo.results.reader import Results, Run
from deepmf_sumo.scene import DT_S
from deepmf_sumo.study import shrink

_FEW = 3


def main() -> None:
    """Print every figure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("results", nargs="+", type=Path, help="result folders")
    parser.add_argument("--out", type=Path, required=True, help="folder for specs and their runs")
    parser.add_argument("--simulations", type=int, default=60)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    hits = [run for run in Results.open(*options.results).runs if run.hit]
    found = [one for hit in hits if (one := _row(hit, options.out, options.simulations))]
    few = sum(one.best.road_users <= _FEW for one, _ in found)
    good = sum(one.best.road_users <= _FEW and same for one, same in found)
    print(f"{len(hits)} hits: {few} with at most {_FEW} road users,", end=" ")
    print(f"{sum(same for _, same in found)} fail again byte for byte, {good} both")
    if not found:
        return
    for name, of in _FIGURES.items():
        before, after = ([of(one)[end] for one, _ in found] for end in (0, 1))
        print(f"{name}: median {statistics.median(before):.1f} -> {statistics.median(after):.1f}")
    print(f"simulations: median {statistics.median(one.simulations for one, _ in found):.0f}")


_FIGURES = {
    "road users": lambda one: (2 + len(one.failure.others), one.best.road_users),
    "seconds to the hit": lambda one: (
        one.failure.contact * DT_S,
        one.best.steps * DT_S,
    ),
    "changes of plan": lambda one: one.changes(),
    "hardest acceleration, m/s2": lambda one: (one.first.hardest_mps2, one.best.hardest_mps2),
}


def _row(hit: Run, out: Path, simulations: int) -> tuple[shrink.Shrunk, bool] | None:
    begin = time.perf_counter()
    try:
        found = shrink.shrink(shrink.read(hit.folder), simulations)
    except DeepmfError as error:
        print(f"{hit.run_id}: {error}", flush=True)
        return None
    file = out / f"{hit.run_id}.yaml"
    shrink.write(found, file)
    [run] = api.run(file, out / hit.run_id, overwrite=True).runs
    digest = hashlib.sha256((run.folder / tracks.FILE).read_bytes()).hexdigest()
    same = run.hit and digest == found.best.digest
    took = time.perf_counter() - begin
    print(
        f"{hit.run_id}: {shrink.summary(found)}; {'the same again' if same else 'NOT THE SAME'};"
        f" {found.simulations} simulations ({found.end}), {took:.0f} s",
        flush=True,
    )
    return found, same


if __name__ == "__main__":
    main()
