"""Conversion of a recorded scene into a SUMO network: built, checked against the scene, cached.

::

    lanes --lane_graph--> simplified, joined --layout--> edges, junctions --build--> blueprint
          --plain_net, netconvert--> net --> the scene's shapes restored --> errors

netconvert shortens lanes at junctions and gives all lanes of an edge one length. Both are undone
here, lane by lane; connections and right of way stay as netconvert made them. SUMO's lanes are
mapped to parts of the scene's lanes.
"""

import hashlib
import tempfile
import time
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
import shapely

import deepmf_sumo
from deepmf_sumo import files
from deepmf_sumo.errors import ConversionError
from deepmf_sumo.scene import (
    ConversionReport,
    Floats,
    LanePiece,
    RoadMap,
    Scene,
    SignalLink,
    SumoNet,
)
from deepmf_sumo.scene.geometry import polylines
from deepmf_sumo.sumo.network import mapping, plain_net, sumo_tools
from deepmf_sumo.sumo.network.build import JOINT_M, Assembly, control, ghost_edge, leaves_lanes
from deepmf_sumo.sumo.network.lane_graph import LaneGraph, lane_graph, part
from deepmf_sumo.sumo.network.layout import layout
from deepmf_sumo.sumo.network.plain_net import Blueprint, LaneRef, LinkPlan, NodePlan, coordinates
from deepmf_sumo.sumo.network.sumo_net import points


@dataclass(kw_only=True)
class _Placement:
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


class _NetShapes:
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


def _place(net: _NetShapes, blueprint: Blueprint, graph: LaneGraph) -> _Placement:
    """Restore the shapes of all lanes."""
    placement = _Placement()
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
    net: _NetShapes, plan: LinkPlan, blueprint: Blueprint, graph: LaneGraph, placement: _Placement
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
        net.reshape(key, part(plan.shape_m, start, end))
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


def _attach_points(graph: LaneGraph, placement: _Placement) -> None:
    """A one-point lane at a loose end is a point of the lane that it touches."""
    for lane_id, (touched, at_end) in graph.loose.items():
        sumo_lane = placement.pieces[touched][-1 if at_end else 0].sumo_lane
        placement.pieces[lane_id].append(LanePiece(sumo_lane=sumo_lane, start_m=0.0, length_m=0.0))


SPACING_M: Final = 0.5
_LinkKey = tuple[LaneRef, LaneRef]


def distances(
    road: RoadMap,
    pieces: Mapping[str, tuple[LanePiece, ...]],
    lane_of: Mapping[str, tuple[str, ...]],
    shapes: Mapping[str, Floats],
) -> Floats:
    """Distances in both directions, in one array.

    From every recorded point of a lane to the nearest of that lane's pieces, and from points of the
    SUMO lanes, 0.5 m apart, to the nearest of the scene's lanes that they are made of. Lanes that
    only SUMO has (extensions, the ghost edge) are left out.

    Args:
        road: the scene's, as recorded.
        pieces: scene lane -> its SUMO lanes.
        lane_of: SUMO lane -> its scene lanes.
        shapes: (P, 2) of each SUMO lane, as written.
    """
    recorded = {key: lane.centre_m for key, lane in road.lanes.items()}
    to_sumo = [
        (recorded[key], [shapes[piece.sumo_lane] for piece in parts])
        for key, parts in pieces.items()
        if parts
    ]
    to_scene = [
        (_dense(shapes[key]), [recorded[lane_id] for lane_id in lane_ids])
        for key, lane_ids in lane_of.items()
        if lane_ids
    ]
    return _to_lines(to_sumo + to_scene)


def _dense(points_m: Floats) -> Floats:
    points: Floats = shapely.get_coordinates(
        shapely.segmentize(shapely.linestrings(points_m), SPACING_M)
    )
    return points


def _to_lines(tasks: list[tuple[Floats, list[Floats]]]) -> Floats:
    """Distance of each point of each task to the nearest of the task's polylines."""
    if not tasks:
        return np.zeros(0)
    targets = np.array([_geometry(lines) for _, lines in tasks])
    shapely.prepare(targets)
    points = shapely.points(np.concatenate([points for points, _ in tasks]))
    owner = np.repeat(np.arange(len(tasks)), [len(points) for points, _ in tasks])
    distance: Floats = shapely.distance(targets[owner], points)
    return distance


