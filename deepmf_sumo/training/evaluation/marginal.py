"""The marginal network: its modes, their likelihood, and baselines beside them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from deepmf_sumo.datatypes import DT_S, FUTURE_STEPS, Floats, Forecast
from deepmf_sumo.geometry import frames, polylines
from deepmf_sumo.predictors.lanes import road_index
from deepmf_sumo.predictors.marginal import Marginal, MarginalPrediction
from deepmf_sumo.predictors.paths import path_set
from deepmf_sumo.training.evaluation.forecasts import FEW, ForecastModes, Target, compare
from deepmf_sumo.training.evaluation.measures import (
    EARLY,
    HORIZONS,
    STEPS,
    DisplacementErrors,
    ModeCalibration,
    error_summary,
    log_likelihoods,
    mean,
    standard_error,
)
from deepmf_sumo.training.networks import clusters
from deepmf_sumo.training.networks.clusters import Clusters

_TIMES_S: Final[Floats] = np.asarray(np.arange(1, FUTURE_STEPS + 1) * DT_S, float)
_TURN_STEPS: Final = 5
"""The yaw rate is that of the last half second, as in `features.Features`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Marginals:
    """Predictions for a target: forecasts by number of modes, log likelihoods by horizon.

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
        """Add one target; returns its predictions for comparison."""
        prediction = marginal.predict(target.view, target.agent_id)
        found = {modes: prediction.modes(modes) for modes in self.modes}
        self.chosen.add(target, found, replace(prediction, temperature=1.0).modes(FEW))
        self._of_horizons(prediction, target)
        self._baselines(target)
        logs = log_likelihoods(found[max(found)], target.future, prediction.end_density)
        for key, value in logs.items():
            if value is not None:
                self.log_likelihood[key].append(value)
        self.targets += 1
        return Marginals(forecasts=found, log_likelihood=logs)

    def _of_horizons(self, prediction: MarginalPrediction, target: Target) -> None:
        """Errors of modes chosen for each horizon; those for 8 s are too far apart at 3 s."""
        for key, step in STEPS.items():
            if not target.future.valid[step]:
                continue
            found = {modes: prediction.modes(modes, chosen_at=step) for modes in self.modes}
            for modes, forecast in found.items():
                off = forecast.futures.position_m[:, step] - target.future.position_m[step]
                least = float(np.hypot(*off.T).min())
                self.of_horizon.setdefault((key, modes), []).append(least)
            self.calibrated_of_horizon.add(found[FEW], target.future, (key,))

    def _baselines(self, target: Target) -> None:
        known = self.baselines
        compare(known["constant_velocity"][1], constant_velocity(target), target)
        compare(known["lane_following"][1], lane_following(target), target)
        if self.fitted is not None:
            for modes, errors in known["clusters"].items():
                compare(errors, map_blind(self.fitted, target, modes), target)

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
        return {name: error_summary(errors, key) for name, errors in self.baselines.items()}


def constant_velocity(target: Target) -> Floats:
    """(1, 80, 2) straight on at the speed and in the direction of now."""
    tracks = target.view.history
    start, velocity = tracks.position_m[target.row, -1], tracks.velocity_mps[target.row, -1]
    return np.asarray((start + _TIMES_S[:, None] * velocity)[None], float)


def lane_following(target: Target) -> Floats:
    """(1, 80, 2) along the nearest lane path at the speed of now; straight on without one."""
    tracks = target.view.history
    start = tracks.position_m[target.row, -1]
    heading = float(tracks.heading_rad[target.row, -1])
    paths = path_set(
        road_index(target.view.road),
        start,
        heading,
        target.speed_mps,
        target.view.signals,
        float(tracks.z_m[target.row, -1]),
    )
    place, _ = polylines.points_at(paths.points_m[0], target.speed_mps * _TIMES_S)
    return frames.to_scene(place, start, heading)[None]


def map_blind(fitted: Clusters, target: Target, modes: int) -> Floats:
    """(M, 80, 2) clusters of how others moved on from this speed and yaw rate."""
    tracks = target.view.history
    start = tracks.position_m[target.row, -1]
    heading = float(tracks.heading_rad[target.row, -1])
    went = clusters.predict(fitted, target.speed_mps, _yaw_rate(target), modes)
    return frames.to_scene(went, start, heading)


def _yaw_rate(target: Target) -> float:
    tracks = target.view.history
    seen = np.flatnonzero(tracks.valid[target.row])
    back = int(seen[max(-_TURN_STEPS - 1, -len(seen))])
    heading = tracks.heading_rad[target.row]
    seconds = max((tracks.steps - 1 - back) * target.view.dt_s, target.view.dt_s)
    return float(frames.difference(heading[-1], heading[back])) / seconds
