"""What is beside the way of an AV, and when it comes by: borders, stops, crossings, vehicles."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final, Literal

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.scene import (
    DT_S,
    AgentId,
    Bools,
    Floats,
    Rollout,
    Tracks,
    TrafficCase,
)
from deepmf_sumo.scene.geometry import boxes, frames, polylines
from deepmf_sumo.scene.geometry.ground import clear
from deepmf_sumo.sumo.network.carriageway import carriageway_of, driven_on
from deepmf_sumo.sumo.network.sumo_net import NetEdge, NetFile, NetLane, elements, number, read_once
from deepmf_sumo.sumo.simulation.sumo_config import read_configuration

Side = Literal[-1, 1]
"""1: left of the way, -1: right."""
GAP_M: Final = (0.3, 1.0)
"""Between the border of the carriageway and the box of somebody who stands beside it."""
_SPACING_M: Final = 1.0
_STEP_M: Final = 0.1
_FARTHEST_M: Final = 20.0
"""Beside the way; a carriageway that is wider is a square, or several roads."""
_MOVES_M: Final = 0.05
_BEHIND_M: Final = 12.0
"""The way is continued straight back so far: who walks along it may come from there."""
_CLEAR_M: Final = 0.3
"""Between boxes of road users and those of made people."""
_NOBODY_WALKS: Final = ("motorway", "trunk")
_FASTEST_MPS: Final = 25.0
_TYPE_REACH_M: Final = 3.0
_STANDS_MPS: Final = 0.3


@dataclass(frozen=True, kw_only=True, eq=False)
class Roadside:
    """The way of an AV without an attack, and what is around it.

    Attributes:
        tracks: of everybody without an attack. now: the step of the start. av: row of the AV.
        way_m: (P, 2) of its centre, a metre apart, from `_BEHIND_M` behind its start on. arrives_s:
            (P) when its front is there; negative where it has been. z_m: (P).
        carriageway: where vehicles drive.
        net: its network.
    """

    tracks: Tracks
    now: int
    av: int
    way_m: Floats
    arrives_s: Floats
    z_m: Floats
    carriageway: BaseGeometry
    net: NetFile

    @classmethod
    def of(cls, case: TrafficCase, rollout: Rollout) -> "Roadside | None":
        """Of a case and its episode without an attack; None where the AV does not move."""
        tracks, now = rollout.tracks, rollout.now
        row = tracks.row(rollout.av_id)
        steps = np.flatnonzero(tracks.valid[row, now:]) + now
        place, height = tracks.position_m[row, steps], tracks.z_m[row, steps]
        gone = np.concatenate([[True], np.hypot(*np.diff(place, axis=0).T) > _MOVES_M])
        if gone.sum() < 2:
            return None
        heading = frames.unit(tracks.heading_rad[row, steps[0]])
        line = np.concatenate([[place[0] - _BEHIND_M * heading], place[gone]])
        at_m = polylines.arc_lengths(line)
        along_m = np.arange(0.0, at_m[-1], _SPACING_M)
        way_m, _ = polylines.points_at(line, along_m)
        front_m = along_m - tracks.size_m[row, 0] / 2
        arrives_s = np.interp(front_m, at_m[1:], (steps[gone] - now) * DT_S, left=-1.0)
        z_m = np.interp(along_m, at_m[1:], height[gone])
        near = carriageway_of(case.net_file).near(way_m, 2 * _FARTHEST_M, z_m)
        shapely.prepare(near)
        return cls(
            tracks=tracks,
            now=now,
            av=row,
            way_m=way_m,
            arrives_s=arrives_s,
            z_m=z_m,
            carriageway=near,
            net=read_once(case.net_file),
        )

    @cached_property
    def normal(self) -> Floats:
        """(P, 2) to the left of the way."""
        step = np.gradient(self.way_m, axis=0)
        step /= np.maximum(np.hypot(*step.T), 1e-9)[:, None]
        return np.column_stack([-step[:, 1], step[:, 0]])

    def meets(self, line_m: Floats) -> bool:
        """Whether a line (P, 3) is at the way's height where the two are nearest."""
        line = shapely.LineString(line_m[:, :2])
        nearest = shapely.shortest_line(shapely.LineString(self.way_m), line)
        on_way, on_line = shapely.get_coordinates(nearest)
        height = polylines.heights_at(line_m[:, :2], line_m[:, 2], on_line)
        return not clear(height, self.z_m[self.reached(on_way)[0]])

    @property
    def outer(self) -> Side:
        """The side of the kerb."""
        return 1 if self.net.left_hand else -1

    def reached(self, place_m: Floats) -> tuple[int, float]:
        """The nearest point of the way to a place (2,), by its number, and how far off it is."""
        away = np.hypot(*(self.way_m - place_m).T)
        at = int(away.argmin())
        return at, float(away[at])

    def heights_m(self, points_m: Floats) -> Floats:
        """(N) of the way where it is nearest to points (N, 2)."""
        away = np.hypot(*np.moveaxis(np.asarray(points_m)[:, None] - self.way_m, -1, 0))
        return np.asarray(self.z_m[away.argmin(axis=1)], float)

    def kept(self, half_m: float, gap_m: float = GAP_M[0]) -> BaseGeometry:
        """Where the centre of a box that wide cannot be beside the carriageway."""
        area = shapely.buffer(self.carriageway, gap_m + half_m)
        shapely.prepare(area)
        return area

    def exits_m(self, kept: BaseGeometry, side: Side, from_m: float = 0.0) -> Floats:
        """(P) offset from the way, to a side, of the first place that is free; nan: there is none.

        ``from_m``: begin so far from the way.
        """
        offset = np.arange(from_m, _FARTHEST_M, _STEP_M)
        rays = self.way_m[:, None] + side * offset[:, None] * self.normal[:, None]
        free = ~shapely.contains_xy(kept, rays[..., 0], rays[..., 1])
        first = free.argmax(axis=1)
        found: Floats = np.where(free.any(axis=1), offset[first], np.nan)
        return found

    def beside(self, at: int, side: Side, offset_m: float) -> Floats:
        """The place (2,) at an offset to a side of a point of the way."""
        return np.asarray(self.way_m[at] + side * offset_m * self.normal[at], float)

    @cached_property
    def inside(self) -> Bools:
        """(P) whether the way is in a junction there."""
        found = np.zeros(len(self.way_m), bool)
        low, high = self.way_m.min(axis=0), self.way_m.max(axis=0)
        for one in self.net.junctions:
            ring, z_m = one.shape_m[:, :2], one.shape_m[:, 2]
            if len(ring) > 2 and (ring.max(axis=0) > low).all() and (ring.min(axis=0) < high).all():
                area = shapely.buffer(shapely.Polygon(ring), 0.0)
                found |= shapely.contains_xy(area, *self.way_m.T) & ~clear(self.z_m, z_m.mean())
        return found

    @cached_property
    def walked(self) -> Bools:
        """(P) whether people walk along that road: not on motorways and the like."""
        lanes = self.lanes_near
        if not lanes:
            return np.ones(len(self.way_m), bool)
        tree = shapely.STRtree([shapely.LineString(lane.shape_m[:, :2]) for _, lane in lanes])
        found = np.ones(len(self.way_m), bool)
        points = shapely.points(self.way_m)
        rows, nearest = tree.query_nearest(points, max_distance=_TYPE_REACH_M, all_matches=False)
        for row, one in zip(rows.tolist(), nearest.tolist(), strict=True):
            edge, lane = lanes[one]
            kind = edge.type.lower()
            found[row] = (
                not any(word in kind for word in _NOBODY_WALKS) and lane.speed_mps <= _FASTEST_MPS
            )
        return found

    @cached_property
    def lanes_near(self) -> list[tuple[NetEdge, NetLane]]:
        """Driven lanes outside junctions within reach of the way, and on its level."""
        low, high = self.way_m.min(axis=0) - _FARTHEST_M, self.way_m.max(axis=0) + _FARTHEST_M
        return [
            (edge, lane)
            for edge in self.net.edges.values()
            if not edge.function
            for lane in edge.lanes
            if len(lane.shape_m) > 1
            and (lane.shape_m[:, :2].max(axis=0) > low).all()
            and (lane.shape_m[:, :2].min(axis=0) < high).all()
            and driven_on(lane)
            and self.meets(lane.shape_m)
        ]

    def free(self, poses: Floats, size_m: Sequence[float], others: dict[AgentId, Floats]) -> bool:
        """Whether a box is in nobody's way.

        Args:
            poses: (T, 3) of the box at the steps of the tracks, x, y and heading.
            size_m: its length and width.
            others: (T, 3) poses of other made people, who are as wide as they are long.
        """
        tracks, grown = self.tracks, np.array(size_m[:2]) + 2 * _CLEAR_M
        near = np.hypot(*np.moveaxis(tracks.position_m - poses[:, :2], -1, 0)) < 25.0
        near &= ~clear(tracks.z_m, self.heights_m(poses[:, :2]))
        rows, steps = np.nonzero(near & tracks.valid)
        hit = boxes.overlap(
            poses[steps, :2],
            poses[steps, 2],
            np.broadcast_to(grown, (len(steps), 2)),
            tracks.position_m[rows, steps],
            tracks.heading_rad[rows, steps],
            tracks.size_m[rows, :2],
        )
        apart = [np.hypot(*(one[:, :2] - poses[:, :2]).T).min() for one in others.values()]
        return not bool(np.any(hit)) and all(one > 2.0 for one in apart)


