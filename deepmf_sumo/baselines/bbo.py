"""BBO: Bayesian optimisation of a bicycle's controls, by a Gaussian process.

Source: AdvSim (Wang et al., CVPR 2021), whose best search it is, as DeepMF's paper compares with
it. Adapted: as in `brs`; each point maximises the expected improvement (Jones, Schonlau and Welch
1998) under a Gaussian process, among points drawn everywhere and around the best ones. Length
scales are fitted again every ten points. Optuna's sampler, which does the same with a costlier
search for the next point, can replace it (`optimiser: optuna`).

The Gaussian process has a Matern 5/2 kernel with one length scale per axis, zero mean, and an
amplitude that maximises the likelihood in closed form (Rasmussen and Williams 2006, chapters 4 and
5).

Budget: 100 simulations, the unattacked one included.
"""

import math
import warnings
from functools import partial
from importlib.util import find_spec
from typing import Any, Literal

import numpy as np
from pydantic import Field

from deepmf_sumo.baselines._search import TRIALS_FORESIGHT, Search, SearchSettings
from deepmf_sumo.errors import PluginError
from deepmf_sumo.scene import Floats, Ints

_NOISE = 1e-4  # variance per amplitude: close points would make the kernel singular
_FLAT = 1e-12  # smallest amplitude: that of a constant function
_FACTORS = (0.5, 2.0)  # of all length scales together,
_AXIS_FACTORS = (0.6, 1 / 0.6)  # and of one at a time, that a fit tries
_SHORTEST, _LONGEST = 0.1, 20.0


class GaussianProcess:
    """Fitted to values (n) at points (n, D) under given length scales (D)."""

    def __init__(self, points: Floats, values: Floats, scales: Floats) -> None:
        self._scales = scales
        self._points = points / scales
        kernel = _matern(self._points, self._points)
        kernel[np.diag_indices_from(kernel)] += _NOISE
        lower = np.linalg.cholesky(kernel)
        self._whitening = np.linalg.inv(lower)
        white = self._whitening @ values
        self._amplitude = max(float(white @ white) / len(values), _FLAT)
        self._weights = self._whitening.T @ white
        self.log_likelihood = (
            -0.5 * len(values) * math.log(self._amplitude) - np.log(np.diag(lower)).sum()
        )

    def predict(self, points: Floats) -> tuple[Floats, Floats]:
        """Mean and standard deviation, (B) each, at points (B, D)."""
        kernel = _matern(points / self._scales, self._points)
        known = ((kernel @ self._whitening.T) ** 2).sum(-1)
        return kernel @ self._weights, np.sqrt(np.maximum(1 - known, 1e-10) * self._amplitude)


def fitted_scales(points: Floats, values: Floats, scales: Floats) -> Floats:
    """(D) length scales that are likelier than those given: one round of steps along each axis.

    A log-normal prior around 1 regularises them, since few points determine ten scales badly.
    """

    def evidence(tried: Floats) -> float:
        prior = -0.5 * float((np.log(tried) ** 2).sum())
        return float(GaussianProcess(points, values, tried).log_likelihood) + prior

    best, most = scales, evidence(scales)
    steps = [np.full(len(scales), factor) for factor in _FACTORS]
    for axis in range(len(scales)):
        for factor in _AXIS_FACTORS:
            steps.append(np.ones(len(scales)))
            steps[-1][axis] = factor
    for step in steps:
        tried = np.clip(best * step, _SHORTEST, _LONGEST)
        found = evidence(tried)
        if found > most:
            best, most = tried, found
    return best


def _matern(first: Floats, second: Floats) -> Floats:
    """(B, n) correlation of points (B, D) and (n, D) in units of the length scales."""
    square = (first**2).sum(-1)[:, None] + (second**2).sum(-1) - 2 * first @ second.T
    away = np.sqrt(5 * np.maximum(square, 0.0))
    correlation: Floats = (1 + away + away**2 / 3) * np.exp(-away)
    return correlation


class OptunaSearch:
    """Points one by one from Optuna's sampler: Matern kernel, log expected improvement."""

    def __init__(self, drawn: int, dimensions: int, rng: np.random.Generator) -> None:
        import optuna

        self._space: dict[str, optuna.distributions.BaseDistribution] = {
            str(axis): optuna.distributions.FloatDistribution(-1.0, 1.0)
            for axis in range(dimensions)
        }
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            sampler = optuna.samplers.GPSampler(
                seed=int(rng.integers(2**31)),
                n_startup_trials=drawn,
                deterministic_objective=True,
            )
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        self._study = optuna.create_study(sampler=sampler)
        self._trial: Any = None

    def ask(self) -> Floats:
        """(1, D) the next point."""
        self._trial = self._study.ask(self._space)
        return np.array([[self._trial.params[axis] for axis in self._space]])

    def tell(self, costs: Floats) -> None:
        """Teach the Gaussian process."""
        self._study.tell(self._trial, float(costs[0]))


FORESIGHT = TRIALS_FORESIGHT

_DRAWN = 400  # points everywhere, and as many around the best ones,
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
        optimiser: ``own`` Gaussian process, or ``optuna``'s (the extra `search`; ten times slower).
    """

    drawn: int = Field(default=10, ge=1)
    fit_every: int = Field(default=10, ge=1)
    optimiser: Literal["own", "optuna"] = "own"


class BayesianSearch:
    """Points one by one, where the Gaussian process expects the largest improvement."""

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
        """(1, D) the point with the largest expected improvement found."""
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
    """(B) expected improvement of points over the least value so far."""
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
