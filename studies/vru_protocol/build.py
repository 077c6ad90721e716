"""Roads, traffic and paths of the ten situations, written to a folder.

Three roads of ours: a street with sidewalks, the same with parked cars on the near side, and a
junction with crossings; lanes are 3.5 m wide, traffic drives on the right. In every case SUMO has
the AV at its speed, and the other at rest on a sidewalk or on its way, 6 s before they would meet.
The path of the other is fixed in time: it meets the AV, at the place on its front that the protocol
names, if the AV keeps its speed.
"""

import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import sumo
import sumolib  # comes with SUMO
import yaml

from deepmf_sumo.scene import DT_S, Floats, agent_ids
from deepmf_sumo.scene.geometry import frames, polylines
from studies.vru_protocol.cases import SITUATIONS, Situation

NETCONVERT: Final = Path(sumo.SUMO_HOME) / "bin" / "netconvert"
START_S: Final = 20.0
"""Of the attack: SUMO has had everybody on the road for some seconds."""
DEPART_S: Final = 10.0
MEETING_S: Final = 6.0
"""From the start to the contact with an AV that keeps its speed."""
DURATION_S: Final = 8.0
AV_SIZE_M: Final = (4.358, 1.815, 1.5)
CENTRE_M: Final = 1.75
"""Middles of lanes beside the middle of the road."""
MEETS_M: Final = 400.0
"""Where they meet on a street."""
CROSSES_M: Final = 12.5
"""From the middle of the junction to the way of a person across the road that the AV turns into.

9.5 m in the protocol; our junction is wider."""
OTHER: Final = "vru"
_SIDEWALK_M: Final = -5.0
_STEPS_OFF_S: Final = 4.0
"""SUMO's persons are on sidewalks: one that walks ahead in the lane first comes from there."""
_DRIVES: Final = "custom1"
"""SUMO's class of the parked cars: nobody else may use their strip."""


class Case(NamedTuple):
    """A situation at a speed of the AV, and at a place on its front."""

    situation: Situation
    av_kmh: int
    share: float

    @property
    def name(self) -> str:
        """Name, share of the width in per cent, speed in km/h."""
        return f"{self.situation.name}-{round(100 * self.share)}-{self.av_kmh}"

    @property
    def av_mps(self) -> float:
        """Speed of the AV."""
        return self.av_kmh / 3.6


def cases(names: tuple[str, ...] = ()) -> Iterator[Case]:
    """All cases of the named situations; of all without a name."""
    for one in SITUATIONS:
        if not names or one.name in names:
            for share in one.shares:
                for av_kmh in one.av_kmh:
                    yield Case(one, av_kmh, share)


class Meeting(NamedTuple):
    """Of a case: where the AV's front is when the other would be hit.

    Attributes:
        along_m: of the front on the AV's route, from its beginning.
        front_m: (2) the point of the front that the other touches. ahead: (2) the AV's direction.
    """

    along_m: float
    front_m: Floats
    ahead: Floats


def write(folder: Path, names: tuple[str, ...] = ()) -> list[dict[str, Any]]:
    """Write roads, traffic and paths; returns a spec of each case with a fixed path."""
    _roads(folder)
    return [_case(folder, one) for one in cases(names)]


def _case(folder: Path, case: Case) -> dict[str, Any]:
    meeting = _meeting(folder, case)
    poses = path(case, meeting)
    config = folder / f"{case.name}.sumocfg"
    (folder / f"{case.name}.rou.xml").write_text(_traffic(case, meeting, poses), encoding="utf-8")
    config.write_text(
        f'<configuration><input><net-file value="{case.situation.road}.net.xml"/>'
        f'<route-files value="{case.name}.rou.xml"/></input><time><begin value="0"/>'
        '<end value="60"/><step-length value="0.1"/></time><processing>'
        '<collision.action value="warn"/><collision.check-junctions value="true"/>'
        '<time-to-teleport value="-1"/></processing></configuration>\n',
        encoding="utf-8",
    )
    np.savez(
        folder / f"{case.name}.npz",
        step=np.arange(len(poses)) + 11,
        position_m=poses[:, :2],
        heading_rad=poses[:, 2],
        speed_mps=poses[:, 3],
    )
    return {
        "version": 3,
        "name": case.name,
        "source": {"network": str(config), "start_s": START_S, "av": {"vehicle": "av"}},
        "duration_s": DURATION_S,
        "traffic": "sumo",
        "av_sees": "in_sight",
        "profile": "any",
        "adversary": {
            "name": "trajectory", "agent": agent(case), "file": str(folder / f"{case.name}.npz")
        },
    }  # fmt: skip


