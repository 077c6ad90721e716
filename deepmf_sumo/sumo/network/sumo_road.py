"""The road map of a SUMO network, as predictors, rules and metrics read it."""

from collections import defaultdict
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
import shapely
from numpy.typing import NDArray

from deepmf_sumo import files
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.scene import (
    Floats,
    Lane,
    Neighbour,
    Polygon,
    Polyline,
    RoadMap,
    SignalLink,
    StopSign,
)
from deepmf_sumo.scene.scene import LaneKind, PolygonKind
from deepmf_sumo.sumo.network.sumo_net import (
    ON_FOOT,
    RAIL_VEHICLES,
    NetEdge,
    NetFile,
    NetLane,
    elements,
    going_first,
    junction_of,
    number,
    points,
    read_once,
)

BROKEN_WHITE: Final = 1
SOLID_DOUBLE_YELLOW: Final = 7
BOUNDARY: Final = 1
_SHORTEST_M: Final = 0.1
"""Length of a lane over a junction whose lanes meet in a point, so that it has a direction."""
_BESIDE_M: Final = 3.0
"""From the middle of a lane: an edge farther away is not the lane's."""
MOUTH_M: Final = 1.0
"""A side of a junction's outline this close to a lane's end is the lane's mouth."""


def borders(
    net: NetFile, lane_ids: Iterable[str]
) -> tuple[tuple[Polyline, ...], tuple[Polyline, ...]]:
    """Lines and road edges.

    Between the lanes of an edge a broken white line; to its left a double yellow one if the
    opposite direction adjoins, else a road edge; to its right a road edge (mirrored if traffic
    keeps left); around junctions their outline without the mouths of the roads.
    """
    drivable = set(lane_ids)
    roads = [edge for edge in net.edges.values() if not edge.function]
    half = -0.5 if net.left_hand else 0.5  # of a lane's width, towards the opposite direction
    pairs = {(edge.start, edge.end) for edge in roads}
    lines: list[Polyline] = []
    edges: list[Polyline] = []
    for edge in roads:
        lanes = [lane for lane in edge.lanes if lane.id in drivable]
        lines += [
            _beside(lane.id, BROKEN_WHITE, lane.shape_m, half * lane.width_m) for lane in lanes[:-1]
        ]
        if lanes:
            sides = ("right", "left") if net.left_hand else ("left", "right")
            inner, outer = (f"{edge.id}:{side}" for side in sides)
            middle = _beside(inner, 0, lanes[-1].shape_m, half * lanes[-1].width_m)
            edges.append(_beside(outer, BOUNDARY, lanes[0].shape_m, -half * lanes[0].width_m))
            if (edge.end, edge.start) in pairs:
                lines.append(_of_kind(middle, SOLID_DOUBLE_YELLOW))
            else:
                edges.append(_of_kind(middle, BOUNDARY))
    edges += _junction_edges(net, roads, drivable)
    return tuple(lines), tuple(edges)


def _of_kind(line: Polyline, kind: int) -> Polyline:
    return Polyline(id=line.id, kind=kind, points_m=line.points_m, z_m=line.z_m)


def _beside(key: str, kind: int, shape_m: Floats, left_m: float) -> Polyline:
    """A line (P, 2) beside a polyline (P, 3): each point moved along the normal of its corner."""
    step = np.diff(shape_m[:, :2], axis=0)
    step /= np.maximum(np.hypot(*step.T), 1e-9)[:, None]
    normal = np.column_stack([-step[:, 1], step[:, 0]])
    ends = np.vstack([normal[:1], normal, normal[-1:]])
    mean = ends[:-1] + ends[1:]
    mean /= np.maximum((mean * ends[1:]).sum(axis=1, keepdims=True), 0.5)
    return Polyline(id=key, kind=kind, points_m=shape_m[:, :2] + left_m * mean, z_m=shape_m[:, 2])