def crossings(here: Roadside) -> Iterator[Floats]:
    """(P, 2) lines of the crossings that the way crosses."""
    way = shapely.LineString(here.way_m)
    for edge in here.net.edges.values():
        for lane in edge.lanes if edge.function == "crossing" else ():
            line = shapely.LineString(lane.shape_m[:, :2]) if len(lane.shape_m) > 1 else None
            if line is not None and line.intersects(way) and here.meets(lane.shape_m):
                yield lane.shape_m[:, :2]


def stop_lines(here: Roadside) -> list[int]:
    """Points of the way a metre before the traffic lights on it."""
    lights = {link.origin for link in here.net.links if link.light}
    found = set()
    for _, lane in here.lanes_near:
        if lane.id in lights:
            at, away_m = here.reached(lane.shape_m[-1, :2])
            if away_m < lane.width_m / 2 and at > 1:
                found.add(at - 1)
    return sorted(found)


def bus_stops(here: Roadside, case: TrafficCase) -> Iterator[Floats]:
    """(2,) places along the stops beside the lanes near the way, two metres apart."""
    lanes = {lane.id: lane for _, lane in here.lanes_near}
    for file in read_configuration(case.config, case.sumo_options).additional:
        for element in _stop_elements(file):
            lane = lanes.get(element.get("lane", ""))
            if lane is None:
                continue
            try:
                begin = number(element, "startPos", 0.0)
                end = number(element, "endPos", lane.length_m)
            except ValueError:  # SUMO has read it, so it is a word that SUMO knows
                continue
            begin, end = (one + lane.length_m * (one < 0) for one in (begin, end))
            along = np.arange(begin + 1.0, max(end, begin + 1.5), 2.0)
            yield from polylines.points_at(lane.shape_m[:, :2], along)[0]


