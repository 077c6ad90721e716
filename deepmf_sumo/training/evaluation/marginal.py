"""The marginal network: its modes, their likelihood, and baselines without a network."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from deepmf_sumo.deepmf.networks.encode import recent_change
from deepmf_sumo.deepmf.networks.lanes import path_set, road_index
from deepmf_sumo.deepmf.networks.predict import Marginal, MarginalPrediction
from deepmf_sumo.scene import DT_S, FUTURE_STEPS, Floats, Forecast
from deepmf_sumo.scene.geometry import frames, polylines
from deepmf_sumo.training.evaluation.forecasts import FEW, ForecastTarget, add_shapes
from deepmf_sumo.training.evaluation.measures import (
    STEPS,
    Measured,
    final_errors,
    log_likelihoods,
    nearest_modes,
    path_errors,
)
from deepmf_sumo.training.evaluation.table import (
    NETWORK,
    Figure,
    Figures,
    Key,
    ObjectValues,
)
from deepmf_sumo.training.networks import clusters
from deepmf_sumo.training.networks.clusters import Clusters

_TIMES_S: Final[Floats] = np.asarray(np.arange(1, FUTURE_STEPS + 1) * DT_S, float)


@dataclass(frozen=True, slots=True, kw_only=True)
class Marginals:
    """Predictions for a target: forecasts by number of modes, log likelihoods by horizon."""

    forecasts: dict[int, Forecast]
    log_likelihood: dict[Measured, float]


class MarginalFigures:
    """Measures the marginal network.

    Args:
        modes: numbers of modes, `FEW` among them.
        fitted: map-blind clusters, if there are any beside the weights.
    """

    def __init__(self, modes: Sequence[int], fitted: Clusters | None) -> None:
        self.modes, self.fitted = modes, fitted
        self.samples = ObjectValues("marginal")
        self.targets = 0

    def add(self, marginal: Marginal, target: ForecastTarget) -> Marginals:
        """Add one target; returns its predictions for comparison."""
        future = target.future
        prediction = marginal.predict(target.view, target.agent_id)
        found = {modes: prediction.modes(modes) for modes in self.modes}
        for forecast in found.values():
            self._add_errors(forecast.futures.position_m, target)
        likeliest = found[FEW].futures.position_m[:1]
        self.samples.add(final_errors(likeliest, future, "most_probable_fde"), 1)
        add_shapes(self.samples, target, found, replace(prediction, temperature=1.0).modes(FEW))
        self._add_of_horizons(prediction, target)
        self._add_baselines(target)
        logs = log_likelihoods(found[max(found)], future, prediction.end_density)
        self.samples.add(logs)
        self.targets += 1
        return Marginals(forecasts=found, log_likelihood=logs)

    def _add_errors(
        self, modes_m: Floats, target: ForecastTarget, condition: str = NETWORK
    ) -> None:
        errors = final_errors(modes_m, target.future, "min_fde")
        errors |= path_errors(modes_m, target.future, target.speed_mps)
        self.samples.add(errors, len(modes_m), condition)

    def _add_of_horizons(self, prediction: MarginalPrediction, target: ForecastTarget) -> None:
        """Errors of modes chosen for each horizon; those for 8 s are too far apart at 3 s."""
        for seconds, step in STEPS.items():
            if not target.future.valid[step]:
                continue
            found = {modes: prediction.modes(modes, chosen_at=step) for modes in self.modes}
            for modes, forecast in found.items():
                errors = final_errors(
                    forecast.futures.position_m, target.future, "min_fde_of_horizon", (seconds,)
                )
                self.samples.add(errors, modes)
            nearest = nearest_modes(found[FEW], target.future, "_of_horizon", (seconds,))
            self.samples.add(nearest, FEW)

    def _add_baselines(self, target: ForecastTarget) -> None:
        self._add_errors(constant_velocity(target), target, "constant_velocity")
        self._add_errors(lane_following(target), target, "lane_following")
        if self.fitted is not None:
            for modes in clusters.MODES:
                self._add_errors(map_blind(self.fitted, target, modes), target, "clusters")

    def figures(self) -> Figures:
        """All figures of the network and of the baselines."""
        return {Key("marginal", "targets"): Figure(self.targets), **self.samples.figures()}


def constant_velocity(target: ForecastTarget) -> Floats:
    """(1, 80, 2) straight on at the speed and in the direction of now."""
    tracks = target.view.history
    start, velocity = tracks.position_m[target.row, -1], tracks.velocity_mps[target.row, -1]
    return np.asarray((start + _TIMES_S[:, None] * velocity)[None], float)


def lane_following(target: ForecastTarget) -> Floats:
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


def map_blind(fitted: Clusters, target: ForecastTarget, modes: int) -> Floats:
    """(M, 80, 2) clusters of how others moved on from this speed and yaw rate."""
    tracks = target.view.history
    start = tracks.position_m[target.row, -1]
    heading = float(tracks.heading_rad[target.row, -1])
    went = clusters.predict(fitted, target.speed_mps, _yaw_rate(target), modes)
    return frames.to_scene(went, start, heading)


def _yaw_rate(target: ForecastTarget) -> float:
    _, yaw = recent_change(target.view.history, np.array([target.row]), target.view.dt_s)
    return float(yaw[0])
