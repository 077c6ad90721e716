"""Checks and repairs of recorded motion. Every repair leaves a sentence."""

import itertools
from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import DT_S, AgentKind, Bools, Floats, Tracks
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.geometry import angles

FASTEST_MPS: Final = 80.0
"""Motion between two steps that is faster than this is taken for a jump of the tracker."""
JUMP_M: Final = 3.0
"""So is one that is farther than the recorded speeds explain by more than this."""
FARTHEST_M: Final = 1e6
"""No recording has its origin as far away."""
TYPICAL_SIZE_M: Final[dict[AgentKind, tuple[float, float, float]]] = {
    "vehicle": (4.7, 2.0, 1.7),
    "pedestrian": (0.9, 0.9, 1.75),
    "cyclist": (1.8, 0.8, 1.75),
    "other": (1.0, 1.0, 1.0),
}
"""Given to an agent that has no size at any valid step: about the medians in recordings."""


@dataclass(kw_only=True)
class RecordingTracks:
    """Motion as a file tells it; the shapes are those of `Tracks`, but for the sizes.

    Attributes:
        size_m: (A, T, 3) length, width, height at each step.
        position_m: (A, T, 3).
    """

    ids: list[str]
    kinds: list[AgentKind]
    size_m: Floats
    position_m: Floats
    heading_rad: Floats
    velocity_mps: Floats
    valid: Bools


def refuse_values(tracks: Tracks) -> None:
    """Raises ReaderError where a valid state is not finite or an agent has no size."""
    for name in ("position_m", "heading_rad", "velocity_mps", "z_m"):
        values = getattr(tracks, name)
        bad = ~np.isfinite(values if values.ndim == 2 else values.sum(-1)) & tracks.valid
        if bad.any():
            agent, step = np.argwhere(bad)[0]
            raise ReaderError(f"{name} of {tracks.ids[agent]} at step {step} is not finite")
    flat = ~(tracks.size_m[:, :2] > 0).all(-1)
    if flat.any():
        raise ReaderError(f"agent {tracks.ids[int(flat.argmax())]} has no length or width")


def drop_impossible_states(raw: RecordingTracks, repairs: list[str]) -> None:
    """Make states invalid whose numbers are not finite or a million metres away, in place."""
    finite = (
        np.isfinite(raw.position_m).all(-1)
        & np.isfinite(raw.velocity_mps).all(-1)
        & np.isfinite(raw.heading_rad)
    )
    near = (np.abs(np.where(finite[..., None], raw.position_m, 0.0)) < FARTHEST_M).all(-1)
    bad = raw.valid & ~(finite & near)
    repairs.extend(
        f"Agent {raw.ids[row]}: {int(bad[row].sum())} states that are not finite numbers, or "
        "are too far away, were left out."
        for row in np.flatnonzero(bad.any(axis=1))
    )
    raw.valid = raw.valid & ~bad


def cut_jumps(
    raw: RecordingTracks, timestamps_s: Floats, now: int, av_id: str, repairs: list[str]
) -> None:
    """Where a track jumps it becomes another object's: keep the part at ``now``, in place.

    A track that is not valid at ``now`` keeps its longest part. Raises ReaderError where the AV's
    track jumps.
    """
    both = raw.valid[:, 1:] & raw.valid[:, :-1]
    moved = np.where(both[..., None], np.diff(raw.position_m[..., :2], axis=1), 0.0)
    distance = np.hypot(moved[..., 0], moved[..., 1])
    velocity = np.where(raw.valid[..., None], raw.velocity_mps, 0.0)
    speed = np.hypot(velocity[..., 0], velocity[..., 1])
    # A frame that the recorder lost doubles the way between two steps; its timestamps tell.
    seconds = np.maximum(np.diff(timestamps_s), DT_S)
    explained = np.maximum(speed[:, 1:], speed[:, :-1]) * seconds + JUMP_M
    jumps = (distance > explained) | (distance > FASTEST_MPS * seconds)
    for row in np.flatnonzero(jumps.any(axis=1)):
        at = np.flatnonzero(jumps[row])
        largest = distance[row, at].max()
        what = f"jumps by up to {largest:.1f} m within a step, first after step {at[0]}"
        if raw.ids[row] == av_id:
            raise ReaderError(f"the AV ({av_id}) {what}")
        start, stop = _part_to_keep(raw.valid[row], at, now)
        lost = int(raw.valid[row].sum() - raw.valid[row, start:stop].sum())
        raw.valid[row, :start] = raw.valid[row, stop:] = False
        repairs.append(
            f"Agent {raw.ids[row]} {what}; {lost} states before or after the jump were left out."
        )