def agent(case: Case) -> str:
    """Id of the road user that the AV meets."""
    return agent_ids.of_person(OTHER) if _walks(case) else OTHER


def _walks(case: Case) -> bool:
    return case.situation.who in {"adult", "child"}


def path(case: Case, meeting: Meeting) -> Floats:
    """(80, 4) x, y, heading and speed of the other in the steps after the start."""
    one = case.situation
    turn = {"ahead": 0.0, "oncoming": np.pi}.get(one.motion)
    if turn is None:  # across: to the left where it comes from the right
        turn = -np.pi / 2 if one.from_left else np.pi / 2
    if one.motion == "oncoming":  # straight on, against the direction in which the AV came
        heading = np.pi
    else:
        heading = float(np.arctan2(meeting.ahead[1], meeting.ahead[0])) + turn
    along = frames.unit(np.array(heading))
    seconds = DT_S * np.arange(1, round(DURATION_S / DT_S) + 1)
    covered, speed = _driven(one, seconds)
    position = meeting.front_m + (covered - _until(one))[:, None] * along
    if one.motion == "ahead" and _walks(case):  # off the sidewalk first
        part = np.clip(seconds / _STEPS_OFF_S, 0.0, 1.0)
        left = 1.0 - part**2 * (3.0 - 2.0 * part)
        position[:, 1] += left * (_SIDEWALK_M - meeting.front_m[1])
    return np.column_stack([position, np.full(len(seconds), frames.wrap(heading)), speed])


def _until(one: Situation) -> float:
    """Metres that the other covers from the start of the attack to the meeting."""
    if one.starts_m == 0.0 or one.motion == "ahead":
        return one.speed_mps * MEETING_S
    return one.away_m


def _driven(one: Situation, seconds: Floats) -> tuple[Floats, Floats]:
    """(K) metres that it has covered, and (K) its speed."""
    if one.starts_m == 0.0 or one.motion == "ahead":
        return one.speed_mps * seconds, np.full(len(seconds), one.speed_mps)
    gains_s = 2 * one.starts_m / one.speed_mps
    moves_s = gains_s + (one.away_m - one.starts_m) / one.speed_mps
    since = np.clip(seconds - (MEETING_S - moves_s), 0.0, None)
    rising = np.minimum(since, gains_s)
    speed = one.speed_mps * rising / gains_s
    return speed * rising / 2 + one.speed_mps * (since - rising), speed


def _meeting(folder: Path, case: Case) -> Meeting:
    """Where the other is hit, from the shapes of the AV's lanes."""
    one = case.situation
    net = sumolib.net.readNet(str(folder / f"{one.road}.net.xml"), withInternal=True)
    points = _route(net, one)
    lengths = polylines.arc_lengths(points)
    if one.road != "junction":
        along = MEETS_M
    elif one.motion == "across":
        crosses = -CENTRE_M if one.from_left else CENTRE_M
        along = float(np.interp(crosses, points[:, 0], lengths))
    else:
        at = CROSSES_M if one.motion == "turned_into" else CENTRE_M
        late = points[:, 0] > -40.0
        along = float(np.interp(at, points[late, 1], lengths[late]))
    front, heading = polylines.points_at(points, np.array([along]))
    ahead = frames.unit(heading)[0]
    # the share counts from the side that the other comes from; ahead of the AV from the near side
    side = 1.0 if one.from_left and one.motion != "ahead" else -1.0
    left = np.array([-ahead[1], ahead[0]])
    return Meeting(along, front[0] + side * (0.5 - case.share) * AV_SIZE_M[1] * left, ahead)