def _junction_edges(net: NetFile, roads: list[NetEdge], drivable: set[str]) -> list[Polyline]:
    """Sides of junctions' outlines that no lane passes.

    Where there are walking areas, only the sides of the roadway, not the corners of pavements.
    """
    sides, names, doubtful = [], [], []
    walking = _walking_areas(net)
    for junction in net.junctions:
        areas = walking.get(junction.id, [])
        ring = _roadway(junction.shape_m, areas)
        if len(ring) > 2:
            following = np.roll(ring, -1, axis=0)
            long = np.hypot(*(following - ring)[:, :2].T) > 0.1
            sides += list(np.stack([ring, following], axis=1)[long])
            names += [f"{junction.id}:{side}" for side in np.flatnonzero(long)]
            doubtful += [bool(areas)] * int(long.sum())
    ends = [lane.shape_m[[0, -1], :2] for edge in roads for lane in edge.lanes if len(lane.shape_m)]
    if not sides or not ends:
        return []
    segments = np.asarray(shapely.linestrings(np.array(sides)[..., :2]))
    tree = shapely.STRtree(np.asarray(shapely.points(np.concatenate(ends))))
    mouths = set(tree.query(segments, predicate="dwithin", distance=MOUTH_M)[0].tolist())
    pavement = set(np.flatnonzero(doubtful).tolist()) - _beside_lanes(
        net, drivable, walking, segments
    )
    return [
        Polyline(id=names[index], kind=BOUNDARY, points_m=side[:, :2], z_m=side[:, 2])
        for index, side in enumerate(sides)
        if index not in mouths and index not in pavement
    ]


def _beside_lanes(
    net: NetFile, drivable: set[str], walking: dict[str, list[Floats]], sides: NDArray[Any]
) -> set[int]:
    """Which sides have their middle beside a lane of a junction that has walking areas."""
    lanes = [
        lane.shape_m[:, :2]
        for edge in net.edges.values()
        for lane in edge.lanes
        if edge.function == "internal" and lane.id in drivable and junction_of(edge.id) in walking
    ]
    row = np.repeat(np.arange(len(lanes)), [len(lane) for lane in lanes])
    lines = np.asarray(shapely.linestrings(np.concatenate([np.empty((0, 2)), *lanes]), indices=row))
    middles = shapely.line_interpolate_point(sides, 0.5, normalized=True)
    found = shapely.STRtree(lines).query(middles, predicate="dwithin", distance=_BESIDE_M)[0]
    return set(found.tolist())


def roadways(net: NetFile) -> list[Floats]:
    """Outlines (N, 3) of all junctions without their walking areas, N >= 3."""
    walking = _walking_areas(net)
    rings = (_roadway(one.shape_m, walking.get(one.id, [])) for one in net.junctions)
    return [ring for ring in rings if len(ring) > 2]


def _walking_areas(net: NetFile) -> dict[str, list[Floats]]:
    """Outlines of the walking areas of each junction, which has them in its own outline."""
    found: dict[str, list[Floats]] = defaultdict(list)
    for edge in net.edges.values():
        for lane in edge.lanes if edge.function == "walkingarea" else ():
            if len(lane.shape_m) > 2:
                found[junction_of(edge.id)].append(lane.shape_m[:, :2])
    return found


def _roadway(ring_m: Floats, walking_m: list[Floats]) -> Floats:
    """(N, 3) outline of a junction without its walking areas."""
    if len(ring_m) < 3 or not walking_m:
        return ring_m
    # buffers make them valid: SUMO's outlines may cross themselves
    row = np.repeat(np.arange(len(walking_m)), [len(one) for one in walking_m])
    areas = shapely.polygons(shapely.linearrings(np.concatenate(walking_m), indices=row))
    away = shapely.union_all(shapely.buffer(areas, 0.05, quad_segs=1))
    left = shapely.difference(shapely.buffer(shapely.Polygon(ring_m[:, :2]), 0.0), away)
    parts = shapely.get_parts(left)
    if not len(parts):
        return ring_m
    outline = shapely.get_exterior_ring(max(parts, key=shapely.area))
    corners = shapely.get_coordinates(outline)[:-1]
    nearest = np.hypot(*np.moveaxis(corners[:, None] - ring_m[:, :2], -1, 0)).argmin(axis=1)
    return np.column_stack([corners, ring_m[nearest, 2]])


