"""BBO: Bayesian optimisation of a bicycle's controls, by Optuna's Gaussian process.

Source: AdvSim (Wang et al., CVPR 2021), whose best search it is, as DeepMF's paper compares with
it. Adapted: as in `brs`; Optuna's sampler (Matern kernel, log expected improvement) is asked for
one point after the other.

Budget: 100 simulations, the scouting one included. Needs the extra `search`.
"""

import warnings
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np
from pydantic import Field

from deepmf_sumo.adversaries.search.search import Search, SearchSettings
from deepmf_sumo.datatypes import Floats
from deepmf_sumo.errors import PluginError


class Settings(SearchSettings):
    """See `SearchSettings`.

    Attributes:
        drawn: uniform points before the Gaussian process proposes any.
    """

    drawn: int = Field(default=10, ge=1)


class BayesianSearch:
    """One point after the other, where the Gaussian process expects the most."""

    def __init__(self, settings: Settings, dimensions: int, rng: np.random.Generator) -> None:
        import optuna

        self._space: dict[str, optuna.distributions.BaseDistribution] = {
            str(axis): optuna.distributions.FloatDistribution(-1.0, 1.0)
            for axis in range(dimensions)
        }
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            sampler = optuna.samplers.GPSampler(
                seed=int(rng.integers(2**31)),
                n_startup_trials=settings.drawn,
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


def build(settings: Settings, weights: str) -> Search:
    """The adversary; ``weights`` choose the opponent. Raises PluginError without Optuna."""
    for package in ("optuna", "scipy"):
        if find_spec(package) is None:
            raise PluginError(
                f"adversary 'bbo' needs {package}, which is not installed; install it with "
                '`pip install "deepmf-sumo[search]"`, or use bga or brs.'
            )
    return Search(settings, weights, partial(BayesianSearch, settings))
