"""BBO: Bayesian optimisation of a bicycle's controls, by a Gaussian process.

Source: AdvSim (Wang et al., CVPR 2021), whose best search it is, as DeepMF's paper compares with
it. Adapted: as in `brs`; one point after the other is where the expected improvement (Jones,
Schonlau and Welch 1998) under a Gaussian process is largest, among points drawn everywhere and
around the best ones. Length scales are fitted again every ten points. Optuna's sampler, which does
the same with a costlier search for the next point, can take its place (`optimiser: optuna`).

Budget: 100 simulations, the scouting one included.
"""

import math
from functools import partial
from importlib.util import find_spec
from typing import Literal

import numpy as np
from pydantic import Field

from deepmf_sumo.adversaries.search.gaussian_process import GaussianProcess, fitted_scales
from deepmf_sumo.adversaries.search.optuna_process import OptunaSearch
from deepmf_sumo.adversaries.search.search import TRIALS_FORESIGHT, Search, SearchSettings
from deepmf_sumo.datatypes import Floats, Ints
from deepmf_sumo.errors import PluginError

FORESIGHT = TRIALS_FORESIGHT

_DRAWN = 400  # points everywhere, and as many around the best,
_BEST = 4
_NEAR = (0.03, 0.1, 0.3)  # at these standard deviations
_KEPT, _CHILDREN = 8, 12  # those of most improvement, and points around each of them,
_REFINED = (0.2, 0.1, 0.05, 0.02)  # nearer in every round
_REMEMBERED, _LATEST = 300, 100  # of many points the best and the latest: time grows cubically
_erfc = np.vectorize(math.erfc, otypes=[float])


class Settings(SearchSettings):
    """See `SearchSettings`.

    Attributes:
        drawn: uniform points before the Gaussian process proposes any.
        fit_every: points after which its length scales are fitted again (``own`` alone).
        optimiser: ``own`` Gaussian process, or ``optuna``'s (the extra `search`; a tenfold time).
    """

    drawn: int = Field(default=10, ge=1)
    fit_every: int = Field(default=10, ge=1)
    optimiser: Literal["own", "optuna"] = "own"


class BayesianSearch:
    """One point after the other, where the Gaussian process expects the most."""

    def __init__(self, settings: Settings, dimensions: int, rng: np.random.Generator) -> None:
        self._settings = settings
        self._rng = rng
        self._points = np.empty((0, dimensions))
        self._costs = np.empty(0)
        self._scales = np.ones(dimensions)
        self._fitted = 0
        self._asked = np.empty((0, dimensions))

    def ask(self) -> Floats:
        """(1, D) the next point."""
        if len(self._costs) < self._settings.drawn:
            self._asked = self._rng.uniform(-1.0, 1.0, (1, self._points.shape[1]))
        else:
            self._asked = self._most_promising()
        return self._asked

    def tell(self, costs: Floats) -> None:
        """Teach the Gaussian process."""
        self._points = np.concatenate([self._points, self._asked])
        self._costs = np.concatenate([self._costs, costs])

    def _most_promising(self) -> Floats:
        """(1, D) the point of the largest expected improvement that is found."""
        rows = self._remembered()
        known, costs = self._points[rows], self._costs[rows] - self._costs[rows].mean()
        values = costs / max(float(costs.std()), 1e-9)
        tried = len(self._costs)
        if not self._fitted or tried - self._fitted >= self._settings.fit_every:
            self._scales = fitted_scales(known, values, self._scales)
            self._fitted = tried
        process = GaussianProcess(known, values, self._scales)
        points = self._beginnings(known, values)
        gain = _expected_improvement(process, points, float(values.min()))
        for reach in _REFINED:
            order = np.argsort(-gain, kind="stable")[:_KEPT]
            points, gain = points[order], gain[order]
            around = self._around(np.repeat(points, _CHILDREN, axis=0), reach)
            more = _expected_improvement(process, around, float(values.min()))
            points, gain = np.concatenate([points, around]), np.concatenate([gain, more])
        return points[[gain.argmax()]]

    def _remembered(self) -> Ints:
        """Rows of the points that the process is fitted to, in order."""
        tried = len(self._costs)
        if tried <= _REMEMBERED:
            return np.arange(tried)
        early = np.argsort(self._costs[:-_LATEST], kind="stable")[: _REMEMBERED - _LATEST]
        return np.sort(np.concatenate([early, np.arange(tried - _LATEST, tried)]))

    def _beginnings(self, known: Floats, values: Floats) -> Floats:
        """(800, D) points everywhere, and around the best ones."""
        best = known[np.argsort(values, kind="stable")[:_BEST]]
        near = best[self._rng.integers(len(best), size=_DRAWN)]
        reach = self._rng.choice(_NEAR, size=(_DRAWN, 1))
        everywhere = self._rng.uniform(-1.0, 1.0, near.shape)
        return np.concatenate([everywhere, self._around(near, reach)])

    def _around(self, points: Floats, reach: float | Floats) -> Floats:
        """Points moved at random."""
        moved: Floats = np.clip(points + reach * self._rng.normal(size=points.shape), -1.0, 1.0)
        return moved


def _expected_improvement(process: GaussianProcess, points: Floats, least: float) -> Floats:
    """(B) by how much points are expected to be below the least value so far."""
    mean, deviation = process.predict(points)
    share = (least - mean) / deviation
    below = 0.5 * _erfc(-share / math.sqrt(2))
    density = np.exp(-0.5 * share**2) / math.sqrt(2 * math.pi)
    gain: Floats = deviation * (share * below + density)
    return gain


def build(settings: Settings, weights: str) -> Search:
    """The adversary; ``weights`` choose the opponent. Raises PluginError without the extra."""
    if settings.optimiser == "own":
        return Search(settings, weights, partial(BayesianSearch, settings))
    for package in ("optuna", "scipy"):
        if find_spec(package) is None:
            raise PluginError(
                f"adversary 'bbo' with optimiser 'optuna' needs {package}, which is not installed; "
                'install it with `pip install "deepmf-sumo[search]"`, or use optimiser own.'
            )
    return Search(settings, weights, partial(OptunaSearch, settings.drawn))
