"""Compares what is shown of vehicles with SUMO's own poses, in the same simulation.

`python -m tests.support.shown_motion CONFIG...` prints a table: every vehicle is taken for an
AV that SUMO drives without attack. ``--at-once`` switches SUMO's own spreading of lane changes off.
"""

import argparse
import tempfile
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
import shapely

from deepmf_sumo.sumo.simulation.shown_motion import ShownMotion, read_pose
from deepmf_sumo.sumo.simulation.sumo_api import STEP_OPTIONS, running

AT_ONCE = ("--lanechange.duration", "0", "--lateral-resolution", "0")
_CHANGE_S = 0.05, 3.05
"""After SUMO's lane change, whose time is that of its step's begin, poses may differ."""
_JUMP_S = 1.55
_JUMP_M = 0.3
"""After a larger step of SUMO to the side without a lane change poses may differ."""
_WIDE_JUMP_M = 0.8
"""After a larger step of SUMO's centre to the side a shown vehicle comes from the lane beside: it
stays on the road."""
_TURN_RAD = 0.6
"""A vehicle whose heading changes by more within 5 s makes a turn."""
_TELEPORT_M = 8.0
_NOWHERE_M = -1e6


@dataclass
class Vehicle:
    """One vehicle by step: (time, SUMO's centre x and y, heading, shown x and y), and its lanes.

    ``rear_m``: where its rear is along its lane, negative on the lane before.
    """

    rows: list[tuple[float, ...]] = field(default_factory=list)
    lanes: list[str] = field(default_factory=list)
    rear_m: list[float] = field(default_factory=list)

    def on_edge(self, steps: np.ndarray) -> list[bool]:
        """Whether all of the vehicle is on its edge, at the steps of a mask."""
        return [bool(self.rear_m[step] >= 0) for step in np.flatnonzero(steps)]


@dataclass
class Recorded:
    """A run of plain traffic.

    ``changes``: times and lanes of SUMO's own ``--lanechange-output``. ``lines`` and ``areas``:
    centre lines and outlines of the lanes that vehicles were on. ``onto``: where a lane leads.
    """

    vehicles: dict[str, Vehicle]
    changes: dict[str, list[tuple[float, str]]]
    lines: dict[str, shapely.LineString]
    areas: dict[str, shapely.Geometry]
    onto: dict[str, list[str]]


@dataclass
class Row:
    """How far shown poses are from SUMO's, of all vehicles; lengths in metres.

    Attributes:
        vehicles, turns, changes: how many there were.
        spread: changes in which SUMO's vehicle jumped and the shown one did not.
        jumps: SUMO's steps to the side of more than 0.3 m outside lane changes: where an edge
            begins beside the one before.
        apart_m: largest distance outside lane changes and the 1.5 s after jumps.
        between_m: how much farther outside the two lanes' centre lines a shown centre is in a
            spread change than SUMO's: in bends SUMO's is too.
        back_m: largest step of a shown centre away from the new lane during a change, with its rear
            on their edge: before, it swings in from the edge before, as it does without a change.
        beyond_m: how much farther beyond the lanes it used a shown centre is than SUMO's; in the
            1.5 s after a jump of more than 0.8 m to the side, beyond the road.
        beyond_sumo_m: how far SUMO's own centre is beyond them.
        sideways_m, sideways_sumo_m: largest step sideways outside lane changes.
        more_sideways_m: how much larger a vehicle's largest step sideways is than SUMO's of it.
    """

    vehicles: int = 0
    turns: int = 0
    changes: int = 0
    spread: int = 0
    jumps: int = 0
    apart_m: float = 0.0
    between_m: float = 0.0
    back_m: float = 0.0
    beyond_m: float = 0.0
    beyond_sumo_m: float = 0.0
    sideways_m: float = 0.0
    sideways_sumo_m: float = 0.0
    more_sideways_m: float = 0.0

    def note(self, **values: float) -> None:
        """Keep the larger of each."""
        for name, value in values.items():
            setattr(self, name, max(getattr(self, name), float(value)))


