"""A Python planner as a program or a server: ``python -m deepmf_sumo.planners.remote.serve NAME``.

It runs in a separate process, with its own memory and within a time limit. Planners in other
languages can be compared with it. ``NAME`` is a plug-in (``idm``) or
``my_package.my_module:MyPlanner``; ``--settings`` is a JSON object; ``--port`` makes it a server on
127.0.0.1 (0 chooses a port; its address is the first line on stdout).
"""

import argparse
import json
import os
import sys
import traceback
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from threading import Lock
from typing import Any, Final

import numpy as np
from pydantic import ValidationError

from deepmf_sumo import plugins
from deepmf_sumo.errors import DeepmfError, PlannerError
from deepmf_sumo.local_http import LocalHandler, LocalServer
from deepmf_sumo.planners.base import Planner
from deepmf_sumo.planners.remote.protocol import (
    NUMBERS,
    PROTOCOL,
    QUESTION,
    AreaMessage,
    BesideMessage,
    BoundaryMessage,
    LaneMessage,
    LineMessage,
    Points,
    Reset,
    RoadMessage,
    ViewMessage,
)
from deepmf_sumo.scene import (
    Boundary,
    Case,
    Command,
    Floats,
    Lane,
    Neighbour,
    Polygon,
    Polyline,
    RecordedCase,
    RoadMap,
    Scene,
    Signals,
    SignalState,
    Source,
    StopSign,
    SumoNet,
    Tracks,
    TrafficCase,
    VehicleModel,
    View,
)

_LARGEST: Final = 2**28
"""Limit of a message in bytes: the map of a city is about 10 MB."""

_EPISODES: Final = 64
"""Number of episodes that a server keeps: no message says that one has ended."""


class Answerer:
    """Answers messages with planners of one plug-in, one planner for each episode."""

    def __init__(self, name: str, settings: dict[str, Any]) -> None:
        self._plugin = plugins.load("planners", name)
        self._settings = plugins.settings("planners", name, settings)
        self._episodes: dict[str, tuple[Planner, RoadMap]] = {}
        self._lock = Lock()

    def answer(self, text: bytes) -> bytes:
        """The answer, as a line of JSON."""
        with self._lock:
            message = read(text)
            answer = self._reset(message) if isinstance(message, Reset) else self._act(message)
        return json.dumps(answer, allow_nan=False).encode() + b"\n"

    def _reset(self, message: Reset) -> dict[str, object]:
        planner: Planner = self._plugin.build(self._settings)
        case = case_of(message)
        planner.reset(case, np.random.default_rng(message.seed))
        for oldest in list(self._episodes)[: 1 - _EPISODES]:
            del self._episodes[oldest]
        self._episodes[message.episode] = (planner, case.road)
        return ready_answer(planner.model)

    def _act(self, message: ViewMessage) -> dict[str, object]:
        if message.episode not in self._episodes:
            raise PlannerError(f"a view of episode '{message.episode}' before its reset.")
        planner, road = self._episodes[message.episode]
        command = planner.act(view_of(message, road))
        return command_answer(command, message.step)


def on_streams(answerer: Answerer) -> None:
    """Answer messages from stdin on stdout, until stdin ends.

    What the planner prints goes to stderr, so that stdout has nothing but answers.
    """
    with os.fdopen(os.dup(1), "wb", buffering=0) as answers:
        os.dup2(2, 1)
        for line in sys.stdin.buffer:
            answers.write(answerer.answer(line))


