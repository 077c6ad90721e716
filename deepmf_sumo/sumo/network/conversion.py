"""Conversion of a recorded scene into a SUMO network: built, checked against the scene, cached.

::

    lanes --lane_graph--> simplified, joined --layout--> edges, junctions --build--> blueprint
          --plain_net, netconvert--> net --shapes--> the scene's shapes restored --> errors
"""

import hashlib
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import shapely

import deepmf_sumo
from deepmf_sumo import files
from deepmf_sumo.errors import ConversionError
from deepmf_sumo.scene import ConversionReport, Floats, LanePiece, RoadMap, Scene, SumoNet
from deepmf_sumo.sumo.network import mapping, plain_net, sumo_tools
from deepmf_sumo.sumo.network.build import Assembly, control, ghost_edge, leaves_lanes
from deepmf_sumo.sumo.network.lane_graph import LaneGraph, lane_graph
from deepmf_sumo.sumo.network.layout import layout
from deepmf_sumo.sumo.network.plain_net import Blueprint, NodePlan
from deepmf_sumo.sumo.network.shapes import NetShapes, Placement, place

SPACING_M: Final = 0.5


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
    shapes = NetShapes(file)
    placed = place(shapes, blueprint, graph)
    shapes.write(file)
    pieces = {key: tuple(row) for key, row in placed.pieces.items()}
    net = SumoNet(
        file=file,
        additional=mapping.write_additional(scene.road, folder),
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
    placed: Placement,
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
    for part in _parts(scene):
        digest.update(part)
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
    for shape in scene.road.polygons:
        yield f"{shape.kind} {shape.id}".encode()
        yield shape.points_m.tobytes()
    for sign in scene.road.stop_signs:
        yield f"{sign.lane_ids} {sign.position_m.tolist()}".encode()
    yield repr(sorted(scene.signals.lane_ids)).encode()
    row = scene.tracks.row(scene.av_id)
    yield str(scene.now).encode()
    for array in (scene.tracks.position_m, scene.tracks.heading_rad, scene.tracks.valid):
        yield np.ascontiguousarray(array[row]).tobytes()
    yield np.ascontiguousarray(scene.tracks.velocity_mps[row]).tobytes()
