"""The simulation's side of a remote planner: what it sends, and the answers that it accepts."""

import codecs
import json
import os
from collections.abc import Callable, Iterable
from dataclasses import asdict
from typing import Any, Final, Protocol

import numpy as np
from pydantic import Field, ValidationError

from deepmf_sumo.errors import PlannerError
from deepmf_sumo.planners.remote.protocol import COMMAND, COMMANDS, PROTOCOL, Ready
from deepmf_sumo.plugins import Settings, explain
from deepmf_sumo.scene import (
    Case,
    Command,
    Lane,
    Neighbour,
    Polygon,
    Polyline,
    RecordedCase,
    RoadMap,
    VehicleModel,
    View,
)
from deepmf_sumo.scene.scene import DT_S, HISTORY_STEPS


class RemoteSettings(Settings):
    """Limits of a planner outside the simulation, and what it is sent.

    Attributes:
        start_budget_s: wall time from the start of an episode to the planner's first answer.
        step_budget_s: wall time for one command.
        history_steps: steps of history in a view, the present one included.
        road: send the map with the reset.
    """

    start_budget_s: float = Field(default=30.0, gt=0.0)
    step_budget_s: float = Field(default=1.0, gt=0.0)
    history_steps: int = Field(default=HISTORY_STEPS, ge=1, le=HISTORY_STEPS)
    road: bool = True


class PlannerConnection(Protocol):
    """A planner that answers requests."""

    def ask(self, path: str, message: bytes, limit_s: float, what: str) -> bytes:
        """The answer to a message. Raises PlannerError if there is none in time.

        Args:
            path: ``reset`` or ``act``.
            message: one line of JSON.
            limit_s: for sending the message and receiving the answer.
            what: name of the request in error messages.
        """
        ...

    def close(self) -> None:
        """End of the episode."""
        ...


