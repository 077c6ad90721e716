"""A SUMO network as a road map: what views show where there is no recording."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Final, cast

import numpy as np
import shapely

from deepmf_sumo.datatypes import (
    Lane,
    Neighbour,
    Polygon,
    RoadMap,
    SignalLink,
    StopSign,
)
from deepmf_sumo.datatypes.road import LaneKind, PolygonKind
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.network.borders import borders
from deepmf_sumo.network.net_file import NetEdge, NetFile, NetLane, elements, points, read_once
from deepmf_sumo.network.right_of_way import going_first

_VEHICLES: Final = ("passenger", "truck", "bus", "taxi", "delivery", "motorcycle", "emergency")
_FREEWAY_MPS: Final = 24.0
"""Limits above 86 km/h are those of roads without crossings."""
_POLYGONS: Final = ("crosswalk", "speed_bump", "driveway")
_STOP_STATES: Final = "sw"
"""States of links behind a stop sign: stop, all-way stop."""


def road_of_net(net_file: Path, additional: Sequence[Path] = ()) -> RoadMap:
    """The road map of a SUMO network.

    One lane per SUMO lane that vehicles or bicycles may use, with its id, those inside junctions
    too (``interpolating``). Joins lead over the lanes inside; pedestrian crossings become
    crosswalks; painted lines and road edges are derived from the lanes' widths.

    Args:
        net_file: .net.xml or .net.xml.gz.
        additional: additional files; their polygons of type crosswalk, speed_bump or driveway are
            taken.

    Raises SimulationError where a file cannot be read or is of another kind.
    """
    net = read_once(net_file)
    lanes = {
        lane.id: kind
        for edge in net.edges.values()
        for lane in edge.lanes
        if (kind := _kind(edge, lane)) and len(lane.shape_m) > 1
    }
    after: dict[str, list[str]] = defaultdict(list)
    before: dict[str, list[str]] = defaultdict(list)
    for link in net.links:
        if link.origin in lanes and link.onto in lanes:
            after[link.origin].append(link.onto)
            before[link.onto].append(link.origin)
    lines, edges = borders(net, lanes)
    goes_first = going_first(net)
    return RoadMap(
        lanes={
            lane.id: replace(
                _lane(net, edge, lane, lanes, after[lane.id], before[lane.id]),
                gives_way_to=tuple(name for name in goes_first.get(lane.id, ()) if name in lanes),
            )
            for edge in net.edges.values()
            for lane in edge.lanes
            if lane.id in lanes
        },
        lines=lines,
        edges=edges,
        polygons=(*_crossings(net), *(shape for file in additional for shape in _polygons(file))),
        stop_signs=_stop_signs(net, set(lanes)),
    )


def road_once(net_file: Path, additional: Sequence[Path] = ()) -> RoadMap:
    """As `road_of_net`; the last roads are kept as long as their files stay as they are.

    Attacks on one network follow one another, and what is derived of a road is kept with it.
    """
    files = (net_file, *additional)
    stamps = tuple(file.stat().st_mtime_ns if file.exists() else -1 for file in files)
    return _road_stamped(files, stamps)


@lru_cache(maxsize=4)
def _road_stamped(files: tuple[Path, ...], _stamps: tuple[int, ...]) -> RoadMap:
    return road_of_net(files[0], files[1:])


def signal_links(net_file: Path) -> dict[str, tuple[SignalLink, ...]]:
    """Links of traffic lights, by the lane behind the light: a lane of the net's road map.

    Raises SimulationError where the file cannot be read or is no SUMO network.
    """
    links: dict[str, list[SignalLink]] = defaultdict(list)
    for link in read_once(net_file).links:
        # Links that begin inside a junction are pedestrians'.
        if link.light and not link.origin.startswith(":"):
            links[link.onto].append(SignalLink(light=link.light, index=link.index))
    return {lane_id: tuple(row) for lane_id, row in links.items()}


def _kind(edge: NetEdge, lane: NetLane) -> LaneKind | None:
    """Kind of a lane; None for those that only pedestrians, trains or ships use."""
    if edge.function in {"crossing", "walkingarea", "connector"}:
        return None
    if any(lane.allows(vehicle) for vehicle in _VEHICLES):
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
                line = shapely.LineString(lane.shape_m[:, :2])
                half_m = lane.width_m / 2
                area = shapely.buffer(line, half_m, cap_style="flat", join_style="mitre")
                corners = shapely.get_coordinates(shapely.get_exterior_ring(area))[:-1]
                height = np.full(len(corners), lane.shape_m[0, 2])
                found.append(Polygon(id=edge.id, kind="crosswalk", points_m=corners, z_m=height))
    return found


def _polygons(file: Path) -> list[Polygon]:
    """Polygons of an additional file that are of a kind that road maps know."""
    found = []
    for element in elements(file, "additional"):
        kind = element.get("type", "")
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
