"""Small readers of the formats that runs are exported in, written from their descriptions.

Each gives boxes by step and id, so that poses and contacts can be compared with those of the run.
"""

import csv
import itertools
import json
import struct
import subprocess
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np
import shapely

DT_S = 0.1


@dataclass(frozen=True)
class Box:
    """x, y of the centre and heading, of a box of this length and width."""

    x: float
    y: float
    heading: float
    length: float
    width: float

    @property
    def corners(self):
        """(4, 2) front left, rear left, rear right, front right."""
        ahead = np.array([np.cos(self.heading), np.sin(self.heading)]) * self.length / 2
        left = np.array([-np.sin(self.heading), np.cos(self.heading)]) * self.width / 2
        centre = np.array([self.x, self.y])
        return centre + np.array([ahead + left, left - ahead, -ahead - left, ahead - left])


def boxes_of(tracks):
    """(step, id) -> box of tracks."""
    return {
        (int(step), tracks.ids[row]): Box(
            *map(float, tracks.position_m[row, step]),
            float(tracks.heading_rad[row, step]),
            *map(float, tracks.size_m[row, :2]),
        )
        for row, step in np.argwhere(tracks.valid)
    }


def largest_error_m(found, expected):
    """Largest distance of corners; infinite where a box is missing or there is one more.

    Of what esmini has played see `Played.largest_error_m`.
    """
    if isinstance(found, Played):
        return found.largest_error_m(expected)
    if found.keys() != expected.keys():
        return float("inf")
    differences = [found[key].corners - expected[key].corners for key in expected]
    return float(np.hypot(*np.concatenate(differences).T).max())


def first_contact(found, one, other):
    """The first step at which the boxes of the two overlap; None without one."""
    steps = sorted(step for step, agent in found if agent == one and (step, other) in found)
    shapes = (
        [shapely.Polygon(found[step, agent].corners) for agent in (one, other)] for step in steps
    )
    return next(
        (step for step, (a, b) in zip(steps, shapes, strict=False) if a.intersects(b)), None
    )


@dataclass(frozen=True)
class TrjVehicle:
    """A VEHICLE record."""

    number: int
    link: int
    lane: int
    front: tuple
    rear: tuple
    length: float
    width: float
    speed: float
    acceleration: float
    z: tuple | None


def read_trj(content):
    """``(header, steps)`` of a SSAM trajectory file, 1.04 or 3.0: tables 1.2 to 1.5 and 2-1, 2-2.

    ``steps`` are pairs of the time and its VEHICLE records.
    """
    kind, endian = struct.unpack_from("BB", content)
    assert kind == 0
    order = {ord("L"): "<", ord("B"): ">"}[endian]
    (version,) = struct.unpack_from(f"{order}f", content, 2)
    at, high = 6, False
    if version > 1.05:
        high, at = content[6] not in (0, ord(" ")), 7
    kind, units, scale, *area = struct.unpack_from(f"{order}BBf4i", content, at)
    assert kind == 1
    at += struct.calcsize(f"{order}BBf4i")
    record = struct.Struct(f"{order}iiB{10 if high else 8}f")
    steps = []
    while at < len(content):
        kind, at = content[at], at + 1
        if kind == 2:
            steps.append((struct.unpack_from(f"{order}f", content, at)[0], []))
            at += 4
        elif kind == 3:
            number, link, lane, fx, fy, rx, ry, *rest = record.unpack_from(content, at)
            z = tuple(rest[4:]) if high else None
            vehicle = TrjVehicle(number, link, lane, (fx, fy), (rx, ry), *rest[:4], z)
            steps[-1][1].append(vehicle)
            at += record.size
        else:
            raise AssertionError(f"record type {kind} at byte {at - 1}")
    header = {"version": round(version, 2), "units": units, "scale": scale, "area": area}
    return header, steps


def ssam_boxes(folder):
    """(step, id) -> box of what happened, of an exported folder."""
    with (folder / "vehicles.csv").open(newline="") as file:
        ids = {int(row["number"]): row["id"] for row in csv.DictReader(file)}
    about = json.loads((folder / "about.json").read_text())
    _, steps = read_trj((folder / "run.trj").read_bytes())
    if about["made_up_steps"]:
        steps = steps[: -about["made_up_steps"]]
    found = {}
    for time, vehicles in steps:
        for one in vehicles:
            front, rear = np.array(one.front), np.array(one.rear)
            x, y = (front + rear) / 2 + about["origin_m"]
            heading = float(np.arctan2(*(front - rear)[::-1]))
            key = round(time / DT_S), ids[one.number]
            found[key] = Box(float(x), float(y), heading, one.length, one.width)
    return found