def on_port(answerer: Answerer, port: int) -> LocalServer:
    """A server that answers POST requests once ``serve_forever`` is called."""

    class Handler(LocalHandler):
        protocol_version = "HTTP/1.1"
        disable_nagle_algorithm = True
        wbufsize = -1

        def do_POST(self) -> None:  # noqa: N802 - of the base class
            """Answer a message."""
            length = self.headers.get("Content-Length", "0")
            known = length.isascii() and length.isdecimal() and len(length) < 20
            body = self.rfile.read(int(length)) if known and int(length) <= _LARGEST else None
            try:
                if body is None:
                    self.close_connection = True  # the body is not read
                    raise PlannerError(
                        f"Content-Length is {length!r:.80}; it must be a number of bytes, at most"
                        f" {_LARGEST}."
                    )
                status, answer = 200, answerer.answer(body)
            except DeepmfError as error:
                status, answer = 400, str(error).encode(errors="replace")
            except Exception as error:  # noqa: BLE001 - of the planner: the server goes on
                traceback.print_exc()
                told = f"{type(error).__name__}: {error}"
                status, answer = 400, told.encode(errors="replace")
            self.send_response(status)
            if self.close_connection:
                self.send_header("Connection", "close")
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(answer)))
            self.end_headers()
            self.wfile.write(answer)

    return LocalServer(port, Handler)


_NOWHERE: Final = Path("told-to-a-planner")


def read(text: bytes) -> Reset | ViewMessage:
    """The message. Raises PlannerError for one that is not in the protocol."""
    try:
        return QUESTION.validate_json(text)
    except ValidationError as error:
        raise PlannerError(f"not a message of protocol {PROTOCOL}: {error}") from None


def case_of(message: Reset) -> Case:
    """The case, without recordings, networks and the drivers of other vehicles."""
    known: dict[str, Any] = {
        "name": message.case,
        "road": _road(message.road),
        "av_id": message.av_id,
        "duration_steps": message.steps,
        "seed": message.seed,
    }
    if message.own_lane:
        net = SumoNet(file=_NOWHERE, ghost_edge="told")
        return RecordedCase(**known, traffic="sumo", scene=_lone_av(message), net=net)
    return TrafficCase(**known, config=_NOWHERE, start_s=0.0, net_file=_NOWHERE)


def view_of(message: ViewMessage, road: RoadMap) -> View:
    """The simulation's view, on a road that was told before."""
    agents = message.agents
    steps = len(agents[0].valid) if agents else 0
    shape = (len(agents), steps)
    columns = {
        name: np.array([getattr(one, name) for one in agents], float).reshape(shape)
        for name in ("x_m", "y_m", "z_m", "heading_rad", "vx_mps", "vy_mps")
    }
    return View(
        step=message.step,
        dt_s=message.dt_s,
        av_id=message.av_id,
        history=Tracks(
            ids=tuple(one.id for one in agents),
            kinds=tuple(one.kind for one in agents),
            size_m=np.array([one.size_m for one in agents], float).reshape(-1, 3),
            position_m=np.stack([columns["x_m"], columns["y_m"]], -1),
            z_m=columns["z_m"],
            heading_rad=columns["heading_rad"],
            velocity_mps=np.stack([columns["vx_mps"], columns["vy_mps"]], -1),
            valid=np.array([one.valid for one in agents], bool).reshape(shape),
        ),
        road=road,
        signals={lane: SignalState[name] for lane, name in message.signals.items()},
        steps_left=message.steps_left,
        av_path_m=None if message.av_path_m is None else np.array(message.av_path_m, float),
        av_recorded_steps=message.av_recorded_steps,
    )


def ready_answer(model: VehicleModel | None) -> dict[str, object]:
    """Answer to a reset."""
    return {
        "type": "ready",
        "protocol": PROTOCOL,
        "model": None if model is None else asdict(model),
    }


def command_answer(command: Command, step: int) -> dict[str, object]:
    """Answer to a view."""
    return {
        "type": "command",
        "step": step,
        "kind": command.kind,
        "leader_id": command.leader_id,
        **{name: float(getattr(command, name)) for name in NUMBERS[command.kind]},
    }