_FREEWAY_MPS: Final = 24.0
"""Limits above 86 km/h are those of roads without crossings."""
_POLYGONS: Final = ("crosswalk", "speed_bump", "driveway", "building", "water")
_BESIDE_ROADS: Final = {"building", "water"}
_STOP_STATES: Final = "sw"
"""States of links behind a stop sign: stop, all-way stop."""


def road_of_net(net_file: Path, additional: Sequence[Path] = ()) -> RoadMap:
    """The road map of a SUMO network.

    One lane per SUMO lane that vehicles or bicycles may use, with its id, those inside junctions
    too (``interpolating``). Joins lead over the lanes inside; pedestrian crossings become
    crosswalks; painted lines and road edges are derived from the lanes' widths. Where a network has
    lights and no lanes inside its junctions, there are straight lanes over them (`NetLink.onto`).

    Args:
        net_file: .net.xml or .net.xml.gz.
        additional: additional files; their polygons of type crosswalk, speed_bump or driveway are
            taken, and as buildings and water those of these types or building.SOMETHING, as
            polyconvert writes them.

    Raises SimulationError if a file cannot be read or is of another kind.
    """
    net = read_once(net_file)
    lanes = {
        lane.id: kind
        for edge in net.edges.values()
        for lane in edge.lanes
        if (kind := _kind(edge, lane)) and len(lane.shape_m) > 1
    }
    limits_mps = _limits_mps(net, additional)
    straight = _straight_lanes(net, lanes, limits_mps)
    after: dict[str, list[str]] = defaultdict(list)
    before: dict[str, list[str]] = defaultdict(list)
    for link in net.links:
        if link.onto in straight:
            after[link.origin].append(link.onto)
            before[link.target].append(link.onto)
        elif link.origin in lanes and link.onto in lanes:
            after[link.origin].append(link.onto)
            before[link.onto].append(link.origin)
    lines, edges = borders(net, lanes)
    shapes = [shape for file in additional for shape in _polygons(file)]
    goes_first, known = going_first(net), lanes.keys() | _tracks(net)
    return RoadMap(
        lanes={
            lane.id: replace(
                _lane(net, edge, lane, lanes, after[lane.id], before[lane.id]),
                speed_limit_mps=limits_mps[lane.id],
                gives_way_to=tuple(name for name in goes_first.get(lane.id, ()) if name in known),
            )
            for edge in net.edges.values()
            for lane in edge.lanes
            if lane.id in lanes
        }
        | straight,
        lines=lines,
        edges=edges,
        polygons=(*_crossings(net), *(one for one in shapes if one.kind not in _BESIDE_ROADS)),
        stop_signs=_stop_signs(net, set(lanes)),
        buildings=tuple(shape for shape in shapes if shape.kind == "building"),
        footways=tuple(_footways(net, lanes)),
        water=tuple(shape for shape in shapes if shape.kind == "water"),
    )


def _tracks(net: NetFile) -> set[str]:
    """Lanes inside junctions that trams or trains use."""
    return {
        lane.id
        for edge in net.edges.values()
        for lane in edge.lanes
        if edge.function == "internal" and any(lane.allows(one) for one in RAIL_VEHICLES)
    }


def road_once(net_file: Path, additional: Sequence[Path] = ()) -> RoadMap:
    """As `road_of_net`; the last roads are kept as long as their files stay as they are.

    Successive attacks use one network, and what is derived from a road is kept with it.
    """
    return _road_kept(net_file, *additional)


@files.while_unchanged(4)
def _road_kept(net_file: Path, *additional: Path) -> RoadMap:
    return road_of_net(net_file, additional)