def compare(config: Path, until_s: float, options: tuple[str, ...] = (), most: int = 400) -> Row:
    """Run a configuration without attack and compare both poses of its first vehicles."""
    recorded = _record(config, until_s, options, most)
    row = Row()
    for name, vehicle in recorded.vehicles.items():
        if len(vehicle.rows) > 1:
            _judge(row, vehicle, recorded, recorded.changes.get(name, []))
    return row


def _record(config: Path, until_s: float, options: tuple[str, ...], most: int) -> Recorded:
    recorded = Recorded(defaultdict(Vehicle), defaultdict(list), {}, {}, {})
    motions: dict[str, ShownMotion] = {}
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "changes.xml"
        arguments = ["-c", str(config), "--lanechange-output", str(log), *STEP_OPTIONS, *options]
        with running(arguments) as api:
            end = api.simulation.getTime() + until_s
            while api.simulation.getTime() < end and api.simulation.getMinExpectedNumber() > 0:
                api.simulationStep()
                for name in api.vehicle.getIDList():
                    if name in motions or len(motions) < most:
                        _note(api, name, motions, recorded)
        for change in ET.parse(log).getroot():
            time_s, lane = float(change.get("time")), change.get("from")
            recorded.changes[change.get("id")].append((time_s, lane))
    return recorded


def _note(api, name: str, motions: dict[str, ShownMotion], recorded: Recorded) -> None:
    length = api.vehicle.getLength(name)
    motion = motions.setdefault(name, ShownMotion(api, name, length))
    x, y = api.vehicle.getPosition(name)
    if x < _NOWHERE_M:
        return
    heading = np.radians(90.0 - api.vehicle.getAngle(name))
    centre = x - length / 2 * np.cos(heading), y - length / 2 * np.sin(heading)
    shown = motion.advance(read_pose(api, name, length))
    lane = api.vehicle.getLaneID(name)
    row = (api.simulation.getTime(), *centre, heading, shown.x_m, shown.y_m)
    recorded.vehicles[name].rear_m.append(api.vehicle.getLanePosition(name) - length)
    recorded.vehicles[name].rows.append(row)
    recorded.vehicles[name].lanes.append(lane)
    if lane and lane not in recorded.lines:
        edge = lane.rpartition("_")[0]
        # with the lanes beside it: a vehicle may leave one in the step in which it enters the edge
        for one in [f"{edge}_{index}" for index in range(api.edge.getLaneNumber(edge))]:
            line = recorded.lines[one] = shapely.LineString(api.lane.getShape(one))
            half_m = api.lane.getWidth(one) / 2
            recorded.areas[one] = line.buffer(half_m, cap_style="flat", join_style="mitre")
            recorded.onto[one] = [link[0] for link in api.lane.getLinks(one)]


def _judge(
    row: Row, vehicle: Vehicle, recorded: Recorded, changes: list[tuple[float, str]]
) -> None:
    table = np.array(vehicle.rows)
    time, own, heading, shown = table[:, 0], table[:, 1:3], table[:, 3], table[:, 4:6]
    row.vehicles += 1
    row.turns += _turns(np.unwrap(heading))
    ours, sumos = _sideways(shown, heading), _sideways(own, heading)
    changing = np.zeros(len(time), bool)
    for moment, origin in changes:
        row.changes += 1
        during = (time > moment + _CHANGE_S[0]) & (time < moment + _CHANGE_S[1])
        # where the edge ends before, what is left of it is a jump
        changing |= (time > moment + _CHANGE_S[0]) & (time < moment + _CHANGE_S[1] + _JUMP_S)
        step = int(np.argmax(during)) - 1
        jumped = step >= 0 and sumos[step] > 1.0
        spread = bool(jumped and ours[step] < 1.0)
        row.spread += spread
        if spread and origin in recorded.lines and len(changes) == 1:
            there = [vehicle.lanes[one] for one in np.flatnonzero(during)]
            points = zip(shown[during], own[during], vehicle.on_edge(during), strict=True)
            ways = np.array(list(_ways(recorded, origin, there, points))).reshape(-1, 2)
            steps = np.diff(ways[:, 1])
            row.note(between_m=ways[:, 0].max(initial=0), back_m=np.nanmax(steps, initial=0))
    apart = np.hypot(*(shown - own).T)
    left = {lane for _, lane in changes}
    for step in np.flatnonzero((sumos > _JUMP_M) & ~changing[1:]) + 1:
        row.jumps += 1
        jumping = (time >= time[step]) & (time < time[step] + _JUMP_S)
        changing |= jumping
        if sumos[step - 1] > _WIDE_JUMP_M:
            left |= {one for at in np.flatnonzero(jumping) for one in _road(recorded, vehicle, at)}
    # a change inside a short junction ends behind it, beside the lane that the one before led to
    left |= {onto for lane in left for onto in recorded.onto.get(lane, ()) if lane[0] == ":"}
    lanes = {*vehicle.lanes, *(lane for lane in left if lane in recorded.areas)} - {""}
    used = shapely.union_all([recorded.areas[lane] for lane in lanes])
    beyond, beyond_sumo = (shapely.distance(used, shapely.points(each)) for each in (shown, own))
    row.note(
        apart_m=apart[~changing].max(initial=0),
        beyond_m=(beyond - beyond_sumo).max(),
        beyond_sumo_m=beyond_sumo.max(),
        sideways_m=ours[~changing[1:]].max(initial=0),
        sideways_sumo_m=sumos[~changing[1:]].max(initial=0),
        more_sideways_m=ours.max() - sumos.max(),
    )


