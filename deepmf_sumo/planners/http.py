"""A server of the user's on this machine drives the AV: views and commands as JSON over HTTP.

``POST <url>/reset`` and ``POST <url>/act`` with the messages of `remote.protocol` as bodies; the
answers are the bodies of responses with status 200. The server is started by the user and may drive
several episodes at a time: every message names its own. A server that is late or answers what
cannot be driven fails the run (`PlannerError`).
"""

from typing import Self
from urllib.parse import urlsplit

import numpy as np
from pydantic import model_validator

from deepmf_sumo.datatypes import Case, Command, VehicleModel, View
from deepmf_sumo.planners.remote import http_client, protocol
from deepmf_sumo.planners.remote.http_client import LOOPBACK, DoorSettings, Server


class Settings(DoorSettings):
    """Where the server is.

    Attributes:
        url: on this machine, e.g. ``http://127.0.0.1:8000/planner``.
    """

    url: str

    @model_validator(mode="after")
    def _is_on_this_machine(self) -> Self:
        try:
            parts = urlsplit(self.url)
            usable = parts.scheme == "http" and parts.port is not None
        except ValueError:  # a port that is none
            usable = False
        if not usable:
            raise ValueError(f"'{self.url}' must be like http://127.0.0.1:8000")
        if parts.hostname not in LOOPBACK:
            raise ValueError(
                f"'{self.url}' is not on this machine; use {' or '.join(LOOPBACK)}, and a tunnel"
                " to a server elsewhere"
            )
        return self


class HttpPlanner:
    """The simulation's side of a server."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._name = f"server {settings.url}"
        self._server = Server(self._name, settings.url)
        self._episode = ""
        self._model: VehicleModel | None = None

    @property
    def model(self) -> VehicleModel | None:
        """What the server asked for when it was ready."""
        return self._model

    def reset(self, case: Case, rng: np.random.Generator) -> None:
        """Tell the server. Its seed is the case's: ``rng`` also serves the adversary."""
        self._episode = http_client.episode_of(case)
        body = http_client.reset_message(case, road=self._settings.road)
        answer = self._server.ask("reset", body, self._settings.start_budget_s, "the reset")
        self._model = protocol.read_ready(self._name, answer)

    def act(self, view: View) -> Command:
        """The server's command. Raises PlannerError."""
        body = http_client.view_message(self._episode, view, self._settings.history_steps)
        answer = self._server.ask("act", body, self._settings.step_budget_s, f"step {view.step}")
        return protocol.read_command(self._name, answer, view.step)

    def close(self) -> None:
        """Close the connection; the server stays."""
        self._server.close()


def build(settings: Settings) -> HttpPlanner:
    """The planner."""
    return HttpPlanner(settings)
