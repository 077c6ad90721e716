"""``objects`` of a Nocturne or GPUDrive scene -> motion."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from deepmf_sumo.datatypes import AgentKind, Bools, Floats
from deepmf_sumo.readers.checks import RecordingTracks, identifier
from deepmf_sumo.readers.nocturne.points import points

KINDS: Final[dict[str, AgentKind]] = {
    "vehicle": "vehicle",
    "pedestrian": "pedestrian",
    "cyclist": "cyclist",
}
AV_SIZE_M: Final = (5.286, 2.332)
"""Length and width of the recording vehicle; no other object of the data set has this size."""
SIZE_TOLERANCE_M: Final = 0.002
MISSING: Final = -10000.0
"""Written for positions and velocities of steps without a state."""
MOVING_MPS: Final = 1.0
"""Slower objects do not show which way they head."""
SURE: Final = 0.01
"""Least difference of the mean cosines that tells the unit: in a scene that heads east as a whole
both are alike."""


def tracks(objects: Sequence[Mapping[str, Any]], repairs: list[str]) -> RecordingTracks:
    """Motion of all objects; ids are those of the file, else the places in its list."""
    if not objects:
        raise ValueError("it has no objects; maps without a recording cannot be used")
    position = np.array([points(one["position"]) for one in objects])
    velocity = np.array([points(one["velocity"]) for one in objects])[..., :2]
    written = np.array([one["heading"] for one in objects], float)
    valid = np.array([one["valid"] for one in objects], float) > 0
    size = np.array(
        [[float(one[key]) for key in ("length", "width")] + [_height(one)] for one in objects]
    )
    steps = valid.shape[1]
    marked = valid & (position[..., :2] == MISSING).any(-1)
    if marked.any():
        repairs.append(
            f"{int(marked.sum())} states are called valid, but hold the marker of missing values "
            f"({MISSING:.0f}); they were left out."
        )
    valid &= ~marked
    return RecordingTracks(
        ids=[identifier(one.get("id", index)) for index, one in enumerate(objects)],
        kinds=[KINDS.get(str(one["type"]), "other") for one in objects],
        size_m=np.repeat(size[:, None], steps, axis=1),
        position_m=position,
        heading_rad=_radians(written, velocity, valid, "id" in objects[0], repairs),
        velocity_mps=velocity,
        valid=valid,
    )


def av_by_size(raw: RecordingTracks) -> str | None:
    """The id of the last vehicle of the recording vehicle's size, or None."""
    size = raw.size_m[:, 0, :2]
    alike = (np.abs(size - AV_SIZE_M) <= SIZE_TOLERANCE_M).all(-1)
    rows = [row for row in np.flatnonzero(alike) if raw.kinds[row] == "vehicle"]
    return raw.ids[rows[-1]] if rows else None


def _height(described: Mapping[str, Any]) -> float:
    """0, which is unknown, in files of the early forms."""
    return float(described.get("height", 0.0))


def _radians(
    written: Floats, velocity: Floats, valid: Bools, has_ids: bool, repairs: list[str]
) -> Floats:
    """Headings in radians. The unit is not written anywhere: motion tells.

    Moving objects head where they go, so the unit is the one that makes the mean cosine between
    heading and velocity the larger. Where that does not tell, numbers beyond a full turn are
    degrees; where there are none, files with object ids have radians, and all others degrees.
    """
    moving = valid & (np.hypot(velocity[..., 0], velocity[..., 1]) > MOVING_MPS)
    direction = np.arctan2(velocity[..., 1], velocity[..., 0])
    gain = np.cos(np.radians(written) - direction) - np.cos(written - direction)
    degrees_fit = float(gain[moving].mean()) if moving.any() else 0.0
    if abs(degrees_fit) > SURE:
        in_degrees = degrees_fit > 0
    elif (np.abs(written[valid]) > 2 * np.pi).any():
        in_degrees = True
    else:
        in_degrees = not has_ids
        unit = "degrees" if in_degrees else "radians"
        repairs.append(
            f"Motion does not tell the headings' unit; that of the form was taken: {unit}."
        )
    return np.radians(written) if in_degrees else written