def _route(net: Any, one: Situation) -> Floats:
    """(P, 2) middle of the AV's lanes."""
    if one.road != "junction":
        return np.array(net.getEdge("on").getLanes()[-1].getShape())
    lane = net.getEdge("w_in").getLanes()[-1]
    goal = "e_out" if one.motion == "across" else "n_out"
    link = next(each for each in lane.getOutgoing() if each.getTo().getID() == goal)
    shape, via = list(lane.getShape()), link.getViaLaneID()
    while via:
        inner = net.getLane(via)
        shape += inner.getShape()
        via = next((each.getViaLaneID() for each in inner.getOutgoing()), "")
    found = np.array([*shape, *link.getToLane().getShape()])
    apart = np.hypot(*np.diff(found, axis=0).T) > 1e-3
    return found[np.concatenate([[True], apart])]


def _traffic(case: Case, meeting: Meeting, poses: Floats) -> str:
    """The AV, the other, and parked cars, as SUMO's routes."""
    one = case.situation
    length, width, height = AV_SIZE_M
    edges = "on" if one.road != "junction" else _AV_ROUTES[one.motion]
    begins = meeting.along_m - case.av_mps * (START_S + MEETING_S - DEPART_S)
    av = (
        f'<vType id="av" length="{length}" width="{width}" height="{height}" sigma="0"'
        f' tau="0.1" minGap="0" decel="9" speedFactor="1" maxSpeed="{case.av_mps:.4f}"/>'
        f'<vehicle id="av" type="av" depart="{DEPART_S}" departLane="best" departSpeed="max"'
        f' departPos="{begins:.3f}"><route edges="{edges}"/></vehicle>'
    )
    # SUMO ignores what is not sorted by departure
    others = [_person(case, poses), av] if _walks(case) else [av, _rider(case, poses)]
    lines = ["<routes>", *_PARKED * one.obstructed, *others, "</routes>\n"]
    return "\n".join(lines)


def _person(case: Case, poses: Floats) -> str:
    """On the sidewalk beside where its path begins; it hardly moves until the attack."""
    one, (x, _) = case.situation, poses[0, :2]
    if one.motion == "turned_into":
        edge, at = "n_in", _ARM_M - CROSSES_M - 1.5  # its sidewalk is where the person comes from
    elif one.from_left:
        edge, at = "back", 2 * MEETS_M - x
    else:
        edge, at = "on", x
    speed = one.speed_mps if one.motion == "ahead" else 0.02
    if one.motion == "ahead":
        at -= one.speed_mps * (START_S - 5.0)
    arrives = at + (60.0 if one.motion == "ahead" else 1.5)  # without a place it has arrived
    size = 'length="0.711" width="0.4" height="1.15"' if one.who == "child" else (
        'length="0.6" width="0.5" height="1.8"'
    )  # fmt: skip
    return (
        f'<vType id="{OTHER}" vClass="pedestrian" {size}/><person id="{OTHER}" type="{OTHER}"'
        f' depart="5" departPos="{at:.2f}"><walk edges="{edge}"'
        f' arrivalPos="{arrives:.2f}" speed="{speed:.4f}"/></person>'
    )


def _rider(case: Case, poses: Floats) -> str:
    """On its way at its speed, where it is when the attack begins."""
    one = case.situation
    cycles = one.who == "cyclist"
    kind = (
        'vClass="bicycle" length="1.89" width="0.5" height="1.86"' if cycles
        else 'vClass="motorcycle" length="2.08" width="0.75" height="1.6"'
    )  # fmt: skip
    edges, origin_m, along = _RIDERS[one.motion, one.from_left]
    front = origin_m + float(poses[0, :2] @ along) + (1.89 if cycles else 2.08) / 2
    begins = front - one.speed_mps * (START_S + DT_S - DEPART_S)
    return (
        f'<vType id="{OTHER}" {kind} sigma="0" speedFactor="1" maxSpeed="{one.speed_mps:.4f}"/>'
        f'<vehicle id="{OTHER}" type="{OTHER}" depart="{DEPART_S}" departLane="best"'
        f' departSpeed="max" departPos="{begins:.3f}"><route edges="{edges}"/></vehicle>'
    )


