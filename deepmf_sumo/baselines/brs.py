"""BRS: random search over a bicycle's controls, the paper's simplest baseline.

Source: AdvSim (Wang et al., CVPR 2021), as DeepMF's paper compares with it. Adapted: no code of
AdvSim is public; the parameters are changes of acceleration and curvature at knots in time, the
cost is that of `_search`, and every candidate is simulated with a reacting AV.

Budget: 4 simulations, the unattacked one included, which is the ratio to BBO and BGA of the times
that the paper gives; it learns nothing, so a larger budget only draws more.
"""

import numpy as np
from pydantic import Field

from deepmf_sumo.baselines._search import TRIALS_FORESIGHT, Search, SearchSettings
from deepmf_sumo.scene import Floats

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
        """(16, D) points, independent of those before."""
        return self._rng.uniform(-1.0, 1.0, (_BATCH, self._dimensions))

    def tell(self, costs: Floats) -> None:
        """Learn nothing."""


def build(settings: Settings, weights: str) -> Search:
    """The adversary; ``weights`` choose the opponent."""
    return Search(settings, weights, RandomSearch)