def xosc_boxes(file):
    """(step, entity) -> box of an OpenSCENARIO whose entities follow trajectories by time.

    An entity is there from its teleport of Init or its AddEntityAction on, until it is deleted or
    the scenario stops, which it does once the last step has been shown.
    """
    root = ET.parse(file).getroot()
    [stop] = root.findall("Storyboard/StopTrigger//SimulationTimeCondition")
    last = round(float(stop.get("value")) / DT_S)
    shapes = {one.get("name"): _xosc_shape(one) for one in root.iter("ScenarioObject")}
    poses = {}
    for private in root.findall("Storyboard/Init/Actions/Private"):
        place = _world(private.find("PrivateAction/TeleportAction/Position"))
        poses |= {(step, private.get("entityRef")): place for step in range(last + 1)}
    events = [(_xosc_step(event), group, event)
              for group in root.iter("ManeuverGroup") for event in group.iter("Event")]  # fmt: skip
    for step, group, event in sorted(events, key=lambda one: one[0]):
        for action in event.iter("EntityAction"):
            name = action.get("entityRef")
            added = action.find("AddEntityAction/Position")
            for later in range(step, last + 1):
                if added is None:
                    poses.pop((later, name), None)
                else:
                    poses[later, name] = _world(added)
        [name] = {one.get("entityRef") for one in group.findall("Actors/EntityRef")}
        for vertex in event.iter("Vertex"):
            poses[round(float(vertex.get("time")) / DT_S), name] = _world(vertex.find("Position"))
    return {(step, name): _xosc_box(pose, *shapes[name]) for (step, name), pose in poses.items()}


_SLOW_MPS = 2.0
_ESMINI = 31
"""Columns of an entity in esmini's log."""


@dataclass
class Played:
    """What esmini has shown.

    Attributes:
        reference_m: (step, entity) -> place of the reference point, x, y.
        ahead_m: entity -> centre of its box ahead of that point.
        touching: (step, entity) -> entities that esmini found in contact with it.
    """

    reference_m: dict
    ahead_m: dict
    touching: dict

    def first_contact(self, one, other):
        """The first step at which it found the two in contact; None without one."""
        steps = [step for (step, name), found in self.touching.items()
                 if name == one and other in found]  # fmt: skip
        return min(steps, default=None)

    def largest_error_m(self, expected):
        """Of the reference points above 2 m/s; infinite where an entity is missing or one too many.

        esmini turns boxes gradually between two vertices of a trajectory, and brakes slow vehicles
        to a stop by a model of its own. It adds and deletes entities in the step in which the
        action begins, and shows this in the next one.
        """
        came = {key for key in expected if key[0] and (key[0] - 1, key[1]) not in expected}
        went = {(step + 1, name) for step, name in expected} - expected.keys()
        shown = self.reference_m.keys()
        if not (expected.keys() - came <= shown and shown - went <= expected.keys()):
            return float("inf")
        return max(
            np.hypot(
                expected[key].x - self.ahead_m[key[1]] * np.cos(expected[key].heading) - x,
                expected[key].y - self.ahead_m[key[1]] * np.sin(expected[key].heading) - y,
            )
            for key, (x, y) in self.reference_m.items()
            if _speed_mps(expected, *key) > _SLOW_MPS
        )


def _speed_mps(boxes, step, name):
    """Least speed to and from the step; 0 where it is alone."""
    near = [boxes.get((one, name)) for one in (step - 1, step, step + 1)]
    if any(box is None for box in near):
        return 0.0
    return min(np.hypot(b.x - a.x, b.y - a.y) / DT_S for a, b in itertools.pairwise(near))


def played(program, folder):
    """What esmini plays of a folder of `export --to openscenario`."""
    options = ["--headless", "--fixed_timestep", str(DT_S), "--collision", "--disable_stdout"]
    files = ["--osc", "scenario.xosc", "--csv_logger", "esmini.csv"]
    subprocess.run([program, *options, *files], cwd=folder, check=True, capture_output=True,
                   timeout=300)  # fmt: skip
    offset = ET.parse(folder / "road.xodr").find("header/offset")
    moved = (0.0, 0.0) if offset is None else (float(offset.get("x")), float(offset.get("y")))
    return esmini_log((folder / "esmini.csv").read_text(encoding="utf-8"), moved)


