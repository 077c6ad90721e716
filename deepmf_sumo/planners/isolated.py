"""A Python planner in a separate process, with a time limit for each step.

For planners that may hang or crash, or whose libraries must not share a process with SUMO's. It is
sent the messages of `remote.protocol` and nothing else: recordings stay with the simulation.
"""

import json
import os
import sys
from functools import partial
from typing import Any, Self

from pydantic import Field, model_validator

from deepmf_sumo import plugins
from deepmf_sumo.errors import PluginError
from deepmf_sumo.planners.remote.client import RemotePlanner, RemoteSettings
from deepmf_sumo.planners.remote.process import started


class Settings(RemoteSettings):
    """Choice of the planner.

    Attributes:
        planner: ``my_package.my_module:MyPlanner``, or a plug-in.
        settings: of that planner.
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


def build(settings: Settings) -> RemotePlanner:
    """The planner."""
    command = [
        *(sys.executable, "-m", "deepmf_sumo.planners.remote.serve", settings.planner),
        *("--settings", json.dumps(settings.settings, default=str)),  # YAML has dates, too
        *("--path", os.pathsep.join(sys.path)),
    ]
    name = f"planner '{settings.planner}'"
    return RemotePlanner(name, settings, partial(started, name, command))
