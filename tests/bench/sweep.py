"""Throughput of a sweep by workers: ``python -m tests.bench.sweep``, on a machine that is idle.

Runs a second from the first to the last run that ends, so without the start of the workers;
efficiency is that of N workers over N times that of one. With ``--executor ray://HOST:PORT`` the
workers are processors of a cluster.
"""

import argparse
import os
import tempfile
import time
from pathlib import Path

from deepmf_sumo import spec
from deepmf_sumo.study.sweep import batch

SCENARIO = Path(__file__).resolve().parents[2] / "scenarios" / "cut_in.yaml"


def main() -> None:
    """Print a line a number of workers."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=60, help="for each worker")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--executor", default="local")
    parser.add_argument("--set", dest="sets", action="append", default=["adversary=rule"])
    options = parser.parse_args()
    print(f"{options.executor}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    one = None
    for workers in options.workers:
        rate = runs_per_second(options.sets, options.runs * workers, workers, options.executor)
        one = one or rate / workers
        print(f"{workers} workers: {rate:.2f} runs/s, efficiency {rate / workers / one:.2f}")


def runs_per_second(sets: list[str], count: int, workers: int, executor: str) -> float:
    """Of one scenario with so many seeds."""
    specs = [spec.load(SCENARIO, [*sets, f"seed={seed}"]) for seed in range(count)]
    ended: list[float] = []

    def note(progress: batch.Progress) -> None:
        if progress.last is not None:
            assert progress.last["status"] == "ok", progress.last["error"]
            ended.append(time.monotonic())

    with tempfile.TemporaryDirectory() as folder:
        wanted = batch.Options(out=Path(folder) / "out", jobs=workers, executor=executor)
        batch.run(specs, wanted, note)
    return (count - workers) / (ended[-1] - ended[workers - 1])


if __name__ == "__main__":
    main()