def esmini_log(text, moved=(0.0, 0.0)):
    """esmini's CSV log with its collisions; the offset of the road's header is added to places."""
    reference, ahead, touching = {}, {}, {}
    for row in csv.reader(text.splitlines()):
        if not row[0].isdecimal():
            continue
        step, cells = round(float(row[1]) / DT_S), [cell.strip() for cell in row[2:]]
        groups = [cells[at : at + _ESMINI] for at in range(0, len(cells) - 1, _ESMINI)]
        names = {group[1]: group[0] for group in groups}
        for name, *group in groups:
            ahead[name] = float(group[4])
            reference[step, name] = float(group[10]) - moved[0], float(group[11]) - moved[1]
            touching[step, name] = {names[one] for one in group[29].split()}
    return Played(reference, ahead, touching)


def _xosc_step(event):
    [condition] = event.findall("StartTrigger//SimulationTimeCondition")
    return round(float(condition.get("value")) / DT_S)


def _xosc_shape(entity):
    box = next(entity.iter("BoundingBox"))
    centre, size = box.find("Center"), box.find("Dimensions")
    return float(centre.get("x")), float(size.get("length")), float(size.get("width"))


def _world(position):
    place = position.find("WorldPosition")
    return tuple(float(place.get(name)) for name in "xyh")


def _xosc_box(pose, ahead, length, width):
    x, y, heading = pose
    return Box(x + ahead * np.cos(heading), y + ahead * np.sin(heading), heading, length, width)


def fcd_boxes(folder):
    """(step, id) -> box of SUMO's FCD and vehicle types, in a folder for sumo-gui."""
    sizes = {
        one.get("id"): (float(one.get("length")), float(one.get("width")))
        for one in ET.parse(folder / "types.add.xml").iter("vType")
    }
    found = {}
    for moment in ET.parse(folder / "fcd.xml").iter("timestep"):
        for one in moment.iter("vehicle"):
            length, width = sizes[one.get("type")]
            heading = float(np.radians(90.0 - float(one.get("angle"))))
            x = float(one.get("x")) - length / 2 * np.cos(heading)
            y = float(one.get("y")) - length / 2 * np.sin(heading)
            box = Box(x, y, heading, length, width)
            found[round(float(moment.get("time")) / DT_S), one.get("id")] = box
    return found


def check_scenario(found):
    """The rules of MetaDrive's ``ScenarioDescription.sanity_check`` with ``valid_check``."""
    assert type(found) is dict
    assert {"tracks", "version", "id", "dynamic_map_states", "map_features", "length",
            "metadata"} <= found.keys()  # fmt: skip
    _plain(found)
    steps = found["length"]
    for track in found["tracks"].values():
        assert track["type"] in {"VEHICLE", "PEDESTRIAN", "CYCLIST", "OTHER"}
        assert {"position", "heading", "valid"} <= track["state"].keys()
        valid = track["state"]["valid"]
        assert valid.any()
        for array in track["state"].values():
            assert len(array) == steps
            assert array.ndim == 1 or array.shape[1] > 0
            assert not array[~valid].any()
    for light in found["dynamic_map_states"].values():
        assert light["type"] == "TRAFFIC_LIGHT"
        assert {"state", "metadata"} <= light.keys()
        assert all(len(array) == steps for array in light["state"].values())
    for feature in found["map_features"].values():
        if feature["type"].startswith("LANE_"):
            assert isinstance(feature["polyline"], np.ndarray)
    assert {"metadrive_processed", "coordinate", "ts"} <= found["metadata"].keys()
    assert found["metadata"]["ts"].shape == (steps,)


def _plain(value):
    assert type(value) in {bool, int, float, str, np.ndarray, dict, list, tuple, type(None), set}
    if isinstance(value, np.ndarray):
        assert value.dtype.kind in "bif"
    elif isinstance(value, dict | list | tuple | set):
        for one in value.items() if isinstance(value, dict) else value:
            _plain(one)


def scenario_boxes(found):
    """(step, id) -> box of a ScenarioNet scenario."""
    return {
        (int(step), agent): Box(
            *map(float, state["position"][step][:2]),
            *(float(state[name][step]) for name in ("heading", "length", "width")),
        )
        for agent, state in ((key, one["state"]) for key, one in found["tracks"].items())
        for step in np.flatnonzero(state["valid"])
    }


