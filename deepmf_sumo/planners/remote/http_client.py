"""A planner behind HTTP: requests, time limits, answers."""

import contextlib
import json
import os
import socket
import threading
import time
from collections.abc import Iterable
from http.client import HTTPConnection, HTTPException
from typing import Any, Final
from urllib.parse import urlsplit

from pydantic import Field

from deepmf_sumo.datatypes import Case, Lane, Neighbour, Polyline, RecordedCase, RoadMap, View
from deepmf_sumo.datatypes.scene import DT_S, HISTORY_STEPS
from deepmf_sumo.errors import PlannerError
from deepmf_sumo.planners.remote.protocol import LONGEST_BYTES, PROTOCOL
from deepmf_sumo.plugins import Settings


def episode_of(case: Case) -> str:
    """Tells the episodes apart that run at the same time."""
    return f"{case.name}#{os.getpid()}"


def reset_message(case: Case, *, road: bool) -> bytes:
    """Start of an episode; ``road``: with the map."""
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
    """A step, with so many steps of history (now included)."""
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
        }
    )


def _line(message: dict[str, Any]) -> bytes:
    return json.dumps(message, allow_nan=False, separators=(",", ":")).encode() + b"\n"


def _agents(view: View, history_steps: int) -> list[dict[str, Any]]:
    tracks = view.history
    last = tracks.window(max(0, tracks.steps - history_steps), tracks.steps)
    columns = zip(
        last.ids,
        last.kinds,
        last.size_m.tolist(),
        last.position_m[..., 0].tolist(),
        last.position_m[..., 1].tolist(),
        last.z_m.tolist(),
        last.heading_rad.tolist(),
        last.velocity_mps[..., 0].tolist(),
        last.velocity_mps[..., 1].tolist(),
        last.valid.tolist(),
        strict=True,
    )
    names = (
        "id",
        "kind",
        "size_m",
        "x_m",
        "y_m",
        "z_m",
        "heading_rad",
        "vx_mps",
        "vy_mps",
        "valid",
    )
    return [dict(zip(names, column, strict=True)) for column in columns]


def _road(road: RoadMap) -> dict[str, Any]:
    return {
        "lanes": [_lane(lane) for lane in road.lanes.values()],
        "lines": _lines(road.lines),
        "edges": _lines(road.edges),
        "areas": [
            {"id": one.id, "kind": one.kind, "points_m": one.points_m.tolist()}
            for one in road.polygons
        ],
        "stop_signs": [
            {"id": one.id, "position_m": one.position_m.tolist(), "lane_ids": list(one.lane_ids)}
            for one in road.stop_signs
        ],
    }


def _lane(lane: Lane) -> dict[str, Any]:
    def beside(neighbours: Iterable[Neighbour]) -> list[str]:
        return list(dict.fromkeys(one.lane_id for one in neighbours))

    return {
        "id": lane.id,
        "kind": lane.kind,
        "centre_m": lane.centre_m.tolist(),
        "width_m": lane.width_m,
        "speed_limit_mps": lane.speed_limit_mps,
        "next": list(lane.next),
        "previous": list(lane.previous),
        "left": beside(lane.left),
        "right": beside(lane.right),
    }


def _lines(lines: Iterable[Polyline]) -> list[dict[str, Any]]:
    return [{"id": one.id, "kind": one.kind, "points_m": one.points_m.tolist()} for one in lines]


LOOPBACK: Final = ("127.0.0.1", "localhost", "::1")


class Server:
    """A server, over a connection that is kept between questions.

    Args:
        name: of the server in messages.
        url: its address and the path before those of the questions.
    """

    def __init__(self, name: str, url: str) -> None:
        parts = urlsplit(url)
        self._name = name
        self._path = parts.path.rstrip("/")
        self._host, self._port = parts.hostname or "", parts.port
        self._connection: HTTPConnection | None = None

    def ask(self, path: str, body: bytes, limit_s: float, what: str) -> bytes:
        """The body of the answer. Raises PlannerError where none comes in time.

        Args:
            path: of the question, under the server's own.
            body: what is said.
            limit_s: for connecting, saying it and hearing the answer.
            what: is asked, for messages.
        """
        deadline = time.monotonic() + limit_s
        try:
            connection = self._connected(limit_s)
            status, answer = self._exchange(connection, path, body, deadline)
        except (OSError, HTTPException) as error:
            self.close()
            if time.monotonic() >= deadline:
                raise PlannerError(
                    f"{self._name} did not answer {what} within {limit_s:g} s."
                ) from None
            raise PlannerError(f"{self._name} cannot be asked for {what}: {error}.") from None
        if status != 200:
            raise PlannerError(
                f"{self._name} answered {what} with status {status}: {answer[:200]!r}."
            )
        if len(answer) > LONGEST_BYTES:
            raise PlannerError(
                f"{self._name} answered {what} with more than {LONGEST_BYTES} bytes."
            )
        return answer

    def close(self) -> None:
        """Close the connection."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def _connected(self, limit_s: float) -> HTTPConnection:
        if self._connection is None:
            self._connection = HTTPConnection(self._host, self._port, timeout=limit_s)
            self._connection.connect()
        return self._connection

    def _exchange(
        self, connection: HTTPConnection, path: str, body: bytes, deadline: float
    ) -> tuple[int, bytes]:
        """Status and body, up to one byte too many.

        A socket's own time limit begins anew with every byte, and a server may send one at a time:
        so the connection is cut at the deadline.
        """
        cut = threading.Timer(deadline - time.monotonic(), _cut, [connection.sock])
        cut.daemon = True
        cut.start()
        try:
            headers = {"Content-Type": "application/json"}
            connection.request("POST", f"{self._path}/{path}", body, headers)
            response = connection.getresponse()
            answer = response.read(LONGEST_BYTES + 1)
        finally:
            cut.cancel()
        if time.monotonic() >= deadline:
            raise TimeoutError
        if not response.isclosed() or response.will_close:
            self.close()
        return response.status, answer


def _cut(connection: socket.socket) -> None:
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)


class DoorSettings(Settings):
    """Limits of a planner outside the simulation, and what it is told.

    Attributes:
        start_budget_s: wall time from the start of an episode to the planner's first answer.
        step_budget_s: wall time for one command.
        history_steps: how many steps a view shows, now included.
        road: whether the map is told at the beginning.
    """

    start_budget_s: float = Field(default=30.0, gt=0.0)
    step_budget_s: float = Field(default=1.0, gt=0.0)
    history_steps: int = Field(default=HISTORY_STEPS, ge=1, le=HISTORY_STEPS)
    road: bool = True
