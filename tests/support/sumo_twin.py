"""What a running SUMO says of a network, beside what we read from its file: the differences."""

import gzip
import re
from pathlib import Path

import libsumo
import numpy as np

from deepmf_sumo.sumo.network.sumo_road import road_of_net, signal_links
from deepmf_sumo.sumo.simulation.observation import LiveSignals

CLASSES = ("private", "emergency", "authority", "army", "vip", "passenger", "hov", "taxi", "bus",
           "coach", "delivery", "truck", "trailer", "motorcycle", "moped", "evehicle")  # fmt: skip
"""Of SUMO's classes those of vehicles on roads."""
LETTERS = {
    **dict.fromkeys("ru", "STOP"),
    **dict.fromkeys("yY", "CAUTION"),
    **dict.fromkeys("gG", "GO"),
    "s": "FLASHING_STOP",
    "o": "FLASHING_CAUTION",
    "O": "UNKNOWN",
}


def differences(net: Path, seconds: int = 130) -> list[str]:
    """Of lanes, and of lights at each second."""
    command = ["sumo", "-n", str(net), "--no-step-log", "--no-warnings", "--begin", "0"]
    libsumo.start([*command, "--xml-validation", "never", "--xml-validation.net", "never"])
    try:
        found = [*_lanes(net), *_neighbours(net), *_lights(net, seconds)]
    finally:
        libsumo.close()
    return found


def _allowed(lane: str) -> str:
    """The kind that a lane is of for us; empty for lanes of neither vehicles nor bicycles."""
    allowed, forbidden = libsumo.lane.getAllowed(lane), libsumo.lane.getDisallowed(lane)

    def may(one):
        return one not in forbidden and (not allowed or one in allowed)

    if any(may(one) for one in CLASSES):
        return "road"
    return "bike" if may("bicycle") else ""


def _lanes(net):
    road = road_of_net(net).lanes
    functions = dict(_functions(net))
    expected = {}
    for lane in libsumo.lane.getIDList():
        edge = libsumo.lane.getEdgeID(lane)
        if functions.get(edge, "") in ("", "internal") and _allowed(lane):
            expected[lane] = _allowed(lane)
    drawn = {one for one in road if ">" in one}
    yield from (f"lane {one} is not read" for one in expected if one not in road)
    yield from (f"lane {one} is not SUMO's" for one in set(road) - drawn if one not in expected)
    for one in expected:
        if one in road:
            yield from _lane(road, one, expected)


def _lane(road, name, expected):
    lane, sumo = road[name], libsumo.lane
    shape = np.array(sumo.getShape(name))[:, :2]
    if lane.centre_m.shape != shape.shape or np.abs(lane.centre_m - shape).max() > 0.011:
        yield f"lane {name}: shape"
    if abs(lane.width_m - sumo.getWidth(name)) > 0.011:
        yield f"lane {name}: width {lane.width_m}, SUMO {sumo.getWidth(name)}"
    if abs(lane.speed_limit_mps - sumo.getMaxSpeed(name)) > 0.011:
        yield f"lane {name}: limit {lane.speed_limit_mps}, SUMO {sumo.getMaxSpeed(name)}"
    if (lane.kind == "bike") != (expected[name] == "bike"):
        yield f"lane {name}: {lane.kind}, SUMO {expected[name]}"
    if lane.interpolating != name.startswith(":"):
        yield f"lane {name}: inside a junction or not"
    onward = {str(link[4] or link[0]) for link in sumo.getLinks(name)} & set(expected)
    ours = {road[one].next[0] if ">" in one else one for one in lane.next}
    if ours != onward:
        yield f"lane {name}: leads to {sorted(ours)}, SUMO {sorted(onward)}"
    behind = {one for one in lane.next for _ in [0] if name not in road[one].previous}
    if behind:
        yield f"lane {name}: is not before {sorted(behind)}"


def _neighbours(net):
    road = road_of_net(net).lanes
    first = _text(net)[:20000]
    left_hand = bool(re.search(r'<net\b[^>]*lefthand="(true|1)"', first))
    for name, lane in road.items():
        if ">" in name:
            continue
        edge, _, number = name.rpartition("_")
        for side, step in (("left", 1), ("right", -1)):
            other = f"{edge}_{int(number) + (-step if left_hand else step)}"
            expected = [other] if other in road else []
            ours = [one.lane_id for one in getattr(lane, side)]
            if ours != expected:
                yield f"lane {name}: {side} of it {ours}, SUMO {expected}"


def _lights(net, seconds):
    functions = dict(_functions(net))
    links = signal_links(net)
    read = LiveSignals(libsumo, links)
    controlled = {}
    for light in libsumo.trafficlight.getIDList():
        for index, row in enumerate(libsumo.trafficlight.getControlledLinks(light)):
            for start, end, via in row:
                edges = {functions.get(one.rpartition("_")[0], "") for one in (start, end)}
                if not edges & {"crossing", "walkingarea"}:
                    straight = end if start.startswith(":") else f":{start}>{end}"
                    controlled.setdefault(via or straight, []).append((light, index))
    for lane, of in controlled.items():
        if len(of) > 1:
            yield f"light: {lane} has {of}"
    said = set()
    for _ in range(seconds):
        ours = {lane: state.name for lane, state in read.states().items()}
        sumo = {
            lane: LETTERS[libsumo.trafficlight.getRedYellowGreenState(light)[index]]
            for lane, [(light, index), *_] in controlled.items()
        }
        for lane in ours.keys() | sumo.keys():
            if ours.get(lane) != sumo.get(lane) and lane not in said:
                said.add(lane)
                yield f"light of {lane}: {ours.get(lane)}, SUMO {sumo.get(lane)}"
        libsumo.simulationStep()


def _functions(net):
    for tag in re.findall(r"<edge\b[^>]*>", _text(net)):
        name, function = (re.search(rf'\b{key}="([^"]*)"', tag) for key in ("id", "function"))
        if function:
            yield name[1], function[1]


def _text(net):
    content = net.read_bytes()
    return (gzip.decompress(content) if net.suffix == ".gz" else content).decode()