def _geometry(lines: list[Floats]) -> shapely.Geometry:
    parts = [shapely.LineString(line if len(line) > 1 else line[[0, 0]]) for line in lines]
    return parts[0] if len(parts) == 1 else shapely.GeometryCollection(parts)


_OPTIONS: Final = (
    "--offset.disable-normalization",
    "--no-turnarounds",
    "--precision",
    "3",
    "--default.junctions.radius",
    "0",
    "--junctions.corner-detail",
    "0",
    "--junctions.endpoint-shape",
    "--tls.default-type",
    "static",
    "--xml-validation",
    "never",
    "--no-warnings",
)
_NO_WAY: Final = "another way leads between the same two SUMO lanes"


def convert(scene: Scene, folder: Path) -> SumoNet:
    """Build the SUMO network of a scene.

    The folder, created or replaced as a whole, contains the net, its plain XML, polygons to draw, a
    configuration, and the side file ``mapping.json``. The same scene gives the same bytes.

    Raises ConversionError if the scene has no lane that can be driven, SUMO refuses, or the folder
    contains something else.
    """
    began = time.perf_counter()
    _check_replaceable(folder)
    with files.whole_folder(folder) as beside:
        net = _build(scene, beside)
    assert net.report is not None
    return replace(
        net,
        file=folder / mapping.NET_FILE,
        additional=folder / mapping.ADDITIONAL_FILE,
        report=replace(net.report, seconds=time.perf_counter() - began),
    )


def _check_replaceable(folder: Path) -> None:
    if folder.is_dir() and any(folder.iterdir()) and not (folder / mapping.MAPPING_FILE).exists():
        raise ConversionError(
            f"{folder} holds something other than a converted net; give another folder."
        )


def _build(scene: Scene, folder: Path) -> SumoNet:
    graph = lane_graph(scene.road)
    blueprint, lost_signals = _blueprint(scene, graph)
    nodes, edges, links = plain_net.write(blueprint, folder)
    file = folder / mapping.NET_FILE
    sumo_tools.run(
        "netconvert",
        "-n",
        str(nodes),
        "-e",
        str(edges),
        "-x",
        str(links),
        "-o",
        str(file),
        *_OPTIONS,
    )
    shapes = _NetShapes(file)
    placed = _place(shapes, blueprint, graph)
    shapes.write(file)
    pieces = {key: tuple(row) for key, row in placed.pieces.items()}
    net = SumoNet(
        file=file,
        additional=mapping.write_additional(
            [*scene.road.polygons, *scene.road.buildings, *scene.road.water],
            folder / mapping.ADDITIONAL_FILE,
            flat=True,
        ),
        pieces=pieces,
        lane_of=placed.lane_of,
        signals=placed.signals,
        ghost_edge=blueprint.ghost_edge,
        report=_report(
            scene,
            graph,
            placed,
            distances(scene.road, pieces, placed.lane_of, shapes.shapes()),
            lost_signals,
        ),
    )
    mapping.write_config(folder)
    mapping.write(net, folder)
    return net


def _blueprint(scene: Scene, graph: LaneGraph) -> tuple[Blueprint, tuple[tuple[str, str], ...]]:
    """The net to build, and the signalled lanes without a connection."""
    plan = layout(graph, set(scene.signals.lane_ids))
    if not plan.groups:
        raise ConversionError(
            f"{scene.source.file}: scene {scene.name} has no lane with a length among "
            f"{len(scene.road.lanes)}: there is no road to build."
        )
    assembly = Assembly(graph, plan)
    lights = control(assembly, scene.signals.lane_ids, scene.road.stop_signs)
    nodes = tuple(
        NodePlan(id=key, position_m=position, kind=lights.kinds.get(key, "priority"))
        for key, position in assembly.node_positions().items()
    )
    edges, ghost = assembly.edges, None
    if leaves_lanes(scene):
        edge, ends = ghost_edge(scene)
        edges, nodes, ghost = {**edges, edge.id: edge}, (*nodes, *ends), edge.id
    blueprint = Blueprint(
        nodes=nodes,
        edges=edges,
        links=tuple(assembly.links),
        signalled=lights.signalled,
        ghost_edge=ghost,
    )
    return blueprint, lights.lost