def _road(message: RoadMessage | None) -> RoadMap:
    if message is None:
        return RoadMap(lanes={})
    return RoadMap(
        lanes={one.id: _lane(one) for one in message.lanes},
        lines=tuple(_line(one) for one in message.lines),
        edges=tuple(_line(one) for one in message.edges),
        polygons=_areas(message.areas),
        buildings=_areas(message.buildings),
        footways=None if message.footways is None else _areas(message.footways),
        water=_areas(message.water),
        stop_signs=tuple(
            StopSign(
                id=one.id,
                position_m=np.array(one.position_m),
                z_m=one.z_m,
                lane_ids=tuple(one.lane_ids),
            )
            for one in message.stop_signs
        ),
    )


def _lane(message: LaneMessage) -> Lane:
    def beside(those: list[BesideMessage]) -> tuple[Neighbour, ...]:
        return tuple(Neighbour(**one.model_dump()) for one in those)

    def boundaries(those: list[BoundaryMessage]) -> tuple[Boundary, ...]:
        return tuple(Boundary(**one.model_dump()) for one in those)

    return Lane(
        id=message.id,
        kind=message.kind,
        centre_m=_points(message.centre_m),
        z_m=np.array(message.z_m),
        interpolating=message.interpolating,
        width_m=message.width_m,
        speed_limit_mps=message.speed_limit_mps,
        next=tuple(message.next),
        previous=tuple(message.previous),
        left=beside(message.left_beside),
        right=beside(message.right_beside),
        left_boundaries=boundaries(message.left_boundaries),
        right_boundaries=boundaries(message.right_boundaries),
        gives_way_to=tuple(message.gives_way_to),
    )


def _areas(messages: Sequence[AreaMessage]) -> tuple[Polygon, ...]:
    return tuple(
        Polygon(id=one.id, kind=one.kind, points_m=_points(one.points_m), z_m=np.array(one.z_m))
        for one in messages
    )


def _line(message: LineMessage) -> Polyline:
    return Polyline(
        id=message.id,
        kind=message.kind,
        points_m=_points(message.points_m),
        z_m=np.array(message.z_m),
    )


def _points(points_m: Points) -> Floats:
    return np.array(points_m, float).reshape(-1, 2)


def _lone_av(message: Reset) -> Scene:
    """A recording of a lone AV at the origin: planners get nothing of the real one."""
    one = np.zeros((1, 1))
    return Scene(
        name=message.case,
        source=Source(dataset="", file="", record=0, sha256=""),
        dt_s=message.dt_s,
        now=0,
        timestamps_s=np.zeros(1),
        tracks=Tracks(
            ids=(message.av_id,),
            kinds=("vehicle",),
            size_m=np.zeros((1, 3)),
            position_m=np.zeros((1, 1, 2)),
            z_m=one,
            heading_rad=one,
            velocity_mps=np.zeros((1, 1, 2)),
            valid=np.ones((1, 1), bool),
        ),
        road=_road(message.road),
        signals=Signals(
            lane_ids=(),
            state=np.zeros((0, 1), np.uint8),
            seen=np.zeros((0, 1), bool),
            stop_m=np.zeros((0, 2)),
        ),
        av_id=message.av_id,
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the command line and answer messages until there are no more."""
    parser = argparse.ArgumentParser(prog="python -m deepmf_sumo.planners.remote.serve")
    parser.add_argument("name", help="a planner: a plug-in, or package.module:Class")
    parser.add_argument("--settings", default="{}", type=json.loads, help="JSON object")
    parser.add_argument("--port", type=int, help="be a server on 127.0.0.1 (0: any port)")
    parser.add_argument("--path", help="search path of modules, instead of Python's")
    chosen = parser.parse_args(arguments)
    sys.path[:] = chosen.path.split(os.pathsep) if chosen.path else [str(Path.cwd()), *sys.path]
    try:
        answerer = Answerer(chosen.name, chosen.settings)
    except DeepmfError as error:
        parser.error(str(error))
    if chosen.port is None:
        on_streams(answerer)
        return
    server = on_port(answerer, chosen.port)
    sys.stdout.write(f"http://127.0.0.1:{server.server_port}\n")
    sys.stdout.flush()
    server.serve_forever()


if __name__ == "__main__":
    main()
