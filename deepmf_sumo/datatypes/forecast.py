"""Predicted motion."""

from dataclasses import dataclass

from deepmf_sumo.datatypes.arrays import Floats, frozen
from deepmf_sumo.datatypes.scene import AgentId


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Futures:
    """M possible futures of one agent, from the step after the view's.

    Attributes:
        position_m: (M, F, 2) box centre. heading_rad: (M, F).
    """

    agent_id: AgentId
    position_m: Floats
    heading_rad: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "position_m", frozen(self.position_m))
        object.__setattr__(self, "heading_rad", frozen(self.heading_rad))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Forecast:
    """M weighted futures of one agent.

    Attributes:
        futures: shapes (M, F, ...).
        probability: (M) sums to 1, most likely first.
        temperature: the one applied to the scores before the softmax.
    """

    futures: Futures
    probability: Floats
    temperature: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "probability", frozen(self.probability))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OpponentScores:
    """How suitable each surrounding vehicle is as an opponent.

    Attributes:
        ids: (A) candidates: vehicles in range, not the AV, not parked.
        logits: (A) before the sigmoid.
        partner_logits: (A) of the head trained on labelled partners.
    """

    ids: tuple[AgentId, ...]
    logits: Floats
    partner_logits: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "logits", frozen(self.logits))
        object.__setattr__(self, "partner_logits", frozen(self.partner_logits))
