"""ASAM OpenSCENARIO 1.2 and OpenDRIVE: ``openscenario/scenario.xosc`` and ``road.xodr``.

Every road user follows its trajectory by time: what is played is the run, not a new attack. Poses
are those of the rear axle, as the format defines a vehicle's; pedestrians and objects have theirs
at the centre of the box. A road user that comes later is added and one that leaves is deleted: it
would stand at its first or last place. The network is netconvert's OpenDRIVE of SUMO's; its
signals near AV and opponent have the states of the run. Before the current step they are taken to
be as at it: a run does not keep them.
"""

import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final, Literal
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo import files, plugins
from deepmf_sumo.errors import UsageError
from deepmf_sumo.exporters.base import AXLE, Exportable, known_heights
from deepmf_sumo.scene import Bools, Floats, Rollout, Signals, SignalState
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.road_users import RoadUserClass, class_of
from deepmf_sumo.scene.signals import steady
from deepmf_sumo.sumo.network import sumo_tools
from deepmf_sumo.sumo.network.sumo_road import signal_links

FILE: Final = "openscenario/"
SCENARIO, ROAD = "scenario.xosc", "road.xodr"
_DATE: Final = "2000-01-01T00:00:00"
"""The same run gives the same bytes."""
_VEHICLES: Final[dict[RoadUserClass, str]] = {
    "car": "car", "truck": "truck", "motorcycle": "motorbike", "bicycle": "bicycle",
}  # fmt: skip
"""Categories of vehicles; pedestrians and other objects are no vehicles to players."""
_ROUTE_M: Final = 20.0
"""Between way points of the AV's route."""
_LARGEST_NET: Final = 2**30
_AFTER_S: Final = 3600.0
"""How long the last phase lasts after the run."""
_OFF: Final = ("off", "off;off;off")
_LAMPS: Final[dict[str, str]] = {"red": "on;off;off", "yellow": "off;on;off", "green": "off;off;on"}
"""From top to bottom. Lights that are off or flash are off."""
_PLAIN: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.\-]*")
_CONVERSION_S: Final = 600.0


class Settings(plugins.Settings):
    """What is left to others.

    Attributes:
        without_av: another program drives the AV, from its pose and speed at the step at which the
            simulation took over, which is then time 0; its route is what it drove. The others do
            what they did.
        signals: how a state is written, which the format leaves to players: ``words`` (red, yellow,
            green), ``lamps`` (``on;off;off``), or ``none``.
    """

    without_av: bool = False
    signals: Literal["words", "lamps", "none"] = "words"


def write(run: Exportable, path: Path, settings: Settings) -> None:
    """Write the folder ``path``; time 0 is the first step of history, see `Settings`.

    Raises OutputError, UsageError where the network cannot be read, ConversionError where
    netconvert refuses it, and what `Exportable.net` raises.
    """
    road = _open_drive(run.net.net)
    document = _document(run, settings)
    ET.indent(document)
    text = ET.tostring(document, encoding="unicode")
    with files.writing(path), files.whole_folder(path) as folder:
        (folder / SCENARIO).write_text(f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n', "utf-8")
        (folder / ROAD).write_bytes(road)


def _open_drive(net: Path) -> bytes:
    """The network, in SUMO's coordinates. Raises UsageError where it cannot be read."""
    try:
        return _converted(files.content(net, _LARGEST_NET))
    except OSError as error:
        raise UsageError(f"{net} cannot be read: {files.reason(error)}.") from None


@lru_cache(maxsize=2)
def _converted(net: bytes) -> bytes:
    """Kept by what is in the file: most runs of a folder have copies of one network."""
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder) / "net.net.xml", Path(folder) / ROAD
        if net.startswith(files.GZIP):  # SUMO tells by the name
            given = given.with_name("net.net.xml.gz")
        given.write_bytes(net)
        sumo_tools.run(
            "netconvert", "--sumo-net-file", str(given), "--opendrive-output", str(made),
            "--offset.disable-normalization", "true", "--no-warnings", timeout_s=_CONVERSION_S,
        )  # fmt: skip
        text = made.read_text("utf-8")
    text = re.sub(r"<!--.*?-->\s*", "", text, flags=re.DOTALL)  # when, and by which command
    return re.sub(r'(<header [^>]*?date=")[^"]*', rf"\g<1>{_DATE}", text, count=1).encode()


