"""The marginal network: its modes, their likelihood, and baselines beside them."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from deepmf_sumo.datatypes import Forecast
from deepmf_sumo.predictors.marginal import Marginal
from deepmf_sumo.training import clusters
from deepmf_sumo.training.clusters import Clusters
from deepmf_sumo.training.evaluation import baselines, displacement, likelihood
from deepmf_sumo.training.evaluation.calibration import ModeCalibration
from deepmf_sumo.training.evaluation.displacement import (
    EARLY,
    HORIZONS,
    STEPS,
    DisplacementErrors,
)
from deepmf_sumo.training.evaluation.estimates import mean, standard_error
from deepmf_sumo.training.evaluation.forecast_modes import FEW, ForecastModes, compare
from deepmf_sumo.training.evaluation.targets import Target


@dataclass(frozen=True, slots=True, kw_only=True)
class Marginals:
    """What the marginal network said of a target: forecasts by modes, log likelihoods by horizon.

    A log likelihood is None where the target is not known at the horizon.
    """

    forecasts: dict[int, Forecast]
    log_likelihood: dict[str, float | None]


@dataclass(slots=True)
class MarginalFigures:
    """What has been measured of the marginal network.

    Attributes:
        modes: numbers of modes, `FEW` among them.
        fitted: map-blind clusters, if there are any beside the weights.
        chosen: its modes, which cover 8 s.
        of_horizon: final errors by horizon and number of modes, chosen to cover that horizon.
        calibrated_of_horizon: of modes that cover the horizon, at the fitted temperature.
    """

    modes: Sequence[int]
    fitted: Clusters | None
    chosen: ForecastModes = field(init=False)
    of_horizon: dict[tuple[str, int], list[float]] = field(default_factory=dict)
    baselines: dict[str, dict[int, DisplacementErrors]] = field(init=False)
    calibrated_of_horizon: ModeCalibration = field(default_factory=ModeCalibration)
    log_likelihood: dict[str, list[float]] = field(
        default_factory=lambda: {key: [] for key in HORIZONS}
    )
    targets: int = 0

    def __post_init__(self) -> None:
        self.chosen = ForecastModes(self.modes)
        self.baselines = {
            "constant_velocity": {1: DisplacementErrors()},
            "lane_following": {1: DisplacementErrors()},
        }
        if self.fitted is not None:
            self.baselines["clusters"] = {modes: DisplacementErrors() for modes in clusters.MODES}

    def add(self, marginal: Marginal, target: Target) -> Marginals:
        """One target; what was predicted is given back, for comparison."""
        view, agent_id, future = target.view, target.agent_id, target.future
        found = dict(
            zip(self.modes, marginal.predict_each(view, agent_id, self.modes), strict=True)
        )
        warm = copy(marginal)  # shares the network; only the probabilities differ
        warm.temperature = 1.0
        self.chosen.add(target, found, warm.predict_each(view, agent_id, (FEW,))[0])
        self._of_horizons(marginal, target)
        self._baselines(target)
        logs = likelihood.by_horizon(
            found[max(found)],
            future,
            lambda end, kernel: marginal.end_density(view, agent_id, end, kernel),
        )
        for key, value in logs.items():
            if value is not None:
                self.log_likelihood[key].append(value)
        self.targets += 1
        return Marginals(forecasts=found, log_likelihood=logs)

    def _of_horizons(self, marginal: Marginal, target: Target) -> None:
        """Who needs to know 3 s asks for modes that cover 3 s: those for 8 s are spread too far."""
        for key, step in STEPS.items():
            if not target.future.valid[step]:
                continue
            found = marginal.predict_each(target.view, target.agent_id, self.modes, chosen_at=step)
            for modes, forecast in zip(self.modes, found, strict=True):
                off = forecast.futures.position_m[:, step] - target.future.position_m[step]
                least = float(np.hypot(*off.T).min())
                self.of_horizon.setdefault((key, modes), []).append(least)
            few = found[self.modes.index(FEW)]
            self.calibrated_of_horizon.add(few, target.future, (key,))

    def _baselines(self, target: Target) -> None:
        known = self.baselines
        compare(known["constant_velocity"][1], baselines.constant_velocity(target), target)
        compare(known["lane_following"][1], baselines.lane_following(target), target)
        if self.fitted is not None:
            for modes, errors in known["clusters"].items():
                compare(errors, baselines.map_blind(self.fitted, target, modes), target)

    def summary(self) -> dict[str, Any]:
        """Figures by horizon."""
        found: dict[str, Any] = {
            "targets": self.targets,
            "clusters": "not fitted: there is no file beside the weights"
            if self.fitted is None
            else f"fitted on {self.fitted.samples} trajectories",
        }
        for key in (*EARLY, *HORIZONS):
            found[key] = {
                **self.chosen.displacement(key),
                "min_fde_of_horizon": self._chosen_for(key),
                "baselines": self._baseline_summary(key),
            }
        for key, logs in self.log_likelihood.items():
            found[key] |= {
                "log_likelihood": mean(logs),
                "log_likelihood_standard_error": standard_error(logs),
                "negative_log_likelihood": None if not logs else mean([-one for one in logs]),
                **self.chosen.calibration(key),
                "ece_of_horizon": self.calibrated_of_horizon.error(key),
                **self.chosen.plausibility(key),
            }
        return found

    def _chosen_for(self, key: str) -> dict[str, float | None]:
        return {str(modes): mean(self.of_horizon.get((key, modes), [])) for modes in self.modes}

    def _baseline_summary(self, key: str) -> dict[str, Any]:
        return {name: displacement.summary(errors, key) for name, errors in self.baselines.items()}
