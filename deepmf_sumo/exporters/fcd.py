"""A folder that SUMO opens: the net, vehicle types, FCD, and a .sumocfg that replays it.

SUMO's `fcd-replay` device puts every vehicle where the FCD has it, sideways too (sublane model).
Its limits: agents that stand off the lanes are drawn as polygons instead; agents that move off the
lanes (most pedestrians) are in the FCD but not in the replay; in the step in which it appears, a
vehicle is on the middle of its lane; a vehicle whose track ends drives on to its edge's end.
"""

import os
import shutil
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Final
from xml.sax.saxutils import quoteattr

import numpy as np
import shapely

from deepmf_sumo import files, plugins
from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.scene import AgentId, Bools, Floats, RoadMap, Rollout, Tracks, agent_ids
from deepmf_sumo.scene.geometry import boxes, frames
from deepmf_sumo.scene.road_users import RoadUserClass, class_of
from deepmf_sumo.scene.rollout import Role
from deepmf_sumo.sumo.network import mapping
from deepmf_sumo.sumo.network.sumo_net import (
    OTHER_VEHICLES,
    RAIL_VEHICLES,
    NetLane,
    read_once,
)

FILE: Final = "sumo/"
NET, TYPES, SHAPES = "net.net.xml", "types.add.xml", "shapes.add.xml"
MAP: Final = "map.add.xml"
"""Polygons of the road: crosswalks of recordings; buildings and water beside a network."""
FCD, REPLAY, CONFIG, VIEW = "fcd.xml", "replay.fcd.xml", "replay.sumocfg", "view.xml"
_COLOURS: Final[dict[Role, str]] = {
    "av": "200,30,30", "opponent": "240,140,0", "attacker": "240,140,0",
    "supporter": "250,220,90", "other": "120,130,150",
}  # fmt: skip
_SHAPES: Final[dict[RoadUserClass, str]] = {
    "car": "passenger", "truck": "truck", "motorcycle": "motorcycle", "bicycle": "bicycle",
    "pedestrian": "pedestrian", "other": "passenger",
}  # fmt: skip
_OFF_ROAD: Final = (*RAIL_VEHICLES, *OTHER_VEHICLES, "bicycle")
_SEEN_M = 50.0
"""Width of what sumo-gui shows; its zoom of 100 shows the whole net."""
_ON_LANE_M = 1.65
"""Half a lane: farther than this and half its width from a lane's centre, a box is beside it."""


class Settings(plugins.Settings):
    """None."""


def write(run: Exportable, path: Path, settings: Settings) -> None:
    """Write the folder ``path``, replacing one that was there.

    ``sumo-gui -c path/replay.sumocfg`` shows the rollout; its time 0 is the first step of history.

    Raises OutputError where the network cannot be read or the folder cannot be written.
    """
    with files.writing(path), files.whole_folder(path) as folder:
        _fill(folder, run)


def _fill(folder: Path, run: Exportable) -> None:
    rollout, net, road = run.rollout, run.net.net, run.around.road
    # a packed net stays packed, and SUMO tells by the name
    net_name = NET + ".gz" if net.suffix == ".gz" else NET
    shutil.copyfile(net, folder / net_name)
    tracks = rollout.tracks
    on_lane = _on_lane(tracks, [lane.centre_m for lane in road.lanes.values()] + _rails(net))
    replayed = _from_first(on_lane) & tracks.valid
    replayed[[kind == "pedestrian" for kind in tracks.kinds]] = False
    additional = [TYPES, SHAPES]
    if run.net.additional is not None:
        shutil.copyfile(run.net.additional, folder / MAP)
    elif shapes := mapping.beside(road):
        mapping.write_additional(shapes, folder / MAP)
    if (folder / MAP).is_file():
        additional.append(MAP)
    (folder / TYPES).write_text(_types(rollout, run.made), "utf-8")
    (folder / SHAPES).write_text(_shapes(rollout, replayed), "utf-8")
    (folder / FCD).write_text(_fcd(rollout, tracks.valid, run.made), "utf-8")
    begins = _begins(tracks, replayed, net)
    if (replayed == tracks.valid).all() and not begins:  # most of a run's disk space
        _same(folder / FCD, folder / REPLAY)
    else:
        (folder / REPLAY).write_text(_fcd(rollout, replayed, run.made, begins), "utf-8")
    (folder / VIEW).write_text(_view(rollout, road), "utf-8")
    end = tracks.steps * rollout.dt_s
    (folder / CONFIG).write_text(_config(net_name, additional, end, rollout.dt_s), "utf-8")


