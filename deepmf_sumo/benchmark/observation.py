"""A view as arrays of fixed shapes, in the AV's frame."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo.datatypes import Case, Floats, Rollout, View
from deepmf_sumo.datatypes.scene import HISTORY_STEPS
from deepmf_sumo.geometry import frames, polylines

Array = NDArray[np.float32]

PATH_POINTS: Final = 20
PATH_SPACING_M: Final = 5.0


class Observer:
    """Arrays of a view.

    ``av``: (3) speed, length, width. ``agents``: (N, 8) the nearest first: 1, x, y, heading, vx,
    vy, length, width; rows of zeros where there are fewer. ``path``: (20, 3) every 5 m ahead along
    the AV's way: 1, x, y; rows of zeros beyond its end. Metres, m/s, radians; x ahead, y left.

    Args:
        agents: N.
    """

    def __init__(self, agents: int) -> None:
        self.shapes = {"av": (3,), "agents": (agents, 8), "path": (PATH_POINTS, 3)}

    def observe(self, view: View) -> dict[str, Array]:
        """float32 arrays of `shapes`."""
        tracks = view.history
        me = tracks.row(view.av_id)
        origin, heading = tracks.position_m[me, -1], float(tracks.heading_rad[me, -1])
        length, width = tracks.size_m[me, :2]
        found = {
            "av": np.array([tracks.speed_mps[me, -1], length, width]),
            "agents": self._agents(view, me, origin, heading),
            "path": _path(view, origin, heading),
        }
        return {
            name: _filled(np.asarray(found[name]), shape) for name, shape in self.shapes.items()
        }

    def last_view(self, rollout: Rollout, case: Case) -> View:
        """The AV's last step, which no planner is asked about: without a path."""
        tracks = rollout.tracks
        step = int(np.flatnonzero(tracks.valid[tracks.row(rollout.av_id)])[-1])
        shown = tracks.window(max(0, step + 1 - HISTORY_STEPS), step + 1)
        return View(
            step=step,
            dt_s=rollout.dt_s,
            av_id=rollout.av_id,
            history=shown.select(np.flatnonzero(shown.valid[:, -1]).tolist()),
            road=case.road,
            signals=rollout.signals[-1],
            steps_left=rollout.now + case.duration_steps - step,
        )

    def _agents(self, view: View, me: int, origin: Floats, heading: float) -> Floats:
        tracks = view.history
        local = frames.to_local(tracks.position_m[:, -1], origin, heading)
        velocity = frames.to_local(tracks.velocity_mps[:, -1], np.zeros(2), heading)
        turned = frames.wrap(tracks.heading_rad[:, -1] - heading)
        table = np.column_stack(
            [np.ones(len(local)), local, turned, velocity, tracks.size_m[:, :2]]
        )
        away = np.hypot(*local.T)
        away[me] = np.inf
        nearest: Floats = table[np.argsort(away, kind="stable")[:-1]]
        return nearest


def _path(view: View, origin: Floats, heading: float) -> Floats:
    """(K, 3) points along the AV's way; none where it is on no lane."""
    if view.av_path_m is None or polylines.arc_lengths(view.av_path_m)[-1] < PATH_SPACING_M:
        return np.zeros((0, 3))
    length = polylines.arc_lengths(view.av_path_m)[-1]
    count = min(PATH_POINTS, int(length / PATH_SPACING_M))
    along = PATH_SPACING_M * np.arange(1.0, count + 1.0)
    points, _ = polylines.points_at(view.av_path_m, along)
    return np.column_stack([np.ones(len(along)), frames.to_local(points, origin, heading)])


def _filled(table: Floats, shape: tuple[int, ...]) -> Array:
    """float32 of the shape: cut, or with zeros after it."""
    array = np.zeros(shape, np.float32)
    kept = table[: shape[0]]
    array[: len(kept)] = kept
    return array
