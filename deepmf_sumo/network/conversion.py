"""Scene -> SUMO network.

::

    lanes --graph--> simplified, joined --layout--> edges, junctions --assembly--> blueprint
          --plain, netconvert--> net --shapes--> the scene's shapes put back --quality--> errors
"""

import shutil
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import ConversionReport, Floats, Scene, SumoNet
from deepmf_sumo.errors import ConversionError
from deepmf_sumo.network import drawing, mapping, plain, programs, quality
from deepmf_sumo.network.assembly import Assembly
from deepmf_sumo.network.blueprint import Blueprint, NodePlan
from deepmf_sumo.network.ghost import ghost_edge, leaves_lanes
from deepmf_sumo.network.graph import LaneGraph, lane_graph
from deepmf_sumo.network.layout import layout
from deepmf_sumo.network.shapes import NetShapes, Placement, place
from deepmf_sumo.network.traffic_control import control

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

    The folder, made or replaced as a whole, holds the net, the plain XML that it was made of,
    polygons to draw, a configuration, and the side file ``mapping.json``. The same scene gives the
    same bytes.

    Raises ConversionError where the scene has no lane that could be driven, SUMO refuses, or the
    folder holds something else.
    """
    began = time.perf_counter()
    _check_replaceable(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    beside = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        net = _build(scene, beside)
        beside.chmod(0o755)
        if folder.exists():
            shutil.rmtree(folder)
        beside.replace(folder)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
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
    nodes, edges, links = plain.write(blueprint, folder)
    file = folder / mapping.NET_FILE
    programs.run(
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
        additional=drawing.write_additional(scene.road, folder),
        pieces=pieces,
        lane_of=placed.lane_of,
        signals=placed.signals,
        ghost_edge=blueprint.ghost_edge,
        report=_report(
            scene,
            graph,
            placed,
            quality.distances(scene.road, pieces, placed.lane_of, shapes.shapes()),
            lost_signals,
        ),
    )
    drawing.write_config(folder)
    mapping.write(net, folder)
    return net


def _blueprint(scene: Scene, graph: LaneGraph) -> tuple[Blueprint, tuple[tuple[str, str], ...]]:
    """The net to build, and the signalled lanes without a link."""
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