def _same(file: Path, other: Path) -> None:
    """A second name of a file; a copy where the file system has no links."""
    try:
        os.link(file, other)
    except OSError:
        shutil.copyfile(file, other)


def _rails(net: Path) -> list[Floats]:
    """(P, 2) each: centre lines of the lanes of trams, trains, ships and the like."""
    lanes = (lane for edge in read_once(net).edges.values() for lane in edge.lanes)
    return [one.shape_m[:, :2] for one in lanes if any(map(one.allows, _OFF_ROAD))]


def _on_lane(tracks: Tracks, lanes: Sequence[Floats]) -> Bools:
    """(A, T) whether an agent's front bumper is on a lane."""
    lines = [line for line in lanes if len(line) > 1]
    on_lane = np.zeros(tracks.valid.shape, bool)
    if not lines:
        return on_lane
    tree = shapely.STRtree([shapely.LineString(line) for line in lines])
    row, step = np.nonzero(tracks.valid)
    front, _ = frames.to_sumo(
        tracks.position_m[row, step], tracks.heading_rad[row, step], tracks.size_m[row, 0]
    )
    reach = _ON_LANE_M + tracks.size_m[row, 1] / 2
    found = tree.query(shapely.points(front), predicate="dwithin", distance=reach)[0]
    on_lane[row[found], step[found]] = True
    return on_lane


def _begins(tracks: Tracks, replayed: Bools, net: Path) -> dict[tuple[int, int], str]:
    """A lane and a place on it for the first step of agents that begin on no lane for cars.

    By agent and step. SUMO looks for lanes for cars alone, up to 100 m away, and leaves out what it
    cannot insert; from the second step on it finds all lanes. It inserts no vehicle inside a
    junction.
    """
    lanes, tree = _streets(net)
    found: dict[tuple[int, int], str] = {}
    if not lanes:
        return found
    for row in np.flatnonzero(replayed.any(axis=1)).tolist():
        step = int(replayed[row].argmax())
        pose = tracks.position_m[row, step], tracks.heading_rad[row, step]
        front = shapely.Point(*frames.to_sumo(*pose, tracks.size_m[row, 0])[0])
        nearest = int(tree.nearest(front))
        lane, line = lanes[nearest], tree.geometries[nearest]
        if not lane.allows("passenger"):
            share = float(shapely.line_locate_point(line, front, normalized=True))
            along = f"{share * lane.length_m:.4f}"
            found[row, step] = f' lane={quoteattr(lane.id)} pos="{along}"'
    return found


@files.while_unchanged(2)
def _streets(net: Path) -> tuple[list[NetLane], shapely.STRtree]:
    """The lanes outside junctions, but for people, and their lines."""
    lanes = [
        lane
        for edge in read_once(net).edges.values()
        for lane in (() if edge.function else edge.lanes)
        if len(lane.shape_m) > 1 and (lane.road or any(map(lane.allows, _OFF_ROAD)))
    ]
    return lanes, shapely.STRtree([shapely.LineString(lane.shape_m[:, :2]) for lane in lanes])


def _from_first(on_lane: Bools) -> Bools:
    """All steps since the first on a lane: SUMO inserts vehicles only there."""
    begun: Bools = np.logical_or.accumulate(on_lane, axis=1)
    return begun


def _types(rollout: Rollout, made: Collection[AgentId]) -> str:
    tracks, lines = rollout.tracks, []
    if made:
        lines.append("    <!-- made: types of people who are not in the demand -->")
    for row, agent in enumerate(tracks.ids):
        length, width, height = tracks.size_m[row]
        shape = _SHAPES[class_of(tracks.kinds[row], tracks.size_m[row])]
        # vClass "ignoring": recordings have vehicles on lanes of other classes, too
        name = _type_of(row, agent, made)
        lines.append(
            f'    <vType id="{name}" vClass="ignoring" guiShape="{shape}" '
            f'length="{length:.3f}" width="{width:.3f}" height="{max(height, 0.1):.3f}" '
            f'color="{_COLOURS[rollout.roles.get(agent, "other")]}" speedFactor="10" speedDev="0" '
            'maxSpeed="100" accel="1000" decel="1000" emergencyDecel="1000"/>'
        )
    return "<additional>\n" + "\n".join(lines) + "\n</additional>\n"


