"""Hits that only one of two planners has, when both are attacked in the same way.

Between equally good planners an own hit would be the one's or the other's with equal probability
(sign test). Runs of one spec and scene with other seeds are one unit, which counts for the planner
that has more own hits in it. A planner compared with itself has none, so that it raises no alarm.
`study.same_attacks` repeats the hits.
"""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from deepmf_sumo.results.statistics import by_chance


@dataclass(frozen=True, slots=True, kw_only=True)
class SameAttacks:
    """What the repeated hits of both sides show.

    Attributes:
        folder: with the repeated runs.
        hits, baseline_hits: of each side, before.
        own, baseline_own: ids of the hits that only one side's planner has.
        unrepeated: ids of hits that did not come again with their own planner, or whose run failed.
        level: a smaller probability of as many own hits by chance is not put down to chance.
    """

    folder: Path
    hits: int
    baseline_hits: int
    own: tuple[str, ...]
    baseline_own: tuple[str, ...]
    unrepeated: tuple[str, ...]
    level: float

    @property
    def chance(self) -> float:
        """Probability of own hits in as many units, or more, if both planners are equally good."""
        return by_chance(*self._units())

    def _units(self) -> tuple[int, int]:
        """Units in which the new planner has more own hits, and in which the other has."""
        lead = Counter(map(_situation, self.own))
        lead.subtract(Counter(map(_situation, self.baseline_own)))
        return sum(more > 0 for more in lead.values()), sum(more < 0 for more in lead.values())

    @property
    def state(self) -> Literal["worse", "better", "cannot tell"]:
        """What the own hits say of the new planner."""
        if self.chance < self.level:
            return "worse"
        more, fewer = self._units()
        return "better" if by_chance(fewer, more) < self.level else "cannot tell"


def _situation(run_id: str) -> str:
    return run_id.rsplit("--", 1)[0]