class RemotePlanner:
    """A planner outside the simulation, with a new connection for every episode.

    Args:
        name: of the planner in error messages.
        settings: limits.
        connect: connects for an episode.
    """

    def __init__(
        self, name: str, settings: RemoteSettings, connect: Callable[[], PlannerConnection]
    ) -> None:
        self._name = name
        self._settings = settings
        self._connect = connect
        self._connection: PlannerConnection | None = None
        self._episode = ""
        self._model: VehicleModel | None = None

    @property
    def model(self) -> VehicleModel | None:
        """The model that the planner asked for when it was ready."""
        return self._model

    def reset(self, case: Case, rng: np.random.Generator) -> None:
        """Connect and start the episode; its random numbers begin with the case's seed."""
        self.close()
        self._connection = self._connect()
        self._episode = episode_of(case)
        message = reset_message(case, road=self._settings.road)
        answer = self._connection.ask("reset", message, self._settings.start_budget_s, "the reset")
        self._model = read_ready(self._name, answer)

    def act(self, view: View) -> Command:
        """The planner's command. Raises PlannerError."""
        assert self._connection is not None
        message = view_message(self._episode, view, self._settings.history_steps)
        answer = self._connection.ask(
            "act", message, self._settings.step_budget_s, f"step {view.step}"
        )
        return read_command(self._name, answer, view.step)

    def close(self) -> None:
        """End of the episode."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None


def episode_of(case: Case) -> str:
    """Id of an episode among those that run at the same time."""
    return f"{case.name}#{os.getpid()}"


def reset_message(case: Case, *, road: bool) -> bytes:
    """Start of an episode, with or without the map."""
    return _line(
        {
            "type": "reset",
            "protocol": PROTOCOL,
            "episode": episode_of(case),
            "case": case.name,
            "seed": case.seed,
            "av_id": case.av_id,
            "dt_s": DT_S,
            "steps": case.duration_steps,
            "own_lane": isinstance(case, RecordedCase) and case.net.ghost_edge is not None,
            "road": _road(case.road) if road else None,
        }
    )


def view_message(episode: str, view: View, history_steps: int) -> bytes:
    """A view with ``history_steps`` steps of history, the present one included."""
    return _line(
        {
            "type": "view",
            "episode": episode,
            "step": view.step,
            "dt_s": view.dt_s,
            "steps_left": view.steps_left,
            "av_id": view.av_id,
            "agents": _agents(view, history_steps),
            "signals": {lane: state.name for lane, state in view.signals.items()},
            "av_path_m": None if view.av_path_m is None else view.av_path_m.tolist(),
            "av_recorded_steps": view.av_recorded_steps,
        }
    )


def _line(message: dict[str, Any]) -> bytes:
    return json.dumps(message, allow_nan=False, separators=(",", ":")).encode() + b"\n"


def _agents(view: View, history_steps: int) -> list[dict[str, Any]]:
    tracks = view.history
    last = tracks.window(max(0, tracks.steps - history_steps), tracks.steps)
    columns = {
        "id": last.ids,
        "kind": last.kinds,
        "size_m": last.size_m.tolist(),
        "x_m": last.position_m[..., 0].tolist(),
        "y_m": last.position_m[..., 1].tolist(),
        "z_m": last.z_m.tolist(),
        "heading_rad": last.heading_rad.tolist(),
        "vx_mps": last.velocity_mps[..., 0].tolist(),
        "vy_mps": last.velocity_mps[..., 1].tolist(),
        "valid": last.valid.tolist(),
    }
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _road(road: RoadMap) -> dict[str, Any]:
    return {
        "lanes": [_lane(lane) for lane in road.lanes.values()],
        "lines": [_drawn(line) for line in road.lines],
        "edges": [_drawn(edge) for edge in road.edges],
        "areas": [_drawn(area) for area in road.polygons],
        "buildings": [_drawn(area) for area in road.buildings],
        "footways": None if road.footways is None else [_drawn(area) for area in road.footways],
        "water": [_drawn(area) for area in road.water],
        "stop_signs": [
            {
                "id": one.id,
                "position_m": one.position_m.tolist(),
                "z_m": one.z_m,
                "lane_ids": list(one.lane_ids),
            }
            for one in road.stop_signs
        ],
    }


def _lane(lane: Lane) -> dict[str, Any]:
    def ids(neighbours: Iterable[Neighbour]) -> list[str]:
        return list(dict.fromkeys(one.lane_id for one in neighbours))

    return {
        "id": lane.id,
        "kind": lane.kind,
        "centre_m": lane.centre_m.tolist(),
        "z_m": lane.z_m.tolist(),
        "interpolating": lane.interpolating,
        "width_m": lane.width_m,
        "speed_limit_mps": lane.speed_limit_mps,
        "next": list(lane.next),
        "previous": list(lane.previous),
        "left": ids(lane.left),
        "right": ids(lane.right),
        "left_beside": [asdict(one) for one in lane.left],
        "right_beside": [asdict(one) for one in lane.right],
        "left_boundaries": [asdict(one) for one in lane.left_boundaries],
        "right_boundaries": [asdict(one) for one in lane.right_boundaries],
        "gives_way_to": list(lane.gives_way_to),
    }


def _drawn(one: Polyline | Polygon) -> dict[str, Any]:
    return {
        "id": one.id,
        "kind": one.kind,
        "points_m": one.points_m.tolist(),
        "z_m": one.z_m.tolist(),
    }


_NOT_AN_OBJECT: Final = {"dict_type", "model_type"}


def read_ready(name: str, text: bytes) -> VehicleModel | None:
    """The vehicle model that a planner asks for. Raises PlannerError with the planner's name."""
    try:
        model = Ready.model_validate_json(text.removeprefix(codecs.BOM_UTF8)).model
    except ValidationError as error:
        _check_is_object(name, text, error)
        for one in error.errors():
            if one["loc"] == ("protocol",):
                found = one["input"] if one["type"] != "missing" else None
                raise PlannerError(
                    f"{name} speaks protocol {_short(found)}, this is {PROTOCOL}: answer the reset"
                    f' with {{"type": "ready", "protocol": {PROTOCOL}}}.'
                ) from None
        raise PlannerError(f"{name} answered wrongly: {_cut(explain(error, Ready), 300)}") from None
    return None if model is None else VehicleModel(**model.model_dump())


def read_command(name: str, text: bytes, step: int) -> Command:
    """The command for a step. Raises PlannerError with the planner's name, key, value and rule."""
    try:
        answer = COMMAND.validate_json(text.removeprefix(codecs.BOM_UTF8))
    except ValidationError as error:
        _check_is_object(name, text, error)
        first = error.errors()[0]
        if not first["loc"]:
            kind = first["input"].get("kind")
            raise PlannerError(
                f"{name} answered kind {_short(kind)} at step {step}; known: {', '.join(COMMANDS)}."
            ) from None
        reason = explain(error, COMMANDS[str(first["loc"][0])], tagged=True)
        raise PlannerError(f"{name} at step {step} answered wrongly: {_cut(reason, 300)}") from None
    if answer.step != step:
        raise PlannerError(f"{name} answered for step {answer.step} when asked for step {step}.")
    return Command(**answer.model_dump(exclude={"type", "step"}))


def _check_is_object(name: str, text: bytes, error: ValidationError) -> None:
    """Raise PlannerError for an answer that is not a JSON object."""
    first = error.errors()[0]
    if first["type"] == "json_invalid":
        raise PlannerError(
            f"{name} answered {_short(text.decode(errors='replace'))}, which is not JSON; write"
            " everything but answers to stderr."
        ) from None
    if not first["loc"] and first["type"] in _NOT_AN_OBJECT:
        raise PlannerError(
            f"{name} answered {_short(first['input'])}, which is not a JSON object."
        ) from None


def _short(value: object) -> str:
    return _cut(repr(value), 80)


def _cut(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"{text[: longest - 3]}..."