@dataclass(frozen=True, kw_only=True, eq=False)
class _Actor:
    """A road user in the scenario.

    Attributes:
        name: of the entity. category: the element that describes it.
        axle_m: how far the centre of its box is before its reference point.
        pose: (T, 4) x, y, z of the reference point and heading, which does not jump by a turn.
        speed_mps: (T).
        stays: pairs of the first and last step of the times at which it is there.
    """

    name: str
    row: int
    category: str
    axle_m: float
    pose: Floats
    speed_mps: Floats
    stays: tuple[tuple[int, int], ...]


def _actors(rollout: Rollout, first: int) -> Iterator[_Actor]:
    """All road users that are there from step ``first`` on; steps count from it."""
    tracks = rollout.tracks
    taken = set(tracks.ids)
    for row, agent in enumerate(tracks.ids):
        valid = tracks.valid[row, first:]
        if not valid.any():
            continue
        known = class_of(tracks.kinds[row], tracks.size_m[row])
        things = "Pedestrian" if known == "pedestrian" else "MiscObject"
        category = "Vehicle" if known in _VEHICLES else things
        axle = AXLE * float(tracks.size_m[row, 0]) * (category == "Vehicle")
        heading = tracks.heading_rad[row, first:].copy()
        heading[valid] = np.unwrap(heading[valid])
        place = tracks.position_m[row, first:] - axle * frames.unit(heading)
        name = agent
        if not _PLAIN.fullmatch(agent):
            name = f"agent_{row}"
            while name in taken:
                name += "_"
        yield _Actor(
            name=name,
            row=row,
            category=category,
            axle_m=axle,
            pose=np.column_stack([place, tracks.z_m[row, first:], heading]),
            speed_mps=tracks.speed_mps[row, first:],
            stays=_stays(valid),
        )


def _stays(valid: Bools) -> tuple[tuple[int, int], ...]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], valid, [False]]).astype(int)))
    return tuple(zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True))


def _document(run: Exportable, settings: Settings) -> ET.Element:
    rollout, without_av = run.rollout, settings.without_av
    first = rollout.now if without_av else 0
    actors = list(_actors(rollout, first))
    root = ET.Element("OpenSCENARIO")
    _add(root, "FileHeader", revMajor=1, revMinor=2, date=_DATE, author="deepmf-sumo",
         description=f"run {run.name}")  # fmt: skip
    _add(root, "ParameterDeclarations")
    _add(root, "CatalogLocations")
    network = _add(root, "RoadNetwork")
    _add(network, "LogicFile", filepath=ROAD)
    if settings.signals != "none":
        _signals(network, run, first, settings.signals)
    entities = _add(root, "Entities")
    board = _add(root, "Storyboard")
    init = _add(_add(board, "Init"), "Actions")
    story = _add(board, "Story", name="run")
    act = _add(story, "Act", name="act")
    last = rollout.tracks.steps - 1 - first
    for actor in actors:
        agent = rollout.tracks.ids[actor.row]
        av = agent == rollout.av_id
        thing = _add(entities, "ScenarioObject", name=actor.name)
        _describe(thing, actor, rollout, made=agent in run.made)
        if actor.stays[0][0] == 0:
            private = _add(init, "Private", entityRef=actor.name)
            _begin(private, actor)
            if av and without_av:
                _route(private, actor)
        if not (av and without_av):
            _drive(act, actor, last, rollout.dt_s)
    if act.find("ManeuverGroup") is None:  # the format wants one
        _add(_add(act, "ManeuverGroup", maximumExecutionCount=1, name="empty"), "Actors",
             selectTriggeringEntities="false")  # fmt: skip
    _at_time(_add(act, "StartTrigger"), "begin", 0.0)
    _at_time(_add(board, "StopTrigger"), "end", last * rollout.dt_s)
    return root


