"""A hit in a result folder -> the smallest spec that still shows it.

::

    failure = read(Path("results/runs/my-run"))
    found = shrink(failure, simulations=60)
    write(found, Path("reproducer.yaml"))

The opponent follows its recorded path, so that no weights are needed. Every candidate is a run as
`deepmf-sumo run` does it, with the same planner.
"""

from deepmf_sumo.study.shrink.failure import RecordedHit, read, run_of
from deepmf_sumo.study.shrink.reproducer import check, summary, write
from deepmf_sumo.study.shrink.search import Shrunk, shrink

__all__ = ["RecordedHit", "Shrunk", "check", "read", "run_of", "shrink", "summary", "write"]
