"""Forecasts of several numbers of modes against what happened: error, certainty, plausibility."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from deepmf_sumo.datatypes import Floats, Forecast
from deepmf_sumo.training.evaluation import displacement, plausibility
from deepmf_sumo.training.evaluation.calibration import ModeCalibration
from deepmf_sumo.training.evaluation.displacement import HORIZONS, DisplacementErrors
from deepmf_sumo.training.evaluation.estimates import mean
from deepmf_sumo.training.evaluation.targets import Target

FEW: Final = 6
"""Modes of the calibration, and of what a motion forecast usually gives."""


@dataclass(slots=True)
class ForecastModes:
    """What has been measured of one network's forecasts.

    Attributes:
        modes: numbers of modes, `FEW` among them.
        errors: of the best of so many modes. likeliest: of the most probable of `FEW`.
        calibrated, plain: of `FEW` modes, at the fitted temperature and at 1.
        first_overlap, first_off_road: by number of modes, steps (M) for each object.
    """

    modes: Sequence[int]
    errors: dict[int, DisplacementErrors] = field(init=False)
    likeliest: DisplacementErrors = field(default_factory=DisplacementErrors)
    calibrated: ModeCalibration = field(default_factory=ModeCalibration)
    plain: ModeCalibration = field(default_factory=ModeCalibration)
    first_overlap: dict[str, list[Floats]] = field(init=False)
    first_off_road: dict[str, list[Floats]] = field(init=False)

    def __post_init__(self) -> None:
        self.errors = {modes: DisplacementErrors() for modes in self.modes}
        groups = (*map(str, self.modes), "recorded")
        self.first_overlap = {group: [] for group in groups}
        self.first_off_road = {group: [] for group in groups}

    def add(self, target: Target, found: Mapping[int, Forecast], warm: Forecast) -> None:
        """One object: forecasts by number of modes, and that of `FEW` at temperature 1."""
        for modes, forecast in found.items():
            compare(self.errors[modes], forecast.futures.position_m, target)
            self._plausible(
                str(modes), target, forecast.futures.position_m, forecast.futures.heading_rad
            )
        compare(self.likeliest, found[FEW].futures.position_m[:1], target)
        self._recorded(target)
        self.calibrated.add(found[FEW], target.future)
        self.plain.add(warm, target.future)

    def _recorded(self, target: Target) -> None:
        """What happened, by the same rules: people leave the lanes too, and boxes are not exact."""
        known = target.future.valid
        position = np.where(known[:, None], target.future.position_m, np.nan)
        heading = np.where(known, target.future.heading_rad, np.nan)
        self._plausible("recorded", target, position[None], heading[None])

    def _plausible(
        self, group: str, target: Target, position_m: Floats, heading_rad: Floats
    ) -> None:
        overlap = plausibility.first_overlap(target, position_m, heading_rad)
        self.first_overlap[group].append(overlap.astype(float))
        off = plausibility.first_off_road(target, position_m)
        self.first_off_road[group].append(off.astype(float))

    def displacement(self, key: str) -> dict[str, Any]:
        """Errors at a horizon (`displacement.summary`), and those of the most probable mode."""
        return {
            "objects": len(self.likeliest.fde[key]),
            **displacement.summary(self.errors, key),
            "most_probable_fde": mean(self.likeliest.fde[key]),
        }

    def plausibility(self, key: str) -> dict[str, Any]:
        """Shares of modes that keep clear of others, and on the lanes, up to a horizon."""
        step, *_ = HORIZONS[key]
        return {
            "overlap_free": _share_after(self.first_overlap, step),
            "on_road": _share_after(self.first_off_road, step),
        }

    def calibration(self, key: str) -> dict[str, float | None]:
        """Calibration error of `FEW` modes, and what as many right probabilities would show."""
        right, right_95 = self.calibrated.error_if_right(key)
        return {
            "ece": self.calibrated.error(key),
            "ece_if_right": right,
            "ece_if_right_95": right_95,
            "ece_uncalibrated": self.plain.error(key),
        }


def compare(errors: DisplacementErrors, modes_m: Floats, target: Target) -> None:
    """Add the errors of modes (M, 80, 2) of a target."""
    future = target.future
    errors.add(modes_m, future.position_m, future.heading_rad, future.valid, target.speed_mps)


def _share_after(first: dict[str, list[Floats]], step: int) -> dict[str, float | None]:
    """Share of all modes to which it does not happen up to a step."""
    return {
        group: mean((np.concatenate(values) > step).tolist()) if values else None
        for group, values in first.items()
    }