def _shapes(rollout: Rollout, replayed: Bools) -> str:
    """Polygons of agents that stand off the lanes."""
    tracks, lines = rollout.tracks, []
    for row in np.flatnonzero(~replayed.any(axis=1) & tracks.valid.any(axis=1)):
        steps = np.flatnonzero(tracks.valid[row])
        if float(np.ptp(tracks.position_m[row, steps], axis=0).max()) > 1.0:
            continue
        corner = boxes.corners(
            tracks.position_m[row, steps[0]],
            tracks.heading_rad[row, steps[0]],
            tracks.size_m[row, :2],
        )
        points = " ".join(f"{x:.3f},{y:.3f}" for x, y in corner)
        # a person's agent has a blank in its id, which SUMO refuses; no vehicle's has one
        name = quoteattr("box_" + tracks.ids[row].replace(" ", "__"))
        lines.append(
            f'    <poly id={name} type="{tracks.kinds[row]}" color="{_COLOURS["other"]}" '
            f'fill="1" layer="5" shape="{points}"/>'
        )
    return "<additional>\n" + "\n".join(lines) + "\n</additional>\n"


def _type_of(row: int, agent: AgentId, made: Collection[AgentId]) -> str:
    return f"type_{row}_made" if agent in made else f"type_{row}"


def _fcd(
    rollout: Rollout,
    present: Bools,
    made: Collection[AgentId],
    begins: Mapping[tuple[int, int], str] = MappingProxyType({}),
) -> str:
    tracks = rollout.tracks
    types = [_type_of(row, agent, made) for row, agent in enumerate(tracks.ids)]
    front, angle = frames.to_sumo(tracks.position_m, tracks.heading_rad, tracks.size_m[:, None, 0])
    begun = [f'        <{_element(agent)} x="' for agent in tracks.ids]
    # Lists: formatting numbers of numpy takes several times as long.
    values = np.concatenate(
        [front, angle[..., None], tracks.speed_mps[..., None], tracks.z_m[..., None]], axis=-1
    )
    raised = bool(tracks.z_m.any())  # SUMO writes heights only where there are any
    lines = ["<fcd-export>"]
    for step in range(tracks.steps):
        lines.append(f'    <timestep time="{step * rollout.dt_s:.2f}">')
        rows = np.flatnonzero(present[:, step])
        lines += [
            f'{begun[row]}{x:.4f}" y="{y:.4f}" angle="{turned:.4f}" type="{types[row]}" '
            f'speed="{speed:.4f}"{begins.get((row, step), "")}'
            + (f' z="{z:.2f}"/>' if raised else "/>")
            for row, (x, y, turned, speed, z) in zip(
                rows.tolist(), values[rows, step].tolist(), strict=True
            )
        ]
        lines.append("    </timestep>")
    lines.append("</fcd-export>\n")
    return "\n".join(lines)


def _element(agent: AgentId) -> str:
    """Name and id as SUMO writes them: a person may have the id of a vehicle."""
    person = agent_ids.person_of(agent)
    return f"vehicle id={quoteattr(agent)}" if person is None else f"person id={quoteattr(person)}"


def _view(rollout: Rollout, road: RoadMap) -> str:
    """Settings of sumo-gui: the view stands over the AV where the rollout ends."""
    tracks = rollout.tracks
    row = tracks.row(rollout.av_id)
    x, y = tracks.position_m[row, np.flatnonzero(tracks.valid[row])[-1]]
    lines = [lane.centre_m for lane in road.lanes.values()] or [tracks.position_m[row]]
    extent = float(np.ptp(np.vstack(lines), axis=0).max())
    return f"""<viewsettings>
    <scheme name="real world"/>
    <delay value="100"/>
    <viewport x="{x:.2f}" y="{y:.2f}" zoom="{max(100.0, 100.0 * extent / _SEEN_M):.0f}"/>
</viewsettings>
"""


def _config(net: str, additional: list[str], end_s: float, dt_s: float) -> str:
    return f"""<configuration>
    <input>
        <net-file value="{net}"/>
        <additional-files value="{",".join(additional)}"/>
    </input>
    <time>
        <begin value="0"/>
        <end value="{end_s:.1f}"/>
        <step-length value="{dt_s:g}"/>
    </time>
    <processing>
        <lateral-resolution value="0.4"/>
        <collision.action value="none"/>
        <time-to-teleport value="-1"/>
    </processing>
    <fcd_replay_device>
        <device.fcd-replay.files value="{REPLAY}"/>
    </fcd_replay_device>
    <gui_only>
        <gui-settings-file value="{VIEW}"/>
        <start value="false"/>
    </gui_only>
</configuration>
"""
