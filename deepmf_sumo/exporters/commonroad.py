"""CommonRoad's scenario format, version 2020a, ``run.xml``: attacks to plan against, or to measure.

Time step 0 is the step at which the attack began. ``av=problem`` makes the AV a planning problem
without a place to reach (to be survived until the end), and leaves its motion out; ``av=obstacle``
makes it one more vehicle, which measures of criticality need. After a contact the opponent's last
plan continues, as in the scene of a run. Lanes are lanelets with their limits as signs; lights are
left out. Ids are numbers: a comment before each road user says which one it is; one that leaves and
comes back is several obstacles. The comment also says who was made.

Source: CommonRoad, XML documentation, version 2020a (Pek et al., TU Munich, 2020).
"""

import itertools
import re
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Final, Literal
from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

import numpy as np

from deepmf_sumo import files, plugins
from deepmf_sumo.errors import RunError
from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.exporters.scene import scene_of
from deepmf_sumo.scene import AgentId, Floats, Ints, Lane, RoadMap, Scene
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.lane_map import width_m
from deepmf_sumo.scene.road_users import RoadUserClass, class_of

FILE: Final = "run.xml"
_TYPES: Final[dict[RoadUserClass, str]] = {
    "car": "car", "truck": "truck", "motorcycle": "motorcycle", "bicycle": "bicycle",
    "pedestrian": "pedestrian", "other": "unknown",
}  # fmt: skip
_LANES: Final = {"freeway": "highway", "street": "urban", "bike": "bicycleLane"}
_LIMIT_SIGN: Final = "274"
_SAME_WAY_RAD: Final = np.pi / 2
_DATE: Final = "2020-01-01"
"""The format asks for one; equal runs are equal files."""


class Settings(plugins.Settings):
    """What the AV is.

    Attributes:
        av: ``problem``: a planning problem; ``obstacle``: one more vehicle, which drives as it did.
    """

    av: Literal["problem", "obstacle"] = "problem"


def write(run: Exportable, path: Path, settings: Settings) -> None:
    """Write the file ``path``. Raises OutputError, RunError and what `Exportable.around` raises."""
    root = described(scene_of(run), settings, run.made)
    indent(root)
    with files.writing(path):
        files.write(path, tostring(root, "utf-8", xml_declaration=True) + b"\n")


def described(scene: Scene, settings: Settings, made: Collection[AgentId] = ()) -> Element:
    """The scenario of a scene, from its current step on. Raises RunError without the AV there."""
    if not scene.tracks.valid[scene.tracks.row(scene.av_id), scene.now]:
        raise RunError(f"{scene.name}: the AV is not there at the begin of the attack.")
    root = Element(
        "commonRoad", timeStepSize=f"{scene.dt_s:g}", commonRoadVersion="2020a",
        author="deepmf-sumo", affiliation="", source=f"deepmf-sumo: {scene.name}",
        benchmarkID=_benchmark(scene.name), date=_DATE,
    )  # fmt: skip
    place = SubElement(root, "location")
    for name, unknown in (("geoNameId", "-999"), ("gpsLatitude", "999"), ("gpsLongitude", "999")):
        SubElement(place, name).text = unknown
    tags = SubElement(root, "scenarioTags")
    for tag in ("critical", "simulated"):
        SubElement(tags, tag)
    ids = {lane.id: number for number, lane in enumerate(_drawn(scene.road), 1)}
    first = len(ids) + 1
    limits = sorted({lane.speed_limit_mps for lane in _drawn(scene.road) if lane.speed_limit_mps})
    signs = {limit: first + number for number, limit in enumerate(limits)}
    for lane in _drawn(scene.road):
        _lanelet(root, lane, scene.road, ids, signs)
    for limit, number in signs.items():
        _sign(root, number, limit, next(one for one in _drawn(scene.road)
                                        if one.speed_limit_mps == limit))  # fmt: skip
    numbers = itertools.count(first + len(signs))
    for row, name in enumerate(scene.tracks.ids):
        if name != scene.av_id or settings.av == "obstacle":
            for steps in _stretches(scene, row):
                words = f"{name} (made: not in the demand)" if name in made else name
                # no two dashes beside each other in a comment of XML
                root.append(Comment(f" {re.sub('-(?=-)', '- ', words)} "))
                _obstacle(root, scene, row, steps, next(numbers))
    if settings.av == "problem":
        _problem(root, scene, next(numbers))
    return root


def _stretches(scene: Scene, row: int) -> list[Ints]:
    """Steps from the current one on at which a road user is there without a gap."""
    there = np.flatnonzero(scene.tracks.valid[row, scene.now :]) + scene.now
    parts = np.split(there, np.flatnonzero(np.diff(there) > 1) + 1)
    return [part for part in parts if len(part)]


def _benchmark(name: str) -> str:
    """An id as the format has it: country, place, map, configuration, prediction."""
    words = "".join(word.capitalize() for word in re.findall(r"[A-Za-z0-9]+", name))
    return f"ZAM_{words or 'Run'}-1_1_T-1"