def signal_links(net_file: Path) -> dict[str, tuple[SignalLink, ...]]:
    """Links of traffic lights, by the lane behind the light: a lane of the net's road map.

    A lane has one link: it begins at one light. A link may have a second light in the middle of the
    junction. Those of pedestrian crossings are left out.

    Raises SimulationError if the file cannot be read or is not a SUMO network.
    """
    net = read_once(net_file)
    foot = {name for name, edge in net.edges.items() if edge.function in ON_FOOT}
    return {
        link.onto: (SignalLink(light=link.light, index=link.index),)
        for link in net.links
        if link.light and link.index >= 0 and not foot.intersection(link.edges)
    }


def _limits_mps(net: NetFile, additional: Sequence[Path]) -> dict[str, float]:
    """By lane: the limit of the network, or the highest of a variable speed sign if that is more.

    SUMO alone knows which limit a sign shows at a time, so no vehicle is judged by a lower one.
    """
    found = {lane.id: lane.speed_mps for edge in net.edges.values() for lane in edge.lanes}
    for name, most in (sign for file in additional for sign in _speed_signs(file)):
        if name in found:  # SUMO refuses another one
            found[name] = max(found[name], most)
    return found


def _straight_lanes(
    net: NetFile, kinds: dict[str, LaneKind], limits_mps: Mapping[str, float]
) -> dict[str, Lane]:
    """Lanes over junctions that have lights and no lanes inside, by name."""
    of_id = {lane.id: lane for edge in net.edges.values() for lane in edge.lanes}
    found = {}
    for link in net.links:
        known = link.origin in kinds and link.target in kinds
        if not known or link.onto in (link.via, link.target):
            continue
        origin, target = of_id[link.origin], of_id[link.target]
        line = np.stack([origin.shape_m[-1], target.shape_m[0]])
        if np.hypot(*(line[1] - line[0])[:2]) < _SHORTEST_M:
            way = origin.shape_m[-1] - origin.shape_m[-2]
            line[1] = line[0] + _SHORTEST_M * way / max(float(np.hypot(*way[:2])), 1e-9)
        found[link.onto] = Lane(
            id=link.onto,
            kind=kinds[link.target],
            centre_m=line[:, :2],
            z_m=line[:, 2],
            interpolating=True,
            width_m=min(origin.width_m, target.width_m),
            speed_limit_mps=min(limits_mps[origin.id], limits_mps[target.id]),
            next=(target.id,),
            previous=(origin.id,),
        )
    return found


def _kind(edge: NetEdge, lane: NetLane) -> LaneKind | None:
    """Kind of a lane; None for those that only pedestrians, trains or ships use."""
    if edge.function in {*ON_FOOT, "connector"}:
        return None
    if lane.road:
        fast = lane.speed_mps > _FREEWAY_MPS or "motorway" in edge.type
        return "freeway" if fast else "street"
    return "bike" if lane.allows("bicycle") else None


def _lane(
    net: NetFile,
    edge: NetEdge,
    lane: NetLane,
    kinds: dict[str, LaneKind],
    after: list[str],
    before: list[str],
) -> Lane:
    beside = {other.index: other for other in edge.lanes if other.id in kinds}
    left = -1 if net.left_hand else 1  # lane 0 is the outermost
    return Lane(
        id=lane.id,
        kind=kinds[lane.id],
        centre_m=lane.shape_m[:, :2],
        z_m=lane.shape_m[:, 2],
        interpolating=edge.function == "internal",
        width_m=lane.width_m,
        speed_limit_mps=lane.speed_mps,
        next=tuple(dict.fromkeys(after)),
        previous=tuple(dict.fromkeys(before)),
        left=_neighbour(lane, beside.get(lane.index + left)),
        right=_neighbour(lane, beside.get(lane.index - left)),
    )


def _neighbour(lane: NetLane, other: NetLane | None) -> tuple[Neighbour, ...]:
    if other is None:
        return ()
    return (
        Neighbour(
            lane_id=other.id,
            self_start=0,
            self_end=len(lane.shape_m) - 1,
            other_start=0,
            other_end=len(other.shape_m) - 1,
        ),
    )