def _stop_elements(file: Path) -> list[ET.Element]:
    try:
        return [one for one in elements(file, "additional") if one.tag in ("busStop", "trainStop")]
    except SimulationError:  # SUMO reads additional files of kinds that are no plain XML
        return []


@dataclass(frozen=True, slots=True)
class _Parked:
    """A vehicle that stands beside the way: its ends along it, and how far to its left it is."""

    first_m: float
    last_m: float
    left_m: float

    @property
    def side(self) -> Side:
        return 1 if self.left_m > 0 else -1


def parked(here: Roadside) -> list[_Parked]:
    """Vehicles that stand beside the way until the AV has come by."""
    tracks, found = here.tracks, []
    half_m = float(tracks.size_m[here.av, 1]) / 2
    for row in range(tracks.agents):
        if row == here.av or tracks.kinds[row] not in ("vehicle", "other"):
            continue
        if not tracks.valid[row, : here.now + 1].all():
            continue
        place = tracks.position_m[row, here.now]
        at, away_m = here.reached(place)
        if clear(tracks.z_m[row, here.now], here.z_m[at]):
            continue
        arrives = here.now + int(max(here.arrives_s[at], 0.0) / DT_S)
        stands = tracks.speed_mps[row, : arrives + 1].max() < _STANDS_MPS
        left_m = float((place - here.way_m[at]) @ here.normal[at])
        clear_m = half_m + float(tracks.size_m[row, 1]) / 2
        if stands and away_m < 8.0 and abs(left_m) > clear_m and at > 0:
            half = float(tracks.size_m[row, 0]) / 2
            found.append(_Parked(first_m=at - half, last_m=at + half, left_m=left_m))
    return sorted(found, key=lambda one: one.first_m)
