"""Targets of the trajectory networks, and how forecasts of them are measured."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from deepmf_sumo.scene import (
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
from deepmf_sumo.scene.geometry import boxes, road
from deepmf_sumo.scene.geometry.ground import clear, ground_of
from deepmf_sumo.training.evaluation.measures import HORIZONS, Measured, nearest_modes
from deepmf_sumo.training.evaluation.table import NETWORK, ObjectValues
from deepmf_sumo.training.samples import windows
from deepmf_sumo.training.samples.windows import Future

NEAR_M: Final = 50.0
"""In a scene without labels, vehicles that move within this distance of the AV are targets."""
FEW: Final = 6
"""Number of modes whose calibration is measured, and that motion forecasts usually have."""
RECORDED: Final = "recorded"
"""Condition of figures of what happened, which is measured by the same rules."""
_EVERY: Final = 5
"""The road is looked up every half second."""
NEVER: Final = FUTURE_STEPS
"""Step of what does not happen within 8 s."""
Role = Literal["av", "partner"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForecastTarget:
    """An object to predict.

    Attributes:
        future: its recorded motion. partner: the vehicle whose future may be given, if one is near.
        row: its row in the view. speed_mps: now.
        role: ``av``, or ``partner`` for any other vehicle.
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


def targets(scene: Scene, view: View) -> Iterator[ForecastTarget]:
    """The labelled vehicles of a scene; without labels, the AV and vehicles that move near it."""
    tracks = view.history
    origin = tracks.position_m[tracks.row(scene.av_id), -1]
    for future in windows.targets(scene, scene.now):
        row = tracks.row(future.agent_id)
        near = np.hypot(*(tracks.position_m[row, -1] - origin)) < NEAR_M
        if future.agent_id in scene.interest or (near and not scene.interest):
            yield ForecastTarget(
                scene=scene,
                view=view,
                future=future,
                partner=windows.partner_of(scene, future.agent_id, scene.now),
                row=row,
                speed_mps=float(tracks.speed_mps[row, -1]),
                role="av" if future.agent_id == scene.av_id else "partner",
            )


def first_overlap(target: ForecastTarget, position_m: Floats, heading_rad: Floats) -> Ints:
    """(M) first step at which the target's box overlaps another agent's, `NEVER` if none.

    Modes are (M, 80, 2) and (M, 80), not finite where unknown. The other agents move as recorded.
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
    heights = _heights_m(target, position_m[:, :steps])
    if heights is not None:
        others_m = tracks.z_m[others, now + 1 : stop]
        hit &= ~clear(heights[mode, step], others_m[agent, step])
    first = np.full(len(position_m), NEVER)
    np.minimum.at(first, mode[hit], step[hit])
    return first


def first_off_road(target: ForecastTarget, position_m: Floats) -> Ints:
    """(M) first half second, as a step, at which the centre is off the lanes, `NEVER` if none."""
    steps = np.arange(_EVERY - 1, FUTURE_STEPS, _EVERY)
    positions = position_m[:, steps]  # (M, 16, 2)
    known: Bools = np.isfinite(positions[..., 0])
    off = np.zeros(known.shape, bool)
    heights = _heights_m(target, positions)
    z_m = None if heights is None else heights[known]
    off[known] = ~road.on_road(target.view.road, positions[known], z_m)
    return np.where(off.any(1), steps[off.argmax(1)], NEVER)


def _heights_m(target: ForecastTarget, position_m: Floats) -> Floats | None:
    """(M, S) heights along paths (M, S, 2), which follow the road; None where it has one level.

    From a step on at which a path is not known its heights mean nothing.
    """
    ground, now = ground_of(target.view.road), target.view.history
    if not ground.has_levels:
        return None
    start = np.broadcast_to(now.position_m[target.row, -1], (len(position_m), 1, 2))
    paths = np.nan_to_num(np.concatenate([start, position_m], axis=1))
    return ground.follow(paths, np.full(len(paths), now.z_m[target.row, -1]))[:, 1:]


def plausibility(
    target: ForecastTarget, position_m: Floats, heading_rad: Floats
) -> dict[Measured, Floats]:
    """(M) up to each horizon: ``overlap_free`` of other agents, and ``on_road``."""
    overlap = first_overlap(target, position_m, heading_rad)
    off_road = first_off_road(target, position_m)
    return {
        (quantity, seconds): np.asarray(first > step, float)
        for quantity, first in (("overlap_free", overlap), ("on_road", off_road))
        for seconds, (step, *_) in HORIZONS.items()
    }


def add_shapes(
    samples: ObjectValues,
    target: ForecastTarget,
    found: Mapping[int, Forecast],
    uncalibrated: Forecast,
    condition: str = NETWORK,
) -> None:
    """Add the plausibility and the calibration of one target's forecasts by number of modes.

    ``uncalibrated`` is the forecast of `FEW` modes at temperature 1. The recorded motion is
    measured by the same rules: recorded vehicles leave the lanes too, and boxes are not exact.
    """
    for modes, forecast in found.items():
        futures = forecast.futures
        samples.add(plausibility(target, futures.position_m, futures.heading_rad), modes, condition)
    samples.add(nearest_modes(found[FEW], target.future), FEW, condition)
    samples.add(nearest_modes(uncalibrated, target.future, "_uncalibrated"), FEW, condition)
    known = target.future.valid
    position = np.where(known[:, None], target.future.position_m, np.nan)
    heading = np.where(known, target.future.heading_rad, np.nan)
    samples.add(plausibility(target, position[None], heading[None]), condition=RECORDED)
