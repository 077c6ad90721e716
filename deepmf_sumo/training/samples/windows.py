"""Scene -> the view of a predictor at a step, and the future after it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from deepmf_sumo.scene import (
    FUTURE_STEPS,
    HISTORY_STEPS,
    ROLLOUT,
    AgentId,
    Bools,
    Floats,
    Scene,
    Tracks,
    View,
)
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.ground import clear, ground_of
from deepmf_sumo.scene.road_users import PEOPLE

MIN_FUTURE_STEPS: Final = 30
"""Targets are known for at least 3 s."""
MIN_ATTACKED_STEPS: Final = 10
"""An attacked AV is known for at least 1 s: its motion just before a contact matters most."""
MIN_DISTANCE_M: Final = 2.0
"""Vehicles that move less are not targets, except the AV and labelled agents."""
LABELS: Final = 2
"""Increased when targets or partners change, so that samples are made again."""
_FARTHEST_M: Final = 30.0
"""Vehicles that stay farther away, in space and time, are not partners."""
_MAX_STEP_M: Final = 12.0
"""Tracks that move farther in 0.1 s are errors of the tracker."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Future:
    """The motion of an agent after the view, in the scene's frame.

    Attributes:
        position_m: (80, 2). z_m, heading_rad: (80). valid: (80).
    """

    agent_id: AgentId
    position_m: Floats
    z_m: Floats
    heading_rad: Floats
    valid: Bools


def view_at(scene: Scene, step: int) -> View:
    """The view at a step of a recording, with the agents that are valid at the step."""
    window = scene.tracks.window(step - HISTORY_STEPS + 1, step + 1)
    rows = np.flatnonzero(window.valid[:, -1]).tolist()
    return View(
        step=step,
        dt_s=scene.dt_s,
        av_id=scene.av_id,
        history=window.select(rows),
        road=scene.road,
        signals=scene.signals.at(step),
        steps_left=scene.tracks.steps - 1 - step,
        av_recorded_steps=_recorded_steps(scene, step),
    )


def _recorded_steps(scene: Scene, step: int) -> int:
    """Number of the last 10 steps in which the AV of an attack still drove as recorded."""
    if scene.source.dataset != ROLLOUT or not scene.source.sha256:
        return 0  # not a log, or traffic that SUMO also drove before
    return min(max(scene.now + HISTORY_STEPS - 1 - step, 0), HISTORY_STEPS - 1)


def future_of(scene: Scene, agent_id: AgentId, step: int) -> Future:
    """The 80 steps after ``step``; invalid where the recording has ended."""
    tracks, row = scene.tracks, scene.tracks.row(agent_id)
    position = np.zeros((FUTURE_STEPS, 2))
    height, heading = np.zeros((2, FUTURE_STEPS))
    valid = np.zeros(FUTURE_STEPS, bool)
    stop = min(step + 1 + FUTURE_STEPS, tracks.steps)
    count = stop - step - 1
    position[:count] = tracks.position_m[row, step + 1 : stop]
    height[:count] = tracks.z_m[row, step + 1 : stop]
    heading[:count] = tracks.heading_rad[row, step + 1 : stop]
    valid[:count] = tracks.valid[row, step + 1 : stop]
    return Future(
        agent_id=agent_id, position_m=position, z_m=height, heading_rad=heading, valid=valid
    )


def least_steps(scene: Scene) -> int:
    """Number of steps after a window in which a target must be known."""
    return MIN_ATTACKED_STEPS if scene.source.dataset == ROLLOUT else MIN_FUTURE_STEPS


def targets(scene: Scene, step: int) -> Iterator[Future]:
    """Futures of vehicles to learn from: known for long enough, and moving or labelled.

    In a simulated attack this is only the AV: its opponent follows a plan, the others the log.
    """
    tracks = scene.tracks
    labelled = {scene.av_id, *scene.interest}
    attacked = scene.source.dataset == ROLLOUT
    for row, agent_id in enumerate(tracks.ids):
        if tracks.kinds[row] != "vehicle" or not tracks.valid[row, step]:
            continue
        if attacked and agent_id != scene.av_id:
            continue
        future = future_of(scene, agent_id, step)
        known, least = np.flatnonzero(future.valid), least_steps(scene)
        if len(known) < least or known[-1] < least - 1:
            continue
        if jumps(tracks, row):
            continue
        away = future.position_m[known[-1]] - tracks.position_m[row, step]
        if agent_id in labelled or np.hypot(*away) > MIN_DISTANCE_M:
            yield future


def people(scene: Scene, step: int) -> Iterator[Future]:
    """Futures of pedestrians and cyclists, whether they move or not: known at 1 s or later.

    A person that stands still is a target, too: that it may go is what is to be predicted.
    """
    tracks = scene.tracks
    for row, agent_id in enumerate(tracks.ids):
        if tracks.kinds[row] not in PEOPLE or not tracks.valid[row, step]:
            continue
        if agent_id == scene.av_id or jumps(tracks, row):
            continue
        future = future_of(scene, agent_id, step)
        if future.valid[MIN_ATTACKED_STEPS - 1 :].any():
            yield future