def _signals(network: ET.Element, run: Exportable, first: int, how: str) -> None:
    """The states of each of SUMO's lights from step ``first`` on, as phases that do not repeat."""
    signals = run.around.signals
    lights: dict[str, dict[str, int]] = {}
    links = signal_links(run.net.net) if signals is not None else {}
    for row, lane in enumerate(signals.lane_ids if signals is not None else ()):
        for link in links.get(lane, ()):
            lights.setdefault(link.light, {})[f"{link.light}_{link.index}"] = row
    if signals is None or not lights:
        return
    parent = _add(network, "TrafficSignals")
    states = _known(signals)[:, first : run.rollout.tracks.steps]
    for light, rows in sorted(lights.items()):
        controller = _add(parent, "TrafficSignalController", name=light)
        shown = states[sorted(rows.values())]
        changes = 1 + np.flatnonzero((np.diff(shown, axis=1) != 0).any(axis=0))
        begins = [0, *changes.tolist()]
        ends = [*begins[1:], states.shape[1] + round(_AFTER_S / run.rollout.dt_s)]
        for number, (begin, end) in enumerate(zip(begins, ends, strict=True)):
            phase = _add(controller, "Phase", name=f"phase {number}",
                         duration=_m((end - begin) * run.rollout.dt_s))  # fmt: skip
            for name, row in sorted(rows.items()):
                word, lamps = _lamps(SignalState(states[row, begin]))
                _add(phase, "TrafficSignalState", trafficSignalId=name,
                     state=word if how == "words" else lamps)  # fmt: skip


def _lamps(state: SignalState) -> tuple[str, str]:
    """As a word, and as lamps."""
    colour = steady(state)
    return _OFF if colour is None else (colour, _LAMPS[colour])


def _known(signals: Signals) -> NDArray[np.uint8]:
    """(L, T) states: where none is known the one before it, or else the first one."""
    state = signals.state.copy()
    for row, seen in enumerate(signals.seen):
        known = np.flatnonzero(seen)
        if len(known):
            last = np.maximum.accumulate(np.where(seen, np.arange(len(seen)), known[0]))
            state[row] = state[row, last]
    return state


def _describe(parent: ET.Element, actor: _Actor, rollout: Rollout, *, made: bool) -> None:
    tracks = rollout.tracks
    length, width = map(float, tracks.size_m[actor.row, :2])
    height = float(known_heights(tracks)[actor.row])
    agent = tracks.ids[actor.row]
    if actor.category == "Vehicle":
        category = _VEHICLES[class_of(tracks.kinds[actor.row], tracks.size_m[actor.row])]
        thing = _add(parent, "Vehicle", name=f"type_{actor.row}", vehicleCategory=category)
    elif actor.category == "Pedestrian":
        thing = _add(parent, "Pedestrian", name=f"type_{actor.row}", mass=70,
                     pedestrianCategory="pedestrian")  # fmt: skip
    else:
        thing = _add(parent, "MiscObject", name=f"type_{actor.row}", mass=100,
                     miscObjectCategory="obstacle")  # fmt: skip
    box = _add(thing, "BoundingBox")
    _add(box, "Center", x=_m(actor.axle_m), y=0, z=_m(height / 2))
    _add(box, "Dimensions", width=_m(width), length=_m(length), height=_m(height))
    if actor.category == "Vehicle":
        _add(thing, "Performance", maxSpeed=100, maxAcceleration=20, maxDeceleration=20)
        axles = _add(thing, "Axles")
        wheel = {"wheelDiameter": 0.6, "trackWidth": _m(0.8 * width), "positionZ": 0.3}
        _add(axles, "FrontAxle", maxSteering=0.5, positionX=_m(2 * actor.axle_m), **wheel)
        _add(axles, "RearAxle", maxSteering=0, positionX=0, **wheel)
    properties = _add(thing, "Properties")
    _add(properties, "Property", name="id", value=agent)
    _add(properties, "Property", name="role", value=rollout.roles.get(agent, "other"))
    if made:  # a person who is not in the demand
        _add(properties, "Property", name="made", value="true")


def _begin(private: ET.Element, actor: _Actor) -> None:
    """Where it is at first, and how fast."""
    _place(_add(_add(private, "PrivateAction"), "TeleportAction"), actor, 0)
    speed = _add(_add(_add(private, "PrivateAction"), "LongitudinalAction"), "SpeedAction")
    _add(speed, "SpeedActionDynamics", dynamicsShape="step", value=0, dynamicsDimension="time")
    target = _add(speed, "SpeedActionTarget")
    _add(target, "AbsoluteTargetSpeed", value=_m(float(actor.speed_mps[0])))


