"""Interfaces of predictors: view -> prediction.

A prediction contains everything that the networks compute of a view. Callers that ask several
questions about one moment keep it and pass it on; predictors themselves keep nothing.
"""

from typing import Any, Final, Protocol

from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.decoding import GoalSet, Singles
from deepmf_sumo.deepmf.networks.features import Features
from deepmf_sumo.scene import AgentId, Floats, Forecast, Futures, Heat, OpponentScores, View

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

    def heat(self) -> Heat | None:
        """Where the agent may be in 8 s; None without dense goals."""
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


class TrajectoryNetwork(Protocol):
    """A network that scores and completes goals: DenseTNT in torch, or its ONNX graphs."""

    @property
    def preset(self) -> Preset:
        """Its sizes."""
        ...

    @property
    def kernel_m(self) -> Singles:
        """(5, 2) widths along and across of the Laplace kernels at the knots, metres."""
        ...

    def scene_of(self, arrays: Features) -> Any:
        """What no given future changes, for `goals_of`."""
        ...

    def goals_of(
        self,
        encoding: Any,
        position_m: Singles | None = None,
        heading_rad: Singles | None = None,
    ) -> GoalSet:
        """The goals, given positions (K, 80, 2) and headings (K, 80) in the vehicle's frame."""
        ...


class OpponentNetwork(Protocol):
    """A network that scores the vehicles around the AV: in torch, or its ONNX graph."""

    @property
    def preset(self) -> Preset:
        """Its sizes."""
        ...

    def scored(self, arrays: Features) -> Floats:
        """(63, 2) logits of both heads, from `opponent.opponent_features`."""
        ...