_AV_ROUTES: Final = {
    "across": "w_in e_out", "turned_into": "w_in n_out", "oncoming": "w_in n_out"
}  # fmt: skip
_ARM_M: Final = 400.0
_RIDERS: Final = {
    ("across", False): ("s_in n_out", _ARM_M, (0, 1)),
    ("across", True): ("n_in s_out", _ARM_M, (0, -1)),
    ("oncoming", True): ("e_in w_out", _ARM_M, (-1, 0)),
    ("ahead", False): ("on", 0.0, (1, 0)),
}
"""Routes; where the origin is on them, and their direction."""

_PARKED: Final = [
    f'<vType id="parked" vClass="{_DRIVES}" length="4.35" width="1.8" height="1.45"/>',
    *(
        f'<vehicle id="parked.{number}" type="parked" depart="0" departLane="1" departSpeed="0"'
        f' departPos="{front:.2f}"><route edges="on"/><stop lane="on_1" endPos="{front:.2f}"'
        f' duration="1000"/></vehicle>'
        for number, front in enumerate((MEETS_M - 1.25, MEETS_M - 1.25 - 4.35 - 1.0))
    ),
]
"""Two cars behind each other, 1 m apart; 1 m ahead of the first the child steps out."""


def _street(parked: bool) -> tuple[str, str]:
    strip = f'<lane index="1" width="2.12" allow="{_DRIVES}"/>' if parked else ""
    lanes, drives = (3, 2) if parked else (2, 1)

    def edge(name: str, ends: str, *, strip: str, lanes: int, drives: int) -> str:
        return (
            f'<edge id="{name}" {ends} numLanes="{lanes}" speed="27.8" spreadType="right">'
            f'<lane index="0" width="3.0" allow="pedestrian"/>{strip}'
            f'<lane index="{drives}" width="3.5" disallow="pedestrian tram rail {_DRIVES}"/></edge>'
        )

    nodes = '<node id="w" x="0" y="0"/><node id="e" x="800" y="0"/>'
    return nodes, (
        edge("on", 'from="w" to="e"', strip=strip, lanes=lanes, drives=drives)
        + edge("back", 'from="e" to="w"', strip="", lanes=2, drives=1)
    )


def _junction() -> tuple[str, str]:
    places = {"w": (-_ARM_M, 0), "e": (_ARM_M, 0), "s": (0, -_ARM_M), "n": (0, _ARM_M)}
    nodes = ['<node id="c" x="0" y="0" type="priority"/>']
    edges = []
    for name, (x, y) in places.items():
        nodes.append(f'<node id="{name}" x="{x}" y="{y}"/>')
        main = name in {"w", "e"}
        for way, ends in (("in", f'from="{name}" to="c"'), ("out", f'from="c" to="{name}"')):
            edges.append(
                f'<edge id="{name}_{way}" {ends} numLanes="2" speed="27.8" spreadType="right"'
                f' priority="{3 if main else 1}"><lane index="0" width="3.0" allow="pedestrian"/>'
                '<lane index="1" width="3.5" disallow="pedestrian tram rail"/></edge>'
            )
    return "".join(nodes), "".join(edges)


_ROADS: Final = {"street": _street(False), "parked": _street(True), "junction": _junction()}


def _roads(folder: Path) -> None:
    """Write the three networks."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, (nodes, edges) in _ROADS.items():
        (folder / f"{name}.nod.xml").write_text(f"<nodes>{nodes}</nodes>", encoding="utf-8")
        (folder / f"{name}.edg.xml").write_text(f"<edges>{edges}</edges>", encoding="utf-8")
        command = [
            str(NETCONVERT), "-n", f"{name}.nod.xml", "-e", f"{name}.edg.xml",
            "-o", f"{name}.net.xml", "--no-turnarounds", "true",
            "--offset.disable-normalization", "true", "--crossings.guess", "true",
            "--walkingareas", "true", "--default.junctions.radius", "8",
        ]  # fmt: skip
        subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)


def saved(spec: dict[str, Any], file: Path) -> Path:
    """The spec as a file."""
    file.write_text(yaml.safe_dump(spec, sort_keys=False), encoding="utf-8")
    return file