def partner_of(scene: Scene, agent_id: AgentId, step: int) -> Future | None:
    """The future that matters most to the agent: the labelled partner's, else the closest.

    The closeness of two futures is the minimum of distance plus 2 m per second between them, of
    places on one level of the road.
    """
    attacked = scene.source.dataset == ROLLOUT
    if agent_id in scene.interest and (attacked or step == scene.now):
        other = [each for each in scene.interest if each != agent_id]
        if other and _known(scene, other[0], step):
            return _filled(scene, future_of(scene, other[0], step), step)
    others = [each for each in _movers(scene, step) if each.agent_id != agent_id]
    return _closest(scene, agent_id, step, others, _FARTHEST_M)


def nearest_person(scene: Scene, agent_id: AgentId, step: int, within_m: float) -> Future | None:
    """The future, without gaps, of the person that comes closest to an agent, as `partner_of`."""
    others = [
        _filled(scene, each, step)
        for each in people(scene, step)
        if _known(scene, each.agent_id, step)
    ]
    return _closest(scene, agent_id, step, others, within_m)


def _closest(
    scene: Scene, agent_id: AgentId, step: int, others: Sequence[Future], within_m: float
) -> Future | None:
    if not others:
        return None
    mine = _filled(scene, future_of(scene, agent_id, step), step)
    own = mine.position_m[4::5]
    times = np.arange(len(own)) * 0.5
    late = 2.0 * np.abs(times[:, None] - times)
    ways = np.stack([each.position_m[4::5] for each in others])
    apart = np.linalg.norm(own[:, None] - ways[:, None], axis=-1) + late  # (A, 16, 16)
    if ground_of(scene.road).has_levels:
        heights = np.stack([each.z_m[4::5] for each in others])
        apart[clear(mine.z_m[4::5][:, None], heights[:, None])] = np.inf
    least = apart.min(axis=(1, 2))
    return others[int(least.argmin())] if least.min() < within_m else None


def local_future(view: View, agent_id: AgentId, future: Future) -> Floats:
    """(80, 3) x, y, heading of a future in the frame of ``agent_id`` at the view."""
    row = view.history.row(agent_id)
    origin, heading = view.history.position_m[row, -1], float(view.history.heading_rad[row, -1])
    local = frames.to_local(future.position_m, origin, heading)
    turn = frames.wrap(future.heading_rad - heading)
    return np.concatenate([local, turn[:, None]], axis=1)


@lru_cache(maxsize=2)
def _movers(scene: Scene, step: int) -> tuple[Future, ...]:
    """Futures, without gaps, of all vehicles that move after the step."""
    found = []
    for row, agent_id in enumerate(scene.tracks.ids):
        if scene.tracks.kinds[row] != "vehicle" or not _known(scene, agent_id, step):
            continue
        future = _filled(scene, future_of(scene, agent_id, step), step)
        away = np.hypot(*(future.position_m[-1] - future.position_m[0]))
        if away > MIN_DISTANCE_M and not jumps(scene.tracks, row):
            found.append(future)
    return tuple(found)


def _known(scene: Scene, agent_id: AgentId, step: int) -> bool:
    row = scene.tracks.row(agent_id)
    valid = scene.tracks.valid[row]
    ahead = valid[step + 1 : step + 1 + FUTURE_STEPS]
    return bool(valid[step] and ahead.sum() >= MIN_FUTURE_STEPS)


def _filled(scene: Scene, future: Future, step: int) -> Future:
    """A complete future: gaps are interpolated, the end continues at constant velocity."""
    row = scene.tracks.row(future.agent_id)
    known = np.flatnonzero(future.valid)
    if len(known) == FUTURE_STEPS or len(known) == 0:
        return future
    steps = np.arange(FUTURE_STEPS)
    position = np.stack(
        [np.interp(steps, known, future.position_m[known, axis]) for axis in (0, 1)], axis=1
    )
    height = np.interp(steps, known, future.z_m[known])
    heading = np.interp(steps, known, np.unwrap(future.heading_rad[known]))
    last = int(known[-1])
    velocity = scene.tracks.velocity_mps[row, step + 1 + last]
    position[last:] += (steps[last:] - last)[:, None] * scene.dt_s * velocity
    valid = np.ones(FUTURE_STEPS, bool)
    return Future(
        agent_id=future.agent_id,
        position_m=position,
        z_m=height,
        heading_rad=frames.wrap(heading),
        valid=valid,
    )


def jumps(tracks: Tracks, row: int) -> bool:
    """Whether an agent moves farther in a step than vehicles can: an error of the tracker."""
    valid = tracks.valid[row]
    both = valid[1:] & valid[:-1]
    step = np.diff(tracks.position_m[row], axis=0)[both]
    return bool(len(step) and np.hypot(step[:, 0], step[:, 1]).max() > _MAX_STEP_M)