def _road(recorded: Recorded, vehicle: Vehicle, step: int) -> set[str]:
    """All lanes of the edge that a vehicle is on: a jump over half a lane goes by those beside."""
    edge = vehicle.lanes[step].rpartition("_")[0]
    return {one for one in recorded.areas if one.rpartition("_")[0] == edge}


def _ways(
    recorded: Recorded,
    origin: str,
    lanes: list[str],
    points: Iterable[tuple[np.ndarray, np.ndarray, bool]],
) -> Iterator[tuple[float, float]]:
    """How much farther outside both lanes a shown centre is than SUMO's; its way to the new lane.

    ``points``: shown centre, SUMO's centre, whether all of the vehicle is on the edge: else the way
    is NaN.
    """
    for lane, (*centres, on_edge) in zip(lanes, points, strict=True):
        if lane == origin or lane.rpartition("_")[0] != origin.rpartition("_")[0]:
            continue
        old, new = recorded.lines[origin], recorded.lines[lane]
        shown, sumos = shapely.points(np.array(centres))
        if min(old.project(shown), new.project(shown)) > 0:  # else it is before the edge
            width = old.distance(new.interpolate(new.project(shown)))
            outside, sumos_outside = (
                max(old.distance(one) + new.distance(one) - width, 0.0) for one in (shown, sumos)
            )
            yield outside - sumos_outside, new.distance(shown) if on_edge else np.nan


def _turns(heading: np.ndarray) -> int:
    count, step = 0, 0
    while step < len(heading):
        turned = np.flatnonzero(abs(heading[step : step + 50] - heading[step]) > _TURN_RAD)
        count += len(turned) > 0
        step += int(turned[0]) + 30 if len(turned) else 10
    return count


def _sideways(centre: np.ndarray, heading: np.ndarray) -> np.ndarray:
    step, turn = np.diff(centre, axis=0), np.diff(np.unwrap(heading))
    mean = heading[1:] - turn / 2
    across = abs(step[:, 1] * np.cos(mean) - step[:, 0] * np.sin(mean))
    return np.where(np.hypot(*step.T) > _TELEPORT_M, 0.0, across)


def main() -> None:
    """Print a row for each configuration."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("configs", nargs="+", type=Path)
    parser.add_argument("--until", type=float, default=300.0, help="seconds of simulation")
    parser.add_argument("--most", type=int, default=400, help="vehicles")
    parser.add_argument("--at-once", action="store_true")
    arguments = parser.parse_args()
    names = [one.name for one in fields(Row)]
    print("network", *names)
    for config in arguments.configs:
        options = AT_ONCE if arguments.at_once else ()
        row = compare(config, arguments.until, options, arguments.most)
        print(config.stem, *(f"{getattr(row, name):.3g}" for name in names), flush=True)


if __name__ == "__main__":
    main()
