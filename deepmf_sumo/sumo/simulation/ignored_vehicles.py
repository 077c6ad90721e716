"""Stationary vehicles beside the AV's path, for which SUMO would wait.

SUMO stops for each vehicle that is matched to the AV's lane, and for each foe inside a junction,
wherever it is there: foes in SUMO wait before the junction. Recorded ones wait a few metres inside,
and parked ones half on the lane. Stationary vehicles that do not reach into the AV's swept path are
therefore put on SUMO's ignore lists.
"""

import numpy as np

from deepmf_sumo.planners.perception import entries
from deepmf_sumo.scene import AgentId, Floats
from deepmf_sumo.scene.geometry.slow import WAITING_MPS
from deepmf_sumo.sumo.simulation.frame import Frame
from deepmf_sumo.sumo.simulation.sumo_api import SumoApi

_NEAR_M = 60.0
_MARGIN_M = 0.2
_IGNORED_BY = ("carFollowModel.ignoreIDs", "junctionModel.ignoreIDs")


class IgnoredVehicles:
    """Keeps SUMO's lists of vehicles that the AV ignores."""

    def __init__(self, api: SumoApi, av_id: AgentId, width_m: float) -> None:
        self._api = api
        self._id = av_id
        self._half_m = width_m / 2 + _MARGIN_M
        self._ignored = ""

    def update(self, frame: Frame, size_m: Floats, path_m: Floats | None) -> None:
        """Set the vehicles to ignore in the coming step.

        Args:
            frame: at the current step.
            size_m: (N, 2) length and width of its agents.
            path_m: centre line ahead of the AV; None off the lanes.
        """
        ids = "" if path_m is None else " ".join(self._beside(frame, size_m, path_m))
        if ids != self._ignored:
            self._ignored = ids
            for key in _IGNORED_BY:
                self._api.vehicle.setParameter(self._id, key, ids)

    def _beside(self, frame: Frame, size_m: Floats, path_m: Floats) -> list[AgentId]:
        near = np.hypot(*(frame.position_m - path_m[0]).T) < _NEAR_M
        slow = np.hypot(*frame.velocity_mps.T) < WAITING_MPS
        rows = [row for row in np.flatnonzero(near & slow) if frame.ids[row] != self._id]
        if not rows:
            return []
        gap, _ = entries(
            path_m, self._half_m, frame.position_m[rows], frame.heading_rad[rows], size_m[rows]
        )
        return [frame.ids[row] for row in np.array(rows)[~np.isfinite(gap)]]
