"""BGA: a genetic algorithm over a bicycle's controls.

Source: AdvSim (Wang et al., CVPR 2021), as DeepMF's paper compares with it. Adapted: as in `brs`;
tournament selection, blend crossover (BLX-alpha: Eshelman and Schaffer 1993), Gaussian mutation,
and an elite that survives without being simulated again.

Budget: 100 simulations, the unattacked one included: about five generations of 20.
"""

from functools import partial

import numpy as np
from pydantic import Field

from deepmf_sumo.baselines._search import TRIALS_FORESIGHT, Search, SearchSettings
from deepmf_sumo.scene import Floats, Ints

FORESIGHT = TRIALS_FORESIGHT


class Settings(SearchSettings):
    """See `SearchSettings`; points lie in [-1, 1].

    Attributes:
        population: points of a generation.
        elite: number of best points that survive unchanged.
        tournament: number of points of which the best becomes a parent.
        blend: how far a child may lie beyond its parents, per distance between them (alpha).
        mutation: standard deviation of the noise added to a child.
    """

    population: int = Field(default=20, ge=2)
    elite: int = Field(default=2, ge=0)
    tournament: int = Field(default=3, ge=1)
    blend: float = Field(default=0.3, ge=0.0)
    mutation: float = Field(default=0.2, ge=0.0)


class GeneticSearch:
    """Generations of points."""

    def __init__(self, settings: Settings, dimensions: int, rng: np.random.Generator) -> None:
        self._settings = settings
        self._rng = rng
        self._points = np.empty((0, dimensions))
        self._costs = np.empty(0)
        self._asked = rng.uniform(-1.0, 1.0, (settings.population, dimensions))

    def ask(self) -> Floats:
        """(B, D) new points of the generation."""
        return self._asked

    def tell(self, costs: Floats) -> None:
        """Breed the next generation from the elite and the new points."""
        settings = self._settings
        points = np.concatenate([self._points, self._asked])
        costs = np.concatenate([self._costs, costs])
        best = np.argsort(costs, kind="stable")[: settings.elite]
        children = max(1, settings.population - len(best))
        mothers, fathers = (points[self._parents(costs, children)] for _ in range(2))
        self._points, self._costs = points[best], costs[best]
        self._asked = self._children(mothers, fathers)

    def _parents(self, costs: Floats, count: int) -> Ints:
        """(count) rows of the winners of tournaments."""
        rivals = self._rng.integers(len(costs), size=(count, self._settings.tournament))
        winners: Ints = rivals[np.arange(count), costs[rivals].argmin(axis=1)]
        return winners

    def _children(self, mothers: Floats, fathers: Floats) -> Floats:
        """Mutated points between and slightly beyond their parents."""
        beyond = self._settings.blend
        share = self._rng.uniform(-beyond, 1 + beyond, mothers.shape)
        children = mothers + share * (fathers - mothers)
        children = children + self._rng.normal(0.0, self._settings.mutation, children.shape)
        clipped: Floats = np.clip(children, -1.0, 1.0)
        return clipped


def build(settings: Settings, weights: str) -> Search:
    """The adversary; ``weights`` choose the opponent."""
    return Search(settings, weights, partial(GeneticSearch, settings))
