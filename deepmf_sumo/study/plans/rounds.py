"""Runs whose moments are drawn by what earlier ones found: batch after batch."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

from deepmf_sumo.errors import UsageError
from deepmf_sumo.results import findings
from deepmf_sumo.results.quantities import SPARE, criticality
from deepmf_sumo.results.result import Result, attacked
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.study.moments import FoundMoments, Moment, MomentRequest
from deepmf_sumo.study.moments.promising import Promising
from deepmf_sumo.study.sweep.batch import Options

_NEAR: Final = 0.5
"""Worth of a contact that is no finding; of a miss less, by how near it came."""


class DrawRounds:
    """The moments of specs with ``draw: promising``, see `study.moments.promising`."""

    def __init__(self) -> None:
        self._pools: list[tuple[dict[str, int], Promising]] = []
        self._runs: dict[str, Task] = {}  # of all moments
        self._tasks: dict[str, Task] = {}  # drawn
        self._moments: dict[str, Moment] = {}

    def add(self, request: MomentRequest, found: FoundMoments, runs: Sequence[Task]) -> None:
        """The pool of a spec, and the run of each of its moments."""
        spread = [at for _, at in sorted(zip(found.order, range(len(runs)), strict=True))]
        pool = [found.moments[at] for at in spread]
        places = {runs[at].run_id: place for place, at in enumerate(spread)}
        self._pools.append((places, Promising(pool, request.wish.count, request.spec.seed)))
        self._moments |= zip((one.run_id for one in runs), found.moments, strict=True)

    @property
    def left(self) -> int:
        """Runs that are not drawn yet."""
        return sum(promising.count for _, promising in self._pools) - len(self._tasks)

    @property
    def drawn(self) -> list[tuple[Task, Moment]]:
        """All runs so far."""
        return [(task, self._moments[run_id]) for run_id, task in self._tasks.items()]

    def begin(self, planned: Iterable[Task]) -> list[Task]:
        """The runs to begin with: of the pools the first moments, and all other runs."""
        every = list(planned)
        self._runs = {task.run_id: task for task in every}
        first = {task.run_id: task for task in self([])}
        later = {run_id for places, _ in self._pools for run_id in places} - first.keys()
        self._tasks = {one.run_id: first[one.run_id] for one in every if one.run_id in first}
        return [first.get(one.run_id, one) for one in every if one.run_id not in later]

    def __call__(self, results: Sequence[Result]) -> list[Task]:
        """The next runs, by what all before them found; none at the end."""
        found = {one["run_id"]: _worth(one) for one in results}
        drawn = {}
        for places, promising in self._pools:
            names = list(places)
            known = {
                places[name]: value for name in names if (value := found.get(name)) is not None
            }
            for place, draw in promising.draw(known).items():
                drawn[names[place]] = replace(self._runs[names[place]], draw=draw)
        self._tasks |= drawn
        return list(drawn.values())


def refuse(request: MomentRequest, options: Options) -> None:
    """Raise UsageError where not all runs of a spec whose moments are drawn would be done here."""
    for option, given in (("--shard", options.shard), ("-k", options.name_filter)):
        if request.wish.pool and given:
            raise UsageError(
                f"{option} leaves runs out, and with source.moments.draw: promising the runs before"
                " decide which are next: leave one of them out."
            )


def _worth(result: Result) -> float | None:
    """1 for a finding, 0 where nothing came near; None where no vehicle attacked."""
    if result["status"] != "ok" or not attacked(result):
        return None
    metrics = {name: one["value"] for name, one in result["metrics"].items()}
    if findings.finding(metrics):
        return 1.0
    return _NEAR * criticality(metrics[SPARE]) if SPARE in metrics else 0.0
