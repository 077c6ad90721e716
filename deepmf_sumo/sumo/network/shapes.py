"""Restores the scene's shapes in the net, and maps SUMO lanes to parts of the scene's lanes.

netconvert shortens lanes at junctions and gives all lanes of an edge one length. Both are undone
here, lane by lane; connections and right of way stay as netconvert made them.
"""

import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from deepmf_sumo.scene import Floats, LanePiece, SignalLink
from deepmf_sumo.scene.geometry import polylines
from deepmf_sumo.sumo.network import lane_graph
from deepmf_sumo.sumo.network.build import JOINT_M
from deepmf_sumo.sumo.network.lane_graph import LaneGraph
from deepmf_sumo.sumo.network.plain_net import Blueprint, LaneRef, LinkPlan, coordinates
from deepmf_sumo.sumo.network.sumo_net import points

_LinkKey = tuple[LaneRef, LaneRef]


@dataclass(kw_only=True)
class Placement:
    """Places of the scene's lanes in the net.

    Attributes:
        pieces: scene lane -> its pieces in driving order.
        lane_of: SUMO lane -> scene lanes on it, in driving order.
        signals: scene lane -> links that carry its light.
        covered: joins of scene lanes that a connection of the net leads over.
        dropped: joins of connections that netconvert left out.
    """

    pieces: dict[str, list[LanePiece]] = field(default_factory=lambda: defaultdict(list))
    lane_of: dict[str, tuple[str, ...]] = field(default_factory=dict)
    signals: dict[str, tuple[SignalLink, ...]] = field(default_factory=dict)
    covered: set[tuple[str, str]] = field(default_factory=set)
    dropped: set[tuple[str, str]] = field(default_factory=set)


