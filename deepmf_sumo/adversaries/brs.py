"""BRS: random search over a bicycle's controls, the paper's simplest baseline.

Source: AdvSim (Wang et al., CVPR 2021), as DeepMF's paper compares with it. Adapted: no code of
AdvSim is public; the parameters are changes of acceleration and curvature at knots in time, the
cost is `adversaries._search`, every candidate is scored by a simulation in which the AV reacts.

Budget: 4 simulations, the scouting one included, which is the ratio to BBO and BGA of the times
that the paper gives; none of it is for learning, so more of them only draw more.
"""

import numpy as np
from pydantic import Field

from deepmf_sumo.adversaries._search import TRIALS_FORESIGHT, Search, SearchSettings
from deepmf_sumo.datatypes import Floats

FORESIGHT = TRIALS_FORESIGHT

_BATCH = 16


class Settings(SearchSettings):
    """See `SearchSettings`."""

    simulations: int = Field(default=4, ge=2)


class RandomSearch:
    """Uniform points."""

    def __init__(self, dimensions: int, rng: np.random.Generator) -> None:
        self._dimensions = dimensions
        self._rng = rng

    def ask(self) -> Floats:
        """(16, D) points that know nothing of those before."""
        return self._rng.uniform(-1.0, 1.0, (_BATCH, self._dimensions))

    def tell(self, costs: Floats) -> None:
        """Nothing is learned."""


def build(settings: Settings, weights: str) -> Search:
    """The adversary; ``weights`` choose the opponent."""
    return Search(settings, weights, RandomSearch)
