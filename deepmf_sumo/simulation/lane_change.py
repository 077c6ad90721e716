"""Lane changes that take SUMO several steps (`lanechange.duration`).

SUMO moves such a vehicle over by time, whoever else moves it. If that one puts it beyond the border
of its lane before SUMO has it half way across, SUMO 1.28 crashes: it looks for one more lane to
move it over to, and there is none. So who takes a vehicle over has the change ended first.
"""

from typing import Final

from deepmf_sumo.datatypes import AgentId
from deepmf_sumo.simulation.sumo_api import SumoApi

_AT_ONCE_MPS: Final = 1000.0


class LaneChange:
    """Ends the lane change of a vehicle that is about to be put somewhere."""

    def __init__(self, api: SumoApi) -> None:
        self._api = api
        self._hurried: tuple[AgentId, float] | None = None

    def end(self, vehicle_id: AgentId) -> None:
        """In the coming step, if one is under way.

        The sublane model has none: there a vehicle moves sideways as it likes.
        """
        vehicle = self._api.vehicle
        if float(vehicle.getLateralSpeed(vehicle_id)) == 0.0:
            return
        if float(self._api.simulation.getOption("lateral-resolution")) > 0:
            return
        self._hurried = vehicle_id, float(vehicle.getMaxSpeedLat(vehicle_id))
        vehicle.setMaxSpeedLat(vehicle_id, _AT_ONCE_MPS)

    def after_step(self) -> None:
        """The vehicle's own speed sideways again."""
        if self._hurried is None:
            return
        vehicle_id, speed_mps = self._hurried
        self._hurried = None
        if vehicle_id in self._api.vehicle.getIDList():
            self._api.vehicle.setMaxSpeedLat(vehicle_id, speed_mps)
