"""Ground truth of ASAM's Open Simulation Interface: ``osi/run_gt.osi`` and ``osi/run.mcap``.

One ``GroundTruth`` a step, the same ones in both files: road users with box, velocity and
acceleration, and the painted lines and edges of the road near the AV's way, at each step. Ids are
numbers in this format; ``source_reference`` has the run's own, and a second one marks people who
were made. It needs the extra ``osi``.
"""

import errno
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
from pydantic import Field

from deepmf_sumo import files, plugins
from deepmf_sumo.errors import PluginError
from deepmf_sumo.exporters._numbers import Numbers, Sort
from deepmf_sumo.exporters.base import AXLE, Exportable, known_heights
from deepmf_sumo.scene import Bools, Floats, Polyline, RoadMap, Tracks
from deepmf_sumo.scene.road_users import RoadUserClass, class_of

FILE: Final = "osi/"
TRACE, RECORDS, ABOUT = "run_gt.osi", "run.mcap", "about.json"
TOPIC: Final = "GroundTruth"
_REFERENCE: Final = "net.deepmf-sumo"
"""Type of the references that hold the run's own ids."""
_MADE: Final = f"{_REFERENCE}.made"
"""Type of a second reference of people who are not in the demand."""
_CREATED: Final = "1970-01-01T00:00:00Z"
"""The same run gives the same bytes."""
_VEHICLES: Final[dict[RoadUserClass, str]] = {
    "car": "CAR", "truck": "HEAVY_TRUCK", "motorcycle": "MOTORBIKE", "bicycle": "BICYCLE",
}  # fmt: skip
_NANOSECONDS: Final = 1_000_000_000
_LINES: Final = (
    ("UNKNOWN", "UNKNOWN"), ("DASHED_LINE", "WHITE"), ("SOLID_LINE", "WHITE"),
    ("SOLID_LINE", "WHITE"), ("DASHED_LINE", "YELLOW"), ("DASHED_LINE", "YELLOW"),
    ("SOLID_LINE", "YELLOW"), ("SOLID_LINE", "YELLOW"), ("OTHER", "YELLOW"),
)  # fmt: skip
"""Type and colour by WOMD's RoadLine.type; a double line is one, and one that may be passed from
one side is ``OTHER``."""
_PACKAGES: Final = {"osi3": "osi-python", "osi_utilities": "asam-osi-utilities"}


class Settings(plugins.Settings):
    """What of the road is written.

    Attributes:
        around_m: distance from the AV's way up to which lines and edges are; 0 leaves them out.
    """

    around_m: float = Field(default=150.0, ge=0.0)


def check() -> None:
    """Raise PluginError without the extra."""
    for module, package in _PACKAGES.items():
        if find_spec(module) is None:
            raise PluginError(
                f"exporter 'osi' needs {package}, which is not installed; install it with"
                ' `pip install "deepmf-sumo[osi]"`.'
            )


def write(run: Exportable, path: Path, settings: Settings) -> None:
    """Write the folder ``path``; time 0 is the first step of history.

    Raises OutputError, PluginError without the extra, and what `Exportable.around` raises.
    """
    check()
    rollout = run.rollout
    drawn, left_out = _near(run, settings.around_m)
    tracks: list[tuple[Sort, str]] = [("track", agent) for agent in rollout.tracks.ids]
    numbers = Numbers([*tracks, *((sort, one.id) for sort, one in drawn)])
    road = _boundaries(drawn, numbers)
    with files.writing(path), files.whole_folder(path) as folder:
        _write_all(folder, list(_messages(run, numbers, road)))
        about = {
            "run_id": run.name,
            "steps": rollout.tracks.steps,
            "attacked_from_s": round(rollout.now * rollout.dt_s, 3),
            "lane_boundaries": len(road),
            "lane_boundaries_left_out": left_out,
            "road_users": len(rollout.tracks.ids),
            "made": list(run.made),
        }
        files.write_json(folder / ABOUT, about)


def _near(run: Exportable, around_m: float) -> tuple[list[tuple[Sort, Polyline]], int]:
    """The lines and edges near the AV's way, and how many others there are."""
    road: RoadMap = run.around.road
    every: list[tuple[Sort, Polyline]] = [("line", one) for one in road.lines]
    every += [("edge", one) for one in road.edges]
    every = [(sort, one) for sort, one in every if len(one.points_m) > 1]
    tracks = run.rollout.tracks
    row = tracks.row(run.rollout.av_id)
    way = tracks.position_m[row, tracks.valid[row]]
    driven = shapely.LineString(way) if len(way) > 1 else shapely.Point(way[0])
    near = [
        (sort, one)
        for sort, one in every
        if around_m and shapely.dwithin(shapely.LineString(one.points_m), driven, around_m)
    ]
    return near, len(every) - len(near)


def _boundaries(drawn: Sequence[tuple[Sort, Polyline]], numbers: Numbers) -> list[Any]:
    from osi3.osi_lane_pb2 import LaneBoundary

    kinds = LaneBoundary.Classification
    found = []
    for sort, one in drawn:
        boundary = LaneBoundary()
        boundary.id.value = numbers(sort, one.id)
        line, colour = _LINES[one.kind] if sort == "line" else ("ROAD_EDGE", "NONE")
        boundary.classification.type = kinds.Type.Value(f"TYPE_{line}")
        boundary.classification.color = kinds.Color.Value(f"COLOR_{colour}")
        boundary.source_reference.add(type=_REFERENCE, identifier=[one.id])
        for (x, y), z in zip(one.points_m.tolist(), one.z_m.tolist(), strict=True):
            _place(boundary.boundary_line.add().position, x, y, z)
        found.append(boundary)
    return found