def _route(private: ET.Element, actor: _Actor) -> None:
    """The way of the AV, for the program that drives it."""
    begin, end = actor.stays[0]
    points = actor.pose[begin : end + 1, :2]
    driven = np.concatenate([[0.0], np.hypot(*np.diff(points, axis=0).T).cumsum()])
    marks = np.arange(_ROUTE_M, driven[-1], _ROUTE_M)
    steps = [0, *np.searchsorted(driven, marks).tolist(), end - begin]
    routing = _add(_add(private, "PrivateAction"), "RoutingAction")
    route = _add(_add(routing, "AssignRouteAction"), "Route", name="driven", closed="false")
    for step in steps if len(set(steps)) > 1 else [0, 0]:
        _place(_add(route, "Waypoint", routeStrategy="shortest"), actor, begin + step)


def _drive(act: ET.Element, actor: _Actor, last: int, dt_s: float) -> None:
    """Its trajectories, and its coming and going."""
    group = _add(act, "ManeuverGroup", maximumExecutionCount=1, name=f"group {actor.name}")
    actors = _add(group, "Actors", selectTriggeringEntities="false")
    _add(actors, "EntityRef", entityRef=actor.name)
    manoeuvre = _add(group, "Maneuver", name=f"manoeuvre {actor.name}")
    for number, (begin, end) in enumerate(actor.stays):
        event = _event(manoeuvre, f"comes {number} {actor.name}")
        if begin > 0:
            entity = _entity_action(event, f"added {number} {actor.name}", actor)
            _place(_add(entity, "AddEntityAction"), actor, begin)
        if end > begin:
            _follow(_add(event, "Action", name=f"drives {number} {actor.name}"),
                    actor, begin, end, dt_s)  # fmt: skip
        if event.find("Action") is None:  # there at the first step alone
            manoeuvre.remove(event)
        else:
            _at_time(_add(event, "StartTrigger"), f"begin {number} {actor.name}", begin * dt_s)
        if end < last:
            event = _event(manoeuvre, f"goes {number} {actor.name}")
            entity = _entity_action(event, f"deleted {number} {actor.name}", actor)
            _add(entity, "DeleteEntityAction")
            time = (end + 1) * dt_s
            _at_time(_add(event, "StartTrigger"), f"end {number} {actor.name}", time)
    if manoeuvre.find("Event") is None:
        act.remove(group)


def _event(manoeuvre: ET.Element, name: str) -> ET.Element:
    # parallel: another event of the same road user must not end this one at the same time
    return _add(manoeuvre, "Event", name=name, priority="parallel", maximumExecutionCount=1)


def _entity_action(event: ET.Element, name: str, actor: _Actor) -> ET.Element:
    action = _add(_add(event, "Action", name=name), "GlobalAction")
    return _add(action, "EntityAction", entityRef=actor.name)


def _follow(action: ET.Element, actor: _Actor, begin: int, end: int, dt_s: float) -> None:
    routing = _add(_add(action, "PrivateAction"), "RoutingAction")
    follow = _add(routing, "FollowTrajectoryAction")
    trajectory = _add(_add(follow, "TrajectoryRef"), "Trajectory",
                      name=f"way {begin} {actor.name}", closed="false")  # fmt: skip
    line = _add(_add(trajectory, "Shape"), "Polyline")
    for step in range(begin, end + 1):
        _place(_add(line, "Vertex", time=_m(step * dt_s)), actor, step)
    reference = _add(follow, "TimeReference")
    _add(reference, "Timing", domainAbsoluteRelative="absolute", scale=1, offset=0)
    _add(follow, "TrajectoryFollowingMode", followingMode="position")


def _place(parent: ET.Element, actor: _Actor, step: int) -> None:
    x, y, z, heading = map(float, actor.pose[step])
    position = _add(parent, "Position")
    _add(position, "WorldPosition", x=_m(x), y=_m(y), z=_m(z), h=f"{heading:.6f}", p=0, r=0)


def _at_time(trigger: ET.Element, name: str, time_s: float) -> None:
    group = _add(trigger, "ConditionGroup")
    condition = _add(group, "Condition", name=name, delay=0, conditionEdge="none")
    _add(_add(condition, "ByValueCondition"), "SimulationTimeCondition", value=_m(time_s),
         rule="greaterOrEqual")  # fmt: skip


def _add(parent: ET.Element, tag: str, **attributes: object) -> ET.Element:
    texts = {name: str(value) for name, value in attributes.items()}
    return ET.SubElement(parent, tag, texts)


def _m(value: float) -> str:
    """To 0.1 mm, without a negative zero."""
    return f"{value + 0.0:.4f}".replace("-0.0000", "0.0000")
