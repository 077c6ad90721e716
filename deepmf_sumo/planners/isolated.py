"""A Python planner in a process of its own, with a time limit for each step.

For planners that may hang or crash, or that hold libraries which must not meet SUMO's in one
process. It is told what `remote.protocol` says and no more: recordings stay with the simulation.
"""

import json
import os
import sys
from typing import Any, Self

from pydantic import Field, model_validator

from deepmf_sumo import plugins
from deepmf_sumo.errors import PluginError
from deepmf_sumo.planners.remote.http_client import DoorSettings
from deepmf_sumo.planners.remote.process import ProgramPlanner


class Settings(DoorSettings):
    """Which planner.

    Attributes:
        planner: ``my_package.my_module:MyPlanner``, or a plug-in.
        settings: its own.
    """

    planner: str
    settings: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _is_a_planner(self) -> Self:
        try:
            plugins.settings("planners", self.planner, self.settings)
        except PluginError as error:
            raise ValueError(str(error)) from None
        return self


def build(settings: Settings) -> ProgramPlanner:
    """The planner."""
    command = [
        *(sys.executable, "-m", "deepmf_sumo.planners.remote.serve", settings.planner),
        *("--settings", json.dumps(settings.settings)),
        *("--path", os.pathsep.join(sys.path)),
    ]
    return ProgramPlanner(f"planner '{settings.planner}'", command, settings)