def _part_to_keep(valid: Bools, jumps: np.ndarray, now: int) -> tuple[int, int]:
    borders = [0, *(int(jump) + 1 for jump in jumps), len(valid)]
    parts = list(itertools.pairwise(borders))
    if valid[now]:
        return next(part for part in parts if part[0] <= now < part[1])
    return max(parts, key=lambda part: int(valid[part[0] : part[1]].sum()))


def finished(raw: RecordingTracks, now: int, av_id: str, repairs: list[str]) -> Tracks:
    """Tracks with one size an agent, wrapped headings, zeros where invalid, nobody never seen.

    Raises ReaderError where the AV has no size.
    """
    seen = raw.valid.any(axis=1)
    rows = np.flatnonzero(seen)
    if len(rows) < len(raw.ids):
        never = [raw.ids[row] for row in np.flatnonzero(~seen)]
        repairs.append(f"Agents without a valid state were left out: {', '.join(never)}.")
    ids, kinds = [raw.ids[row] for row in rows], [raw.kinds[row] for row in rows]
    valid = raw.valid[rows]
    position = np.where(valid[..., None], raw.position_m[rows], 0.0)
    return Tracks(
        ids=tuple(ids),
        kinds=tuple(kinds),
        size_m=_sizes(ids, kinds, raw.size_m[rows], valid, now, av_id, repairs),
        position_m=position[..., :2],
        z_m=position[..., 2],
        heading_rad=np.where(valid, angles.wrap(np.where(valid, raw.heading_rad[rows], 0.0)), 0.0),
        velocity_mps=np.where(valid[..., None], raw.velocity_mps[rows], 0.0),
        valid=valid,
    )


def _sizes(
    ids: list[str],
    kinds: list[AgentKind],
    size_m: Floats,
    valid: Bools,
    now: int,
    av_id: str,
    repairs: list[str],
) -> Floats:
    """(A, 3) size at the current step, else at the valid step nearest to it.

    A height of 0 means that the source has none; it stays.
    """
    away = np.abs(np.arange(valid.shape[1]) - now)
    far = len(away) * 2
    sized = valid & np.isfinite(size_m).all(-1) & (size_m[..., :2] > 0).all(-1)
    nearest = np.where(valid, away, far).argmin(axis=1)
    usable = np.where(sized, away, far).argmin(axis=1)
    row = np.arange(len(ids))
    sizes: Floats = size_m[row, usable].copy()
    has_size = sized.any(axis=1)
    repairs.extend(
        f"Agent {ids[agent]} has no size at step {nearest[agent]}; "
        f"that of step {usable[agent]} was taken."
        for agent in np.flatnonzero((nearest != usable) & has_size)
    )
    for agent in np.flatnonzero(~has_size):
        if ids[agent] == av_id:
            raise ReaderError(f"the AV ({av_id}) has no size")
        sizes[agent] = TYPICAL_SIZE_M[kinds[agent]]
        length, width, _ = sizes[agent]
        repairs.append(
            f"Agent {ids[agent]} has no size; {length} x {width} m, typical of its kind "
            f"({kinds[agent]}), was taken."
        )
    return sizes
