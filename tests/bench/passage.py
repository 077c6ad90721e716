"""What it saves that SUMO passes through traffic once: ``python -m tests.bench.passage OUT``.

OUT is a result folder of ``deepmf-sumo attack``. Some of its runs, spread over their moments, are
done again in one process, as a worker does them: SUMO from the begin of the traffic for each, and
in copies of the process, SUMO passing from one moment to the next. Printed: seconds of processor a
run.
"""

import argparse
import os
import resource
import tempfile
from pathlib import Path

from deepmf_sumo import spec
from deepmf_sumo.spec import tasks
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.study.sweep import episode, fork

from tests.support import same_bytes


def main() -> None:
    """Print a line each way."""
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path, help="result folder")
    parser.add_argument("--runs", type=int, default=20)
    options = parser.parse_args()
    paths = sorted((options.out / "runs").glob("*/spec.yaml"))
    planned = fork.in_order(tasks.plan([spec.load(path) for path in paths], options.out))
    chosen = planned[:: max(len(planned) // options.runs, 1)][: options.runs]
    last_s = max(task.spec.source.start_s for task in chosen)
    print(f"{len(chosen)} runs up to {last_s:g} s, load {os.getloadavg()[0]:.1f}")
    with tempfile.TemporaryDirectory() as folder:
        alone, passing = (Path(folder) / name for name in ("alone", "passing"))
        possible, fork._alone = fork._alone, lambda: False
        before = seconds_a_run(chosen, alone)
        fork._alone = possible
        after = seconds_a_run(chosen, passing)
        assert same_bytes.same(alone, passing), same_bytes.differences(alone, passing)
    print(f"SUMO from the begin for each run: {before:.2f} s of processor a run")
    print(f"SUMO passing on: {after:.2f} s, ratio {after / before:.2f}; the same files")


def seconds_a_run(planned: list[Task], runs: Path) -> float:
    """After a first one, which loads what all need."""
    work = episode.TaskRunner(runs=runs, cache=runs.parent / "cache")
    work(planned[0])
    begin = spent()
    for task in planned:
        work(task)
    return (spent() - begin) / len(planned)


def spent() -> float:
    """Seconds of processor of this process and its copies."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


if __name__ == "__main__":
    main()
