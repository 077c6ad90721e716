"""Targets of the trajectory networks, and forecasts of several numbers of modes against them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np

from deepmf_sumo.datatypes import (
    FUTURE_STEPS,
    ROLLOUT,
    AgentId,
    Bools,
    Floats,
    Forecast,
    Ints,
    Scene,
    View,
)
from deepmf_sumo.geometry import boxes, road
from deepmf_sumo.training.evaluation.measures import (
    HORIZONS,
    DisplacementErrors,
    ModeCalibration,
    error_summary,
    mean,
)
from deepmf_sumo.training.samples import windows
from deepmf_sumo.training.samples.windows import Future

NEAR_M: Final = 50.0
"""Where a scene has no labels, vehicles that move within this distance of the AV are targets."""
FEW: Final = 6
"""Modes of the calibration, and of what a motion forecast usually gives."""
_EVERY: Final = 5
"""The road is looked up each half second."""
NEVER: Final = FUTURE_STEPS
"""Step of what does not happen within 8 s."""
Role = Literal["av", "partner"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Target:
    """An object to predict.

    Attributes:
        future: what it did. partner: the vehicle whose future may be given, if one is near.
        row: its row in the view. speed_mps: now.
        role: ``av``, or ``partner`` for any other.
    """

    scene: Scene
    view: View
    future: Future
    partner: Future | None
    row: int
    speed_mps: float
    role: Role

    @property
    def agent_id(self) -> AgentId:
        """Its id."""
        return self.future.agent_id

    @property
    def planner(self) -> bool:
        """Whether an automated planner drives it: the AV of an attack."""
        return self.scene.source.dataset == ROLLOUT and self.role == "av"


def targets(scene: Scene, view: View) -> Iterator[Target]:
    """The labelled vehicles of a scene; without labels, the AV and what moves near it."""
    tracks = view.history
    origin = tracks.position_m[tracks.row(scene.av_id), -1]
    for future in windows.targets(scene, scene.now):
        row = tracks.row(future.agent_id)
        near = np.hypot(*(tracks.position_m[row, -1] - origin)) < NEAR_M
        if future.agent_id in scene.interest or (near and not scene.interest):
            yield Target(
                scene=scene,
                view=view,
                future=future,
                partner=windows.partner_of(scene, future.agent_id, scene.now),
                row=row,
                speed_mps=float(tracks.speed_mps[row, -1]),
                role="av" if future.agent_id == scene.av_id else "partner",
            )


def first_overlap(target: Target, position_m: Floats, heading_rad: Floats) -> Ints:
    """(M) first step at which the target's box overlaps another agent's, `NEVER` if none.

    Modes are (M, 80, 2) and (M, 80), not finite where nothing is known. The others do what they
    did.
    """
    tracks, now = target.scene.tracks, target.view.step
    stop = min(now + 1 + FUTURE_STEPS, tracks.steps)
    steps = stop - now - 1
    others = np.arange(tracks.agents) != tracks.row(target.agent_id)
    centre = tracks.position_m[others, now + 1 : stop]  # (A, F, 2)
    there = tracks.valid[others, now + 1 : stop]
    size = tracks.size_m[:, :2]
    own_size = size[tracks.row(target.agent_id)]
    reach = (np.hypot(*own_size) + np.hypot(*size[others].T)) / 2  # (A)
    offset = position_m[:, None, :steps] - centre  # (M, A, F, 2)
    near = (offset[..., 0] ** 2 + offset[..., 1] ** 2 < reach[:, None] ** 2) & there
    mode, agent, step = near.nonzero()
    hit = boxes.overlap(
        position_m[mode, step],
        heading_rad[mode, step],
        own_size,
        centre[agent, step],
        tracks.heading_rad[others, now + 1 : stop][agent, step],
        size[others][agent],
    )
    first = np.full(len(position_m), NEVER)
    np.minimum.at(first, mode[hit], step[hit])
    return first


def first_off_road(target: Target, position_m: Floats) -> Ints:
    """(M) first half second, as a step, at which the centre is off the lanes, `NEVER` if none."""
    steps = np.arange(_EVERY - 1, FUTURE_STEPS, _EVERY)
    places = position_m[:, steps]  # (M, 16, 2)
    known: Bools = np.isfinite(places[..., 0])
    off = np.zeros(known.shape, bool)
    off[known] = ~road.on_road(target.view.road, places[known])
    return np.where(off.any(1), steps[off.argmax(1)], NEVER)


@dataclass(slots=True)
class ForecastModes:
    """What has been measured of one network's forecasts.

    Attributes:
        modes: numbers of modes, `FEW` among them.
        errors: of the best mode, by number of modes. likeliest: of the most probable of `FEW`.
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
        overlap = first_overlap(target, position_m, heading_rad)
        self.first_overlap[group].append(overlap.astype(float))
        off = first_off_road(target, position_m)
        self.first_off_road[group].append(off.astype(float))

    def displacement(self, key: str) -> dict[str, Any]:
        """Errors at a horizon (`error_summary`), and those of the most probable mode."""
        return {
            "objects": len(self.likeliest.fde[key]),
            **error_summary(self.errors, key),
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
