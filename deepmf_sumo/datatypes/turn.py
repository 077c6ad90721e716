"""Opponents that attack one after the other in a long episode."""

from dataclasses import dataclass
from typing import Literal

from deepmf_sumo.datatypes.scene import AgentId

TurnEnd = Literal[
    "contact", "out_of_reach", "gone", "too_long", "plan_ended", "harmless", "time", "av_gone"
]


@dataclass(frozen=True, slots=True, kw_only=True)
class TurnRules:
    """When an opponent is spent, and who may be the next.

    Attributes:
        longest_s: an opponent is tried for so long.
        reach_m: one that is farther from the AV, between centres, is out of reach.
        harmless_s: so long without a plan that meets any predicted future of the AV.
        again_after_s: who had a turn has none again for so long, unless nobody else is there.
        clear_s: after a turn the AV is given so long to be clear of everybody.
    """

    longest_s: float = 15.0
    reach_m: float = 80.0
    harmless_s: float = 4.0
    again_after_s: float = 30.0
    clear_s: float = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Turn:
    """One opponent's time.

    Attributes:
        first_step: at which it was chosen; the policy drives it from the next step on.
        last_step: the last of the turn; SUMO drives from the next step on.
        ended: ``contact`` with the AV; ``out_of_reach``; ``gone`` (left the simulation);
            ``too_long``; ``plan_ended`` (of a policy that does not plan again); ``harmless``;
            ``time`` and ``av_gone``: the episode's end.
        gap_m: least distance of the boxes of AV and opponent in the turn.
    """

    opponent_id: AgentId
    first_step: int
    last_step: int
    ended: TurnEnd
    gap_m: float