def _crossings(net: NetFile) -> list[Polygon]:
    """Pedestrian crossings: the lane's line made as wide as the lane."""
    found = []
    for edge in net.edges.values():
        for lane in edge.lanes if edge.function == "crossing" else ():
            if len(lane.shape_m) > 1:
                ring = shapely.get_exterior_ring(lane.area())
                corners = shapely.get_coordinates(ring)[:-1]
                height = np.full(len(corners), lane.shape_m[0, 2])
                found.append(Polygon(id=edge.id, kind="crosswalk", points_m=corners, z_m=height))
    return found


def _footways(net: NetFile, known: Container[str]) -> Iterator[Polygon]:
    """Walking areas; sidewalks, paths and tracks of trams, whose lanes no road map has."""
    for edge in net.edges.values():
        if edge.function in {"crossing", "connector"}:
            continue
        for lane in edge.lanes:
            shape, kind = lane.shape_m, "footway"
            if edge.function != "walkingarea":
                people = lane.allows("pedestrian")
                if lane.id in known or not (people or lane.allows("tram")) or len(shape) < 2:
                    continue
                kind = "footway" if people else "track"
                left, right = (
                    _beside("", 0, lane.shape_m, side * lane.width_m / 2).points_m
                    for side in (1, -1)
                )
                shape = np.column_stack(
                    [np.vstack([left, right[::-1]]), np.append(shape[:, 2], shape[::-1, 2])]
                )
            if len(shape) > 2:
                yield Polygon(
                    id=lane.id,
                    kind=cast(PolygonKind, kind),
                    points_m=shape[:, :2],
                    z_m=shape[:, 2],
                )


def _speed_signs(file: Path) -> Iterator[tuple[str, float]]:
    """Lanes with a variable speed sign of an additional file, and its highest limit."""
    for element in elements(file, "additional"):
        if element.tag == "variableSpeedSign":
            named = element.get("file")
            steps = list(element.iter("step"))
            steps += elements(file.parent / named, "vss") if named else []
            try:
                most = max((number(one, "speed", 0.0) for one in steps), default=0.0)
            except ValueError as error:
                raise SimulationError(f"{file} has a wrong <variableSpeedSign>: {error}.") from None
            yield from ((lane, most) for lane in element.get("lanes", "").split())


def _polygons(file: Path) -> list[Polygon]:
    """Polygons of an additional file, of the kinds that road maps have."""
    found = []
    for element in elements(file, "additional"):
        kind = element.get("type", "")
        kind = next((one for one in _BESIDE_ROADS if kind.startswith(f"{one}.")), kind)
        if element.tag == "poly" and kind in _POLYGONS:
            try:
                shape = points(element.get("shape", ""))
            except ValueError as error:
                raise SimulationError(f"{file} has a wrong <poly>: {error}.") from None
            if len(shape) > 3 and (shape[0] == shape[-1]).all():
                shape = shape[:-1]
            found.append(
                Polygon(
                    id=element.get("id", ""),
                    kind=cast(PolygonKind, kind),
                    points_m=shape[:, :2],
                    z_m=shape[:, 2],
                )
            )
    return found


def _stop_signs(net: NetFile, known: set[str]) -> tuple[StopSign, ...]:
    """A sign at the end of each lane whose links are stops."""
    shapes = {lane.id: lane.shape_m for edge in net.edges.values() for lane in edge.lanes}
    stops: dict[str, None] = {
        link.origin: None
        for link in net.links
        if link.state in _STOP_STATES and link.state and link.origin in known
    }
    return tuple(
        StopSign(
            id=f"stop_{lane_id}",
            position_m=shapes[lane_id][-1, :2],
            z_m=float(shapes[lane_id][-1, 2]),
            lane_ids=(lane_id,),
        )
        for lane_id in stops
        if not lane_id.startswith(":")
    )
