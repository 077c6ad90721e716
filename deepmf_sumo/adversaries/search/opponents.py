"""Which vehicle a search attacks: chosen as DeepMF does, so that methods can be compared."""

import numpy as np
from pydantic import Field

from deepmf_sumo import plugins
from deepmf_sumo.adversaries.search.scouting import Choose
from deepmf_sumo.datatypes import AgentId, Case, View
from deepmf_sumo.policies.factorization import opponent
from deepmf_sumo.predictors.base import OpponentPredictor


class OpponentSettings(plugins.Settings):
    """Settings of all adversaries that choose a vehicle.

    Attributes:
        opponent: ``argmax`` or ``sample`` (softmax) of the scores of the weights' opponent network;
            ``partner``: argmax of the head trained on labelled partners; ``labelled``: the partner
            that the recording names; else the id of a vehicle.
    """

    opponent: str = Field(default="argmax", min_length=1)


class OpponentChoice:
    """Chooses opponents; the network is loaded when it is first needed, and kept.

    Args:
        how: the setting ``opponent``.
        weights: name or folder, as `predictors.weights.load` takes it.
    """

    def __init__(self, how: str, weights: str) -> None:
        self._how = how
        self._weights = weights
        self._predictor: OpponentPredictor | None = None

    def of(self, case: Case) -> Choose:
        """What chooses in a case. Loads the network where it is needed, which takes a while."""
        if self._predictor is None and self._how in opponent.SCORED:
            # Brings torch along, which checking a spec's settings must not.
            from deepmf_sumo.predictors import shared

            self._predictor = shared.predictors(self._weights).opponent

        def choose(view: View, rng: np.random.Generator) -> AgentId | None:
            return opponent.choose(view, self._how, self._predictor, case.partner_id, rng)[0]

        return choose