def _drawn(road: RoadMap) -> Iterator[Lane]:
    """Lanes with a length."""
    return (lane for lane in road.lanes.values() if len(lane.centre_m) > 1)


def _lanelet(
    root: Element, lane: Lane, road: RoadMap, ids: dict[str, int], signs: dict[float, int]
) -> None:
    """Borders, the lanes before and after it and beside it, its kind and its limit."""
    element = SubElement(root, "lanelet", id=str(ids[lane.id]))
    normal = frames.unit(_directions(lane.centre_m) + np.pi / 2)
    half = width_m(lane) / 2
    for name, side in (("leftBound", 1.0), ("rightBound", -1.0)):
        bound = SubElement(element, name)
        for point in lane.centre_m + side * half * normal:
            _point(bound, point)
    for name, others in (("predecessor", lane.previous), ("successor", lane.next)):
        for other in others:
            if other in ids:
                SubElement(element, name, ref=str(ids[other]))
    for name, neighbours in (("adjacentLeft", lane.left), ("adjacentRight", lane.right)):
        known = list(dict.fromkeys(one.lane_id for one in neighbours if one.lane_id in ids))
        if len(known) == 1:  # the format has one, and for the whole length
            way = "same" if _same_way(lane, road.lanes[known[0]]) else "opposite"
            SubElement(element, name, ref=str(ids[known[0]]), drivingDir=way)
    SubElement(element, "laneletType").text = _LANES.get(lane.kind, "unknown")
    if lane.speed_limit_mps:
        SubElement(element, "trafficSignRef", ref=str(signs[lane.speed_limit_mps]))


def _directions(line_m: Floats) -> Floats:
    """(P) directions of a line (P, 2) at its points."""
    ways = np.diff(line_m, axis=0)
    course = np.unwrap(np.arctan2(ways[:, 1], ways[:, 0]))
    middle = (course[:-1] + course[1:]) / 2
    return np.concatenate([course[:1], middle, course[-1:]])


def _same_way(one: Lane, other: Lane) -> bool:
    mine, theirs = (lane.centre_m[-1] - lane.centre_m[0] for lane in (one, other))
    turn = frames.difference(np.arctan2(*mine[::-1]), np.arctan2(*theirs[::-1]))
    return bool(abs(turn) < _SAME_WAY_RAD)


def _sign(root: Element, number: int, limit_mps: float, lane: Lane) -> None:
    """A limit, at the first lane that has it."""
    sign = SubElement(root, "trafficSign", id=str(number))
    element = SubElement(sign, "trafficSignElement")
    SubElement(element, "trafficSignID").text = _LIMIT_SIGN
    SubElement(element, "additionalValue").text = f"{limit_mps:.4f}"
    _point(SubElement(sign, "position"), lane.centre_m[0])
    SubElement(sign, "virtual").text = "true"


def _obstacle(root: Element, scene: Scene, row: int, steps: Ints, number: int) -> None:
    """A road user: its box, and where it was at each of some steps without a gap."""
    tracks = scene.tracks
    element = SubElement(root, "dynamicObstacle", id=str(number))
    length, width = tracks.size_m[row, :2]
    known = class_of(tracks.kinds[row], tracks.size_m[row])
    SubElement(element, "type").text = _TYPES[known]
    box = SubElement(SubElement(element, "shape"), "rectangle")
    for name, value in (("length", length), ("width", width)):
        SubElement(box, name).text = f"{value:.4f}"
    _state(SubElement(element, "initialState"), scene, row, int(steps[0]))
    if len(steps) > 1:
        trajectory = SubElement(element, "trajectory")
        for step in steps[1:].tolist():
            _state(SubElement(trajectory, "state"), scene, row, step)


def _state(element: Element, scene: Scene, row: int, step: int) -> None:
    """Pose and speed along the heading."""
    tracks = scene.tracks
    heading = float(tracks.heading_rad[row, step])
    _point(SubElement(element, "position"), tracks.position_m[row, step])
    speed = float(tracks.velocity_mps[row, step] @ frames.unit(heading))
    _exact(element, "orientation", f"{frames.wrap(heading):.6f}")
    _exact(element, "time", str(step - scene.now))
    _exact(element, "velocity", f"{speed:.4f}")


def _problem(root: Element, scene: Scene, number: int) -> None:
    """From the AV's state now, without a place to reach, until the end."""
    element = SubElement(root, "planningProblem", id=str(number))
    first = SubElement(element, "initialState")
    _state(first, scene, scene.tracks.row(scene.av_id), scene.now)
    for name in ("yawRate", "slipAngle"):
        _exact(first, name, "0.0")
    time = SubElement(SubElement(element, "goalState"), "time")
    last = str(scene.tracks.steps - 1 - scene.now)
    for name in ("intervalStart", "intervalEnd"):
        SubElement(time, name).text = last


def _exact(element: Element, name: str, value: str) -> None:
    SubElement(SubElement(element, name), "exact").text = value


def _point(element: Element, point_m: Floats) -> None:
    point = SubElement(element, "point")
    for name, value in zip("xy", point_m.tolist(), strict=True):
        SubElement(point, name).text = f"{value:.4f}"
