"""The car-following model of the AV's vehicle type in SUMO drives the AV.

It stops for an opponent that stands in its way, too, whatever lane SUMO counts that on.
"""

import numpy as np

from deepmf_sumo.plugins import Settings as PluginSettings
from deepmf_sumo.scene import Case, Command, VehicleModel, View


class Settings(PluginSettings):
    """No settings."""


class SumoPlanner:
    """SUMO's own model, unchanged."""

    @property
    def model(self) -> VehicleModel | None:
        """None: the vehicle type of the network stays."""
        return None

    def reset(self, case: Case, rng: np.random.Generator) -> None:
        """Nothing to prepare."""

    def act(self, view: View) -> Command:
        """SUMO drives."""
        return Command(kind="sumo")


def build(settings: Settings) -> SumoPlanner:
    """The planner."""
    return SumoPlanner()
