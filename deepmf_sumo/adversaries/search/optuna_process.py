"""Bayesian optimisation by Optuna's Gaussian process (Akiba et al. 2019); the extra `search`."""

import warnings
from typing import Any

import numpy as np

from deepmf_sumo.datatypes import Floats


class OptunaSearch:
    """One point after the other, by Optuna's sampler: Matern kernel, log expected improvement."""

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
