"""The scene as an image around a pose: one channel per kind of thing, drawn by index assignment.

The image looks ahead along +x of the pose: a quarter of it lies behind. Pixel (row, column) covers
x = (row - pixels/4) * metres and y = (column - pixels/2) * metres.
"""

import math

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo.deepmf.networks.config import AGENT_CLASSES, Preset
from deepmf_sumo.deepmf.networks.kinematics import Pose
from deepmf_sumo.deepmf.networks.lanes import RoadIndex
from deepmf_sumo.deepmf.networks.paths import signal_colour
from deepmf_sumo.scene import AgentId, Bytes, Floats, Ints, SignalState, Tracks, View

_BOX = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 6), np.linspace(-0.5, 0.5, 3)), -1).reshape(
    -1, 2
)
"""Points of the unit box that are drawn: 1 m apart on a car."""

_SEVEN = {
    SignalState.ARROW_STOP: 0, SignalState.ARROW_CAUTION: 1, SignalState.ARROW_GO: 2,
    SignalState.STOP: 3, SignalState.CAUTION: 4, SignalState.GO: 5,
}  # fmt: skip


def draw(view: View, index: RoadIndex, preset: Preset, pose: Pose) -> Bytes:
    """(C, pixels, pixels) of 0 and 1 around the pose of an agent of the view."""
    side = preset.raster_pixels
    image = np.zeros((preset.raster_channels, side, side), np.uint8)
    tracks = view.history
    groups = _classes(tracks, pose.agent_id, view.av_id)
    for number, step in enumerate(preset.raster_frames):
        seen = np.flatnonzero(tracks.valid[:, step])
        points = _box_points(tracks, seen, step)
        local = pose.to_local(points)
        channel = groups[seen] * len(preset.raster_frames) + number
        _set(image, local.reshape(-1, 2), np.repeat(channel, len(_BOX)), preset)
    base = len(AGENT_CLASSES) * len(preset.raster_frames)
    _set(image, pose.to_local(index.pixel_m), base + index.pixel_channel, preset)
    _signals(image, view, index, preset, pose)
    return image


def pack(image: Bytes) -> Bytes:
    """The image as bits, for the cache of features."""
    return np.packbits(image.reshape(-1))


def unpacked(bits: Bytes, preset: Preset) -> NDArray[np.float32]:
    """(C, pixels, pixels) of what `pack` made."""
    shape = preset.raster_channels, preset.raster_pixels, preset.raster_pixels
    return np.unpackbits(bits, count=math.prod(shape)).reshape(shape).astype(np.float32)


def _classes(tracks: Tracks, target_id: AgentId, av_id: AgentId) -> Ints:
    """(A) 0 the target, 1 vehicles, 2 all other agents, 3 the AV."""
    groups = np.array([1 if kind == "vehicle" else 2 for kind in tracks.kinds], np.int64)
    groups[tracks.row(av_id)] = 3
    groups[tracks.row(target_id)] = 0
    return groups


def _box_points(tracks: Tracks, rows: Ints, step: int) -> Floats:
    """(R, 18, 2) points inside the boxes, in the scene's frame."""
    heading = tracks.heading_rad[rows, step][:, None]
    local = _BOX * tracks.size_m[rows, None, :2]
    cos, sin = np.cos(heading), np.sin(heading)
    x = local[..., 0] * cos - local[..., 1] * sin
    y = local[..., 0] * sin + local[..., 1] * cos
    return np.stack([x, y], -1) + tracks.position_m[rows, step][:, None]


def _set(image: Bytes, local_m: Floats, channel: Ints, preset: Preset) -> None:
    """Set the pixels under points; those outside are left out."""
    side = preset.raster_pixels
    pixel = np.floor(local_m / preset.raster_m).astype(np.int64) + np.array((side // 4, side // 2))
    inside = ((pixel >= 0) & (pixel < side)).all(-1)
    image[channel[inside], pixel[inside, 0], pixel[inside, 1]] = 1


def _signals(image: Bytes, view: View, index: RoadIndex, preset: Preset, pose: Pose) -> None:
    """The first metres of each lane with a signal, in the channel of its state."""
    base = preset.raster_channels - preset.raster_signals
    for lane_id, state in view.signals.items():
        if lane_id not in index.map.row:
            continue
        number = _SEVEN.get(state, 6) if preset.raster_signals == 7 else signal_colour(state)
        if number < preset.raster_signals:
            line = index.map.line_m[index.map.row[lane_id]]
            local = pose.to_local(line[:6])
            _set(image, local, np.full(len(local), base + number), preset)