def _messages(run: Exportable, numbers: Numbers, road: Sequence[Any]) -> Iterator[Any]:
    """One ``GroundTruth`` a step."""
    from osi3 import osi_version_pb2 as version
    from osi3.osi_groundtruth_pb2 import GroundTruth

    rollout, tracks = run.rollout, run.rollout.tracks
    gained, heights = _accelerations(tracks, rollout.dt_s), known_heights(tracks)
    current = version.DESCRIPTOR.GetOptions().Extensions[version.current_interface_version]
    for step in range(tracks.steps):
        message = GroundTruth(lane_boundary=road)
        message.version.CopyFrom(current)
        nanoseconds = round(step * rollout.dt_s * _NANOSECONDS)
        message.timestamp.seconds, message.timestamp.nanos = divmod(nanoseconds, _NANOSECONDS)
        message.host_vehicle_id.value = numbers("track", rollout.av_id)
        for row in np.flatnonzero(tracks.valid[:, step]).tolist():
            user = message.moving_object.add()
            user.id.value = numbers("track", tracks.ids[row])
            user.source_reference.add(type=_REFERENCE, identifier=[tracks.ids[row]])
            if tracks.ids[row] in run.made:
                user.source_reference.add(type=_MADE, identifier=[tracks.ids[row]])
            _fill(user, tracks, (row, step), gained[row, step], float(heights[row]))
        yield message


def _fill(user: Any, tracks: Tracks, at: tuple[int, int], gained: Floats, height: float) -> None:
    """Type, box and motion of a road user; the box stands on the ground."""
    known = class_of(tracks.kinds[at[0]], tracks.size_m[at[0]])
    length, width, _ = tracks.size_m[at[0]].tolist()
    things = "PEDESTRIAN" if known == "pedestrian" else "OTHER"
    user.type = user.Type.Value(f"TYPE_{'VEHICLE' if known in _VEHICLES else things}")
    base = user.base
    base.dimension.length, base.dimension.width, base.dimension.height = length, width, height
    x, y = tracks.position_m[at].tolist()
    _place(base.position, x, y, float(tracks.z_m[at]) + height / 2)
    base.orientation.yaw = float(tracks.heading_rad[at])
    base.orientation.pitch = base.orientation.roll = 0.0
    for vector, (east, north) in (
        (base.velocity, tracks.velocity_mps[at].tolist()),
        (base.acceleration, gained.tolist()),
    ):
        _place(vector, east, north, 0.0)
    if known in _VEHICLES:
        types = user.VehicleClassification
        user.vehicle_classification.type = types.Type.Value(f"TYPE_{_VEHICLES[known]}")
        user.vehicle_classification.role = types.Role.Value("ROLE_CIVIL")
        axles = user.vehicle_attributes
        _place(axles.bbcenter_to_rear, -AXLE * length, 0.0, -height / 2)
        _place(axles.bbcenter_to_front, AXLE * length, 0.0, -height / 2)


def _place(vector: Any, x: float, y: float, z: float) -> None:
    vector.x, vector.y, vector.z = x, y, z


def _accelerations(tracks: Tracks, dt_s: float) -> Floats:
    """(A, S, 2) difference of velocities to the step before; at a first step to the one after."""
    both: Bools = tracks.valid[:, 1:] & tracks.valid[:, :-1]
    change = np.diff(tracks.velocity_mps, axis=1) / dt_s * both[..., None]
    gained = np.zeros(tracks.velocity_mps.shape)
    gained[:, 1:] = change
    known = np.zeros(tracks.valid.shape, bool)
    known[:, 1:] = both
    rows, steps = np.nonzero(~known[:, :-1] & both)
    gained[rows, steps] = change[rows, steps]
    return gained


def _write_all(folder: Path, messages: Sequence[Any]) -> None:
    """Both files, by ASAM's library, which answers False where a file cannot be written."""
    from osi3.osi_groundtruth_pb2 import GroundTruth
    from osi_utilities import MultiTraceWriter, SingleTraceWriter

    single, several = SingleTraceWriter(), MultiTraceWriter()
    try:
        fine = single.open(folder / TRACE)
        fine = fine and several.open(folder / RECORDS, _metadata(messages[0].version))
        if fine:
            several.add_channel(TOPIC, GroundTruth, _channel(messages[0].version))
        for message in messages:
            fine = fine and single.write_message(message)
            fine = fine and several.write_message(message, TOPIC)
    finally:
        single.close()
        several.close()
    if not fine:
        raise OSError(errno.EIO, "ASAM's writer gave up")  # `files.writing` names the path


def _metadata(version: Any) -> dict[str, str]:
    """Of the trace, by the keys that OSI wants."""
    import google.protobuf

    protobuf, osi = google.protobuf.__version__, _text(version)
    return {
        "version": osi,
        "min_osi_version": osi,
        "max_osi_version": osi,
        "min_protobuf_version": protobuf,
        "max_protobuf_version": protobuf,
        "creation_time": _CREATED,
        "zero_time": _CREATED,
        "description": "A simulated run",
        "data_sources": "SUMO",
    }


def _channel(version: Any) -> dict[str, str]:
    """Of the channel, by the keys that OSI wants."""
    import google.protobuf

    versions = {"osi_version": _text(version), "protobuf_version": google.protobuf.__version__}
    return {f"net.asam.osi.trace.channel.{name}": one for name, one in versions.items()}


def _text(version: Any) -> str:
    return f"{version.version_major}.{version.version_minor}.{version.version_patch}"