class NetShapes:
    """A net of netconvert, whose lanes get new shapes."""

    def __init__(self, file: Path) -> None:
        self.root = ET.parse(file).getroot()  # noqa: S314 (netconvert wrote it a moment ago)
        self._lanes = {str(lane.get("id")): lane for lane in self.root.iter("lane")}
        self._inner = {
            str(node.get("id")): node
            for node in self.root.iter("junction")
            if node.get("type") == "internal"
        }
        self._links: dict[_LinkKey, ET.Element] = {}
        self._onward: dict[str, str] = {}
        for link in self.root.iter("connection"):
            origin = str(link.get("from")), int(str(link.get("fromLane")))
            if origin[0].startswith(":"):
                self._onward[f"{origin[0]}_{origin[1]}"] = link.get("via", "")
            else:
                target = str(link.get("to")), int(str(link.get("toLane")))
                self._links[origin, target] = link

    def reshape(self, lane_id: str, shape_m: Floats) -> None:
        """Give a lane a shape (P, 2) and the length of it."""
        lane = self._lanes[lane_id]
        length = float(polylines.arc_lengths(shape_m)[-1])
        lane.set("length", f"{max(length, JOINT_M):.3f}")
        lane.set("shape", coordinates(shape_m))
        if lane_id in self._inner:
            # An internal junction has the id of the lane that starts there.
            for axis, value in zip("xy", shape_m[0], strict=True):
                self._inner[lane_id].set(axis, f"{value:.3f}")

    def allow_speed(self, lane_id: str, speed_mps: float) -> None:
        """Raise a lane's limit if it is lower.

        netconvert takes directions from whole edges, and so finds sharp turns where two lanes only
        touch.
        """
        lane = self._lanes[lane_id]
        if float(str(lane.get("speed"))) < speed_mps:
            lane.set("speed", f"{speed_mps:.2f}")

    def link(self, plan: LinkPlan) -> ET.Element | None:
        """The net's link for a planned one."""
        return self._links.get((plan.origin, plan.target))

    def chain(self, link: ET.Element) -> list[str]:
        """The internal lanes of a connection: two if cars wait inside the junction."""
        lanes = []
        via = link.get("via", "")
        while via:
            lanes.append(via)
            via = self._onward.get(via, "")
        return lanes

    def chain_bounds(self, chain: list[str], length_m: float) -> Floats:
        """(n + 1) arc lengths of the ends of a chain's lanes, in netconvert's proportions."""
        lengths = [float(str(self._lanes[lane_id].get("length"))) for lane_id in chain]
        bounds = np.concatenate([[0.0], np.cumsum(lengths)])
        scaled: Floats = bounds * (length_m / bounds[-1])
        return scaled

    def write(self, file: Path) -> None:
        """Write the net without netconvert's comment, which contains the date."""
        text = ET.tostring(self.root, encoding="unicode")
        file.write_text(f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n', encoding="utf-8")

    def shapes(self) -> dict[str, Floats]:
        """(P, 2) of every lane, as the file says."""
        return {
            lane_id: points(str(lane.get("shape")))[:, :2] for lane_id, lane in self._lanes.items()
        }


def place(net: NetShapes, blueprint: Blueprint, graph: LaneGraph) -> Placement:
    """Restore the shapes of all lanes."""
    placement = Placement()
    for edge in blueprint.edges.values():
        for index, lane in enumerate(edge.lanes):
            key = f"{edge.id}_{index}"
            net.reshape(key, lane.shape_m)
            placement.lane_of[key] = (lane.scene_lane,) if lane.scene_lane else ()
            if lane.scene_lane:
                length = float(polylines.arc_lengths(lane.shape_m)[-1])
                piece = LanePiece(sumo_lane=key, start_m=lane.start_m, length_m=length)
                placement.pieces[lane.scene_lane].append(piece)
    for plan in blueprint.links:
        _place_link(net, plan, blueprint, graph, placement)
    _attach_points(graph, placement)
    for lane_id, keys in blueprint.signalled.items():
        links = [net.link(plan) for plan in blueprint.links if (plan.origin, plan.target) in keys]
        placement.signals[lane_id] = tuple(
            SignalLink(light=str(link.get("tl")), index=int(str(link.get("linkIndex"))))
            for link in links
            if link is not None and link.get("tl")
        )
    for pieces in placement.pieces.values():
        pieces.sort(key=lambda piece: piece.start_m)
    return placement


def _place_link(
    net: NetShapes, plan: LinkPlan, blueprint: Blueprint, graph: LaneGraph, placement: Placement
) -> None:
    link = net.link(plan)
    origin, target = (blueprint.lane(ref).scene_lane for ref in (plan.origin, plan.target))
    if blueprint.lane(plan.target).start_m == 0.0:  # otherwise it joins the two halves of a lane
        row = [lane_id for lane_id in (origin, *plan.path, target) if lane_id]
        joins = placement.dropped if link is None else placement.covered
        joins |= set(pairwise(row))
    if link is None:
        return
    chain = net.chain(link)
    bounds = net.chain_bounds(chain, float(polylines.arc_lengths(plan.shape_m)[-1]))
    for key, (start, end) in zip(chain, pairwise(bounds), strict=True):
        net.reshape(key, lane_graph.part(plan.shape_m, start, end))
        net.allow_speed(key, plan.speed_mps)
        on_it = []
        for lane_id, first, last in _intervals(graph, plan.path):
            begin, stop = max(first, start), min(last, end)
            if stop - begin > 1e-6 or (first == last and start <= first <= end + 1e-6):
                on_it.append(lane_id)
                placement.pieces[lane_id].append(
                    LanePiece(sumo_lane=key, start_m=begin - first, length_m=max(stop - begin, 0.0))
                )
        if origin and plan.kind == "joint":
            on_it.insert(0, origin)
        placement.lane_of[key] = tuple(on_it)


def _intervals(graph: LaneGraph, path: tuple[str, ...]) -> Iterator[tuple[str, float, float]]:
    """Start and end of each lane of a path, as arc lengths on the path."""
    along = 0.0
    for lane_id in path:
        length = graph.lengths_m[lane_id]
        yield lane_id, along, along + length
        along += length


def _attach_points(graph: LaneGraph, placement: Placement) -> None:
    """A one-point lane at a loose end is a point of the lane that it touches."""
    for lane_id, (touched, at_end) in graph.loose.items():
        sumo_lane = placement.pieces[touched][-1 if at_end else 0].sumo_lane
        placement.pieces[lane_id].append(LanePiece(sumo_lane=sumo_lane, start_m=0.0, length_m=0.0))
