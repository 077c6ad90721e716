"""Metrics of a rollout: one function each, in the module of its subject.

A metric takes an `Episode` and returns a number, or raises `NotMeasurable` with the reason::

    @metric("m", better="lower")
    def min_gap(episode: Episode) -> float:
        '''Least distance of the boxes of AV and opponent over the simulated steps.'''
        return series(episode).gap_m.min()

An episode is of one attacker, ``episode.rollout.opponent_id``: where several attack, each is
measured on its own, in the rollout as if it were alone (`Rollout.of_turn`).

The function's name is that of the metric, the first paragraph of its docstring the definition that
is printed with results. Metrics of other packages join through the entry point group
``deepmf_sumo.metrics``; see `plugins`.
"""

import functools
import importlib
import pkgutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

from deepmf_sumo import plugins
from deepmf_sumo.scene import Case, MetricValue, Rollout

Better = Literal["lower", "higher", "neither"]
"""Which values are better for the attacker."""
Computed = TypeVar("Computed")


class NotMeasurable(Exception):  # noqa: N818 - a result, not an error
    """A metric is not defined for the rollout; the message is the reason in the results."""


@dataclass(frozen=True, slots=True, eq=False)
class Episode:
    """A rollout and its case, with the intermediate results of `once`."""

    rollout: Rollout
    case: Case
    computed: dict[Callable[["Episode"], Any], Any] = field(default_factory=dict, repr=False)


@dataclass(frozen=True, slots=True)
class Metric:
    """A metric: ``compute`` returns its value, or raises `NotMeasurable`."""

    name: str
    unit: str
    better: Better
    definition: str
    compute: Callable[[Episode], float]

    def of(self, episode: Episode) -> MetricValue:
        """The value, or the reason for its absence."""
        value, reason = None, ""
        try:
            value = float(self.compute(episode))
        except NotMeasurable as error:
            reason = str(error)
        return MetricValue(
            name=self.name, value=value, unit=self.unit, better=self.better, reason=reason
        )

    def measure(self, rollout: Rollout, case: Case) -> MetricValue:
        """`of` a rollout, without intermediate results of other metrics."""
        return self.of(Episode(rollout, case))


def metric(unit: str, *, better: Better) -> Callable[[Callable[[Episode], float]], Metric]:
    """Turn a function into a metric; the first paragraph of its docstring is the definition."""

    def of(compute: Callable[[Episode], float]) -> Metric:
        sentence = " ".join((compute.__doc__ or "").strip().split("\n\n")[0].split())
        definition = sentence[:1].lower() + sentence[1:].removesuffix(".")
        return Metric(compute.__name__, unit, better, definition, compute)

    return of


def once(compute: Callable[[Episode], Computed]) -> Callable[[Episode], Computed]:
    """Cache an intermediate result of several metrics in the episode."""

    @functools.wraps(compute)
    def known(episode: Episode) -> Computed:
        if compute not in episode.computed:
            episode.computed[compute] = compute(episode)
        found: Computed = episode.computed[compute]
        return found

    return known


@functools.cache
def own() -> dict[str, Metric]:
    """The metrics of this package by name."""
    names = (module.name for module in pkgutil.iter_modules(__path__))
    modules = [importlib.import_module(f"{__name__}.{name}") for name in names]
    every = [one for module in modules for one in vars(module).values() if isinstance(one, Metric)]
    return {one.name: one for one in every}


def measure(rollout: Rollout, case: Case, only: Sequence[str] = ()) -> list[MetricValue]:
    """`measured` of an episode without intermediate results."""
    return measured(Episode(rollout, case), only)


def measured(episode: Episode, only: Sequence[str] = ()) -> list[MetricValue]:
    """All metrics, including those of other packages, in the order of their names; or ``only``."""
    rollout, case = episode.rollout, episode.case
    every = [plugins.load("metrics", name) for name in only or plugins.names("metrics")]
    return [
        one.of(episode) if isinstance(one, Metric) else one.measure(rollout, case) for one in every
    ]