def _report(
    scene: Scene,
    graph: LaneGraph,
    placed: _Placement,
    distance_m: Floats,
    lost_signals: tuple[tuple[str, str], ...],
) -> ConversionReport:
    lost_lanes = [
        (key, "no way through a junction is left for it")
        for key in graph.shapes
        if not placed.pieces.get(key)
    ]
    lost_joins = [
        (first, second, "netconvert left it out" if (first, second) in placed.dropped else _NO_WAY)
        for first, afters in graph.following.items()
        for second in afters
        if (first, second) not in placed.covered
    ]
    found = distance_m if len(distance_m) else np.zeros(1)
    return ConversionReport(
        lanes=len(scene.road.lanes),
        connections=graph.connections,
        lost_lanes=(*graph.lost_lanes, *lost_lanes),
        lost_connections=(*graph.lost_connections, *lost_joins),
        error_mean_m=round(float(found.mean()), 6),
        error_p99_m=round(float(np.percentile(found, 99)), 6),
        error_max_m=round(float(found.max()), 6),
        bridged_connections=tuple(
            (*pair, f"{gap:.1f} m") for pair, gap in graph.gaps.items() if pair in placed.covered
        ),
        lost_signals=lost_signals,
    )


def cached(scene: Scene, cache: Path) -> SumoNet:
    """The scene's net from the cache, built there if it is missing.

    The key is a hash of what the net is made of (road, signalled lanes, the AV's path) and of the
    versions of the programs. Several processes may call this for the same scene. A net that was
    just built is read back, so that it has the rounded values of a cached one.

    Raises ConversionError as `convert` does.
    """
    folder = cache / key(scene)
    try:
        return mapping.read(folder)
    except ConversionError:
        pass
    cache.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".building-", dir=cache) as beside:
        built = Path(beside) / folder.name
        convert(scene, built)
        _move(built, folder)
    return mapping.read(folder)


def _move(built: Path, folder: Path) -> None:
    """Move a net into the cache, unless another process was faster; replace a broken one."""
    try:
        built.replace(folder)
    except OSError:
        try:
            mapping.read(folder)
        except ConversionError:
            files.take_place(built, folder)


def key(scene: Scene) -> str:
    """Hex digest of what the net of a scene depends on."""
    digest = hashlib.sha256()
    for each in _parts(scene):
        digest.update(each)
        digest.update(b"\0")
    return digest.hexdigest()[:32]


def _parts(scene: Scene) -> Iterator[bytes]:
    yield f"{deepmf_sumo.__version__} {sumo_tools.version()} {mapping.FORMAT}".encode()
    for lane in scene.road.lanes.values():
        facts = (
            lane.id,
            lane.kind,
            lane.interpolating,
            lane.width_m,
            lane.speed_limit_mps,
            lane.next,
            lane.previous,
            [neighbour.lane_id for neighbour in (*lane.right, *lane.left)],
        )
        yield repr(facts).encode()
        yield lane.centre_m.tobytes()
        yield lane.z_m.tobytes()
    for shape in (*scene.road.polygons, *scene.road.buildings, *scene.road.water):
        yield f"{shape.kind} {shape.id}".encode()
        yield shape.points_m.tobytes()
    for sign in scene.road.stop_signs:
        yield f"{sign.lane_ids} {sign.position_m.tolist()}".encode()
    yield repr(sorted(scene.signals.lane_ids)).encode()
    row = scene.tracks.row(scene.av_id)
    yield str(scene.now).encode()
    tracks = scene.tracks
    for array in (tracks.position_m, tracks.z_m, tracks.heading_rad, tracks.valid):
        yield np.ascontiguousarray(array[row]).tobytes()
    yield np.ascontiguousarray(scene.tracks.velocity_mps[row]).tobytes()