def commonroad_boxes(file):
    """(step after now, comment before the obstacle) -> box of a CommonRoad scenario."""
    found, name = {}, None
    parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))
    for one in ET.parse(file, parser).getroot():
        if one.tag is ET.Comment:
            name = one.text.strip()
        elif one.tag == "dynamicObstacle":
            size = [float(one.findtext(f"shape/rectangle/{key}")) for key in ("length", "width")]
            for state in (one.find("initialState"), *one.iterfind("trajectory/state")):
                place = [float(state.findtext(f"position/point/{key}")) for key in "xy"]
                heading = float(state.findtext("orientation/exact"))
                found[int(state.findtext("time/exact")), name] = Box(*place, heading, *size)
    return found


def xosc_ids(file):
    """Name of an entity -> its property ``id``."""
    return {
        one.get("name"): next(p.get("value") for p in one.iter("Property") if p.get("name") == "id")
        for one in ET.parse(file).iter("ScenarioObject")
    }


def crc32c(content):
    """Castagnoli's checksum (RFC 3720, appendix B.4), bit-reflected polynomial 0x82F63B78."""
    crc = 0xFFFFFFFF
    for byte in content:
        crc = (crc >> 8) ^ _CRC[(crc ^ byte) & 0xFF]
    return crc ^ 0xFFFFFFFF


def _crc_of_byte(byte):
    for _ in range(8):
        byte = (byte >> 1) ^ (0x82F63B78 if byte & 1 else 0)
    return byte


_CRC = [_crc_of_byte(byte) for byte in range(256)]


def tfrecords(content):
    """Payloads of a TFRecord file, whose masked checksums must be right."""
    found, at = [], 0
    while at < len(content):
        (length,) = struct.unpack_from("<Q", content, at)
        for begin, size in ((at, 8), (at + 12, length)):
            crc = crc32c(content[begin : begin + size])
            masked = ((crc >> 15 | crc << 17) + 0xA282EAD8) & 0xFFFFFFFF
            assert struct.unpack_from("<I", content, begin + size) == (masked,), f"byte {begin}"
        found.append(content[at + 12 : at + 12 + length])
        at += 12 + length + 4
    return found


def wire(message):
    """Field number -> values of a protobuf message: whole numbers, or the bytes of other types."""
    found, at = {}, 0
    while at < len(message):
        key, at = _varint(message, at)
        kind = key & 7
        if kind == 0:
            value, at = _varint(message, at)
        else:
            size, at = {1: (8, at), 5: (4, at)}.get(kind) or _varint(message, at)
            value, at = message[at : at + size], at + size
        found.setdefault(key >> 3, []).append(value)
    return found


def _varint(message, at):
    value = shift = 0
    while True:
        byte = message[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at


def womd_boxes(folder):
    """(step, id) -> box of the Scenario in a folder, by the numbers of its fields in WOMD."""
    [payload] = tfrecords((folder / "run.tfrecord").read_bytes())
    with (folder / "ids.csv").open(newline="") as file:
        ids = {int(row["number"]): row["id"] for row in csv.DictReader(file)
               if row["kind"] == "track"}  # fmt: skip
    found = {}
    for track in map(wire, wire(payload)[2]):
        [number] = track[1]
        for step, state in enumerate(map(wire, track[3])):
            if state.get(11) == [1]:
                x, y = (struct.unpack("<d", state[field][0])[0] for field in (2, 3))
                heading, length, width = (
                    struct.unpack("<f", state[field][0])[0] for field in (8, 5, 6)
                )
                found[step, ids.get(number, str(number))] = Box(x, y, heading, length, width)
    return found


def osi_boxes(folder):
    """(step, id) -> box of a trace of OSI ground truth, by the numbers of its fields."""
    content, at, found = (folder / "run_gt.osi").read_bytes(), 0, {}
    while at < len(content):
        (size,) = struct.unpack_from("<I", content, at)
        message, at = wire(content[at + 4 : at + 4 + size]), at + 4 + size
        time = wire(message[2][0])
        step = round((time.get(1, [0])[0] + time.get(2, [0])[0] / 1e9) / DT_S)
        for user in map(wire, message.get(5, [])):
            base = wire(user[2][0])
            size, place, turned = (_doubles(base[field][0]) for field in (1, 2, 3))
            agent = wire(user[10][0])[3][0].decode()
            found[step, agent] = Box(place[1], place[2], turned[3], size[1], size[2])
    return found


def _doubles(message):
    return {field: struct.unpack("<d", values[0])[0] for field, values in wire(message).items()}
