"""Interfaces of predictors: view -> prediction.

A prediction contains everything that the networks compute of a view. Callers that ask several
questions about one moment keep it and pass it on; predictors themselves keep nothing.
"""

from typing import Final, Protocol

from deepmf_sumo.datatypes import AgentId, Floats, Forecast, Futures, OpponentScores, View

MOST_MODES: Final = 96
"""In one forecast: a vehicle far from all lanes has five paths with 24 goals each by default."""


class OpponentPredictor(Protocol):
    """phi(X): how suitable each surrounding vehicle is as the opponent (paper, section IV-B)."""

    def score(self, view: View) -> OpponentScores:
        """Scores of all candidates in the view."""
        ...


class Prediction(Protocol):
    """Where an agent may go from one moment on: computed once, then queried."""

    def modes(self, count: int) -> Forecast:
        """The forecast with ``count`` futures of 80 steps each, most likely first."""
        ...

    def log_density(self, position_m: Floats) -> Floats:
        """(K) log density of futures (K, 80, 2); comparable within this prediction."""
        ...


class MarginalPredictor(Protocol):
    """phi_M(X): futures of an agent (paper, section IV-C1)."""

    def predict(self, view: View, agent_id: AgentId) -> Prediction:
        """The prediction for an agent of the view."""
        ...


class ConditionalPrediction(Protocol):
    """Where an agent may go from one moment on, as a function of another agent's future."""

    def given(self, futures: Futures | None, modes: int) -> list[Forecast]:
        """One forecast for each given future of the other agent; one without condition for None."""
        ...


class ConditionalPredictor(Protocol):
    """phi_C(X, Y_OV): futures of an agent given another's future (paper, section IV-C2)."""

    def predict(
        self, view: View, agent_id: AgentId, *, planner: bool = False
    ) -> ConditionalPrediction:
        """The prediction for an agent; ``planner``: an automated planner drives it."""
        ...
