"""The marginal network: displacement, likelihood, calibration and plausibility of its modes."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from deepmf_sumo.datatypes import Floats, Forecast
from deepmf_sumo.predictors.marginal import Marginal
from deepmf_sumo.training import clusters
from deepmf_sumo.training.clusters import Clusters
from deepmf_sumo.training.evaluation import baselines, displacement, likelihood, plausibility
from deepmf_sumo.training.evaluation.calibration import ModeCalibration
from deepmf_sumo.training.evaluation.displacement import (
    EARLY,
    HORIZONS,
    STEPS,
    DisplacementErrors,
)
from deepmf_sumo.training.evaluation.estimates import mean, standard_error
from deepmf_sumo.training.evaluation.targets import Target

FEW = 6
"""Modes of the calibration, and of what a motion forecast usually gives."""


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
        of_horizon: final errors by horizon and number of modes, chosen to cover that horizon.
        calibrated, plain: of modes that cover 8 s, at the fitted temperature and at 1.
        calibrated_of_horizon: of modes that cover the horizon, at the fitted temperature.
    """

    modes: Sequence[int]
    fitted: Clusters | None
    errors: dict[int, DisplacementErrors] = field(init=False)
    of_horizon: dict[tuple[str, int], list[float]] = field(default_factory=dict)
    likeliest: DisplacementErrors = field(default_factory=DisplacementErrors)
    baselines: dict[str, dict[int, DisplacementErrors]] = field(init=False)
    calibrated: ModeCalibration = field(default_factory=ModeCalibration)
    calibrated_of_horizon: ModeCalibration = field(default_factory=ModeCalibration)
    plain: ModeCalibration = field(default_factory=ModeCalibration)
    log_likelihood: dict[str, list[float]] = field(
        default_factory=lambda: {key: [] for key in HORIZONS}
    )
    first_overlap: dict[str, list[Floats]] = field(init=False)
    first_off_road: dict[str, list[Floats]] = field(init=False)
    targets: int = 0

    def __post_init__(self) -> None:
        self.errors = {modes: DisplacementErrors() for modes in self.modes}
        self.baselines = {
            "constant_velocity": {1: DisplacementErrors()},
            "lane_following": {1: DisplacementErrors()},
        }
        if self.fitted is not None:
            self.baselines["clusters"] = {modes: DisplacementErrors() for modes in clusters.MODES}
        groups = (*map(str, self.modes), "recorded")
        self.first_overlap = {group: [] for group in groups}
        self.first_off_road = {group: [] for group in groups}

    def add(self, marginal: Marginal, target: Target) -> Marginals:
        """One target; what was predicted is given back, for comparison."""
        view, agent_id, future = target.view, target.agent_id, target.future
        found = dict(
            zip(self.modes, marginal.predict_each(view, agent_id, self.modes), strict=True)
        )
        for modes, forecast in found.items():
            _compare(self.errors[modes], forecast.futures.position_m, target)
            self._plausible(
                str(modes), target, forecast.futures.position_m, forecast.futures.heading_rad
            )
        self._of_horizons(marginal, target)
        self._recorded(target)
        _compare(self.likeliest, found[FEW].futures.position_m[:1], target)
        self.calibrated.add(found[FEW], future)
        warm = copy(marginal)  # shares the network; only the probabilities differ
        warm.temperature = 1.0
        self.plain.add(warm.predict_each(view, agent_id, (FEW,))[0], future)
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
        _compare(known["constant_velocity"][1], baselines.constant_velocity(target), target)
        _compare(known["lane_following"][1], baselines.lane_following(target), target)
        if self.fitted is not None:
            for modes, errors in known["clusters"].items():
                _compare(errors, baselines.map_blind(self.fitted, target, modes), target)

    def _plausible(
        self, group: str, target: Target, position_m: Floats, heading_rad: Floats
    ) -> None:
        overlap = plausibility.first_overlap(target, position_m, heading_rad)
        self.first_overlap[group].append(overlap.astype(float))
        off = plausibility.first_off_road(target, position_m)
        self.first_off_road[group].append(off.astype(float))

    def _recorded(self, target: Target) -> None:
        """What happened, by the same rules: people leave the lanes too, and boxes are not exact."""
        known = target.future.valid
        position = np.where(known[:, None], target.future.position_m, np.nan)
        heading = np.where(known, target.future.heading_rad, np.nan)
        self._plausible("recorded", target, position[None], heading[None])

    def summary(self) -> dict[str, Any]:
        """Figures by horizon."""
        found: dict[str, Any] = {
            "targets": self.targets,
            "clusters": "not fitted: there is no file beside the weights"
            if self.fitted is None
            else f"fitted on {self.fitted.samples} trajectories",
        }
        for key in EARLY:
            found[key] = {
                "objects": len(self.likeliest.fde[key]),
                **displacement.summary(self.errors, key),
                "min_fde_of_horizon": self._chosen_for(key),
                "most_probable_fde": mean(self.likeliest.fde[key]),
                "baselines": self._baseline_summary(key),
            }
        for key, (step, *_) in HORIZONS.items():
            logs = self.log_likelihood[key]
            right, right_95 = self.calibrated.error_if_right(key)
            found[key] = {
                "objects": len(self.likeliest.fde[key]),
                **displacement.summary(self.errors, key),
                "min_fde_of_horizon": self._chosen_for(key),
                "most_probable_fde": mean(self.likeliest.fde[key]),
                "log_likelihood": mean(logs),
                "log_likelihood_standard_error": standard_error(logs),
                "negative_log_likelihood": None if not logs else mean([-one for one in logs]),
                "ece": self.calibrated.error(key),
                "ece_of_horizon": self.calibrated_of_horizon.error(key),
                "ece_if_right": right,
                "ece_if_right_95": right_95,
                "ece_uncalibrated": self.plain.error(key),
                "overlap_free": _share_after(self.first_overlap, step),
                "on_road": _share_after(self.first_off_road, step),
                "baselines": self._baseline_summary(key),
            }
        return found

    def _chosen_for(self, key: str) -> dict[str, float | None]:
        return {str(modes): mean(self.of_horizon.get((key, modes), [])) for modes in self.modes}

    def _baseline_summary(self, key: str) -> dict[str, Any]:
        return {name: displacement.summary(errors, key) for name, errors in self.baselines.items()}


def _compare(errors: DisplacementErrors, modes_m: Floats, target: Target) -> None:
    future = target.future
    errors.add(modes_m, future.position_m, future.heading_rad, future.valid, target.speed_mps)


def _share_after(first: dict[str, list[Floats]], step: int) -> dict[str, float | None]:
    """Share of all modes to which it does not happen up to a step."""
    return {
        group: mean((np.concatenate(values) > step).tolist()) if values else None
        for group, values in first.items()
    }
