"""What a predictor is: view -> forecast."""

from collections.abc import Sequence
from typing import Final, Protocol

from deepmf_sumo.datatypes import AgentId, Forecast, Futures, OpponentScores, View

MOST_MODES: Final = 96
"""Of one forecast. A vehicle far from all lanes has five paths, with 24 goals each by default."""


class OpponentPredictor(Protocol):
    """phi(X): how suitable each surrounding vehicle is as the opponent (paper, section IV-B)."""

    def score(self, view: View) -> OpponentScores:
        """Scores of all candidates in the view."""
        ...


class MarginalPredictor(Protocol):
    """phi_M(X): futures of agents (paper, section IV-C1)."""

    def predict(self, view: View, agent_ids: Sequence[AgentId], modes: int) -> list[Forecast]:
        """One forecast per agent, ``modes`` futures of 80 steps each."""
        ...


class ConditionalPredictor(Protocol):
    """phi_C(X, Y_OV): futures of an agent given another's future (paper, section IV-C2)."""

    def react(
        self,
        view: View,
        agent_id: AgentId,
        given: Futures | None,
        modes: int,
        *,
        planner: bool = False,
    ) -> list[Forecast]:
        """One forecast of ``agent_id`` per given future of the other agent; one for None.

        ``planner`` says that an automated planner drives the agent, and not a person.
        """
        ...
