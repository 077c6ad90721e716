"""Checks of a recording's clock and of the motion in it; `repair` has the others."""

import itertools
from dataclasses import replace
from typing import Final

import numpy as np

from deepmf_sumo.errors import ReaderError
from deepmf_sumo.scene import DT_S, HISTORY_STEPS, Bools, Floats, Ints, frozen
from deepmf_sumo.scene.readers.raw import RawScene, RawTracks

RATE_OFF: Final = 0.02
"""Share by which the clock may differ from 0.1 s a step over the whole recording,"""
DRIFT_S: Final = 0.1
"""and seconds by which it may differ within a second; WOMD's differs by up to 0.05 s."""
MOST_THINNED: Final = 10
"""A recording may have so many times 10 Hz, less a half."""
MOVES_MPS: Final = 2.0
"""Faster road users show the rate of a recording by their motion,"""
LEAST_STATES: Final = 50
"""if there are so many of their states."""
MOTION_OFF: Final = 0.1
"""Share by which their motion may differ from their speeds; in WOMD the median differs by 0.01."""
FASTEST_MPS: Final = 80.0
"""Faster motion between two steps is a jump of the tracker."""
JUMP_M: Final = 3.0
"""So is motion that exceeds the distance explained by the recorded speeds by this much."""
UNSEEN_MPS2: Final = 4.0
"""A road user may speed up and slow down by this much while it is not seen."""
FARTHEST_M: Final = 1e6
"""Recordings have their origin closer than this."""


def thinned(recording: RawScene) -> RawScene:
    """A recording of 20, 30, ... Hz with every second, third, ... step of it, else as it is."""
    times = recording.timestamps_s
    steps = recording.tracks.valid.shape[1]
    if len(times) != steps or steps < 2 or not np.isfinite(times).all():
        return recording
    usual = float(np.median(np.diff(times)))
    every = round(DT_S / usual) if usual > DT_S / MOST_THINNED else 1
    if every < 2 or abs(every * usual - DT_S) > RATE_OFF * DT_S:
        return recording
    first = recording.now % every  # so that the current step stays one
    raw, signals = recording.tracks, recording.signals
    return replace(
        recording,
        now=max(recording.now // every, HISTORY_STEPS - 1),
        timestamps_s=times[first::every],
        tracks=RawTracks(
            ids=raw.ids,
            kinds=raw.kinds,
            size_m=raw.size_m[:, first::every],
            position_m=raw.position_m[:, first::every],
            heading_rad=raw.heading_rad[:, first::every],
            velocity_mps=raw.velocity_mps[:, first::every],
            valid=raw.valid[:, first::every],
        ),
        signals=replace(
            signals, state=signals.state[:, first::every], seen=signals.seen[:, first::every]
        ),
        repairs=[
            *recording.repairs,
            f"It was recorded at {1 / usual:.3g} Hz; one of {every} steps was used.",
        ],
    )


def timestamps(recorded: Floats, steps: int, repairs: list[str]) -> Floats:
    """(T) as recorded, or on the grid of 0.1 s if the recorded ones cannot be right.

    Frames that the recorder lost are reported. Raises ReaderError with the recorded rate if it is
    not 10 Hz over the whole recording.
    """
    grid = frozen(np.arange(steps) * DT_S)
    if not len(recorded):
        return grid
    if len(recorded) != steps:
        raise ReaderError(f"has {len(recorded)} timestamps, but {steps} steps")
    spacing = np.diff(recorded)
    if not np.isfinite(recorded).all() or (spacing < 0).any():
        repairs.append("The timestamps are not finite or run backwards; 0.1 s a step was used.")
        return grid
    usual = float(np.median(spacing))
    if abs(usual - DT_S) > RATE_OFF * DT_S:
        rate = f" ({1 / usual:.3g} Hz)" if usual > 0 else ""
        raise ReaderError(
            f"was recorded every {usual:.3g} s{rate}; only {DT_S} s can be used: resample it"
        )
    lost = np.maximum(np.rint(spacing / DT_S) - 1, 0)
    _refuse_drift(recorded, spacing - DT_S * (1 + lost))
    if lost.any():
        first = int(np.flatnonzero(lost)[0])
        repairs.append(
            f"The recorder lost {int(lost.sum())} frames, the first after step {first}; the steps "
            f"before and after them count as {DT_S} s apart."
        )
    return recorded


def _refuse_drift(recorded: Floats, off_s: Floats) -> None:
    """Raises ReaderError if steps are longer or shorter for a second, or a little for long.

    ``off_s`` is by how much each step is longer than the frames in it.
    """
    off = np.concatenate([[0.0], np.cumsum(off_s)])
    second = min(round(1 / DT_S), len(off) - 1)
    within = np.abs(off[second:] - off[:-second])
    overall = np.abs(off) - RATE_OFF * (recorded - recorded[0])
    for excess, first in ((within, 0), (overall, second)):
        if len(excess) and excess.max() > DRIFT_S + 1e-9:
            worst = int(np.flatnonzero(excess > 0.999 * excess.max())[0])
            at = max(worst - first, 0)
            took = (recorded[at + second] - recorded[at]) / second
            raise ReaderError(
                f"was not recorded every {DT_S} s throughout: from step {at} on a step takes "
                f"{took:.3g} s; resample it"
            )


def fill_unknown_heights(raw: RawTracks, repairs: list[str]) -> None:
    """Replace heights, in place, that are not finite at states whose place is.

    By that of the nearest step with a height; by 0 where the track has none.
    """
    placed = raw.valid & np.isfinite(raw.position_m[..., :2]).all(-1)
    known = placed & np.isfinite(raw.position_m[..., 2])
    unknown = placed & ~known
    for row in np.flatnonzero(unknown.any(axis=1)):
        steps, to_fill = np.flatnonzero(known[row]), np.flatnonzero(unknown[row])
        height = 0.0
        if len(steps):
            nearest = np.abs(to_fill[:, None] - steps).argmin(axis=1)
            height = raw.position_m[row, steps[nearest], 2]
        raw.position_m[row, to_fill, 2] = height
    if unknown.any():
        repairs.append(
            f"{int(unknown.sum())} states without a height have that of the nearest step, or 0"
            " where the track has none."
        )


def drop_impossible_states(raw: RawTracks, repairs: list[str]) -> None:
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
        "are too far away, were dropped."
        for row in np.flatnonzero(bad.any(axis=1))
    )
    raw.valid = raw.valid & ~bad


def refuse_other_rate(raw: RawTracks, timestamps_s: Floats) -> None:
    """Raises ReaderError if the road users move more, or less, than their speeds say.

    So they do in files whose steps are not as long as their timestamps say, or that have none.
    """
    speed = _speeds(raw)
    both = raw.valid[:, 1:] & raw.valid[:, :-1]
    mean = (speed[:, 1:] + speed[:, :-1]) / 2
    moved = np.linalg.norm(np.diff(raw.position_m[..., :2], axis=1), axis=-1)
    moving = both & (mean > MOVES_MPS)
    if moving.sum() < LEAST_STATES:
        return
    seconds = np.maximum(np.diff(timestamps_s), DT_S)
    share = float(np.median((moved / np.where(moving, mean * seconds, 1.0))[moving]))
    if abs(share - 1) > MOTION_OFF:
        raise ReaderError(
            f"moves its road users {share:.2g} times as far in {DT_S} s as their speeds say; "
            f"either its steps take {share * DT_S:.2g} s, and it has to be resampled, or its "
            "speeds are not in m/s"
        )


def cut_jumps(
    raw: RawTracks, timestamps_s: Floats, now: int, av_id: str, repairs: list[str]
) -> None:
    """Where a track jumps it becomes another object's: keep the part at ``now``, in place.

    It can jump within a step or while it is not seen. A track that is not valid at ``now`` keeps
    its longest part. Raises ReaderError if the AV's track jumps.
    """
    distance, before = _jumps(raw, timestamps_s)
    for row in np.flatnonzero(distance.any(axis=1)):
        at = np.flatnonzero(distance[row])
        step = int(before[row, at[0]])
        unseen = " or a gap" if (before[row, at] < at).any() else ""
        what = (
            f"jumps by up to {distance[row].max():.1f} m within a step{unseen}, "
            f"first after step {step}"
        )
        if raw.ids[row] == av_id:
            raise ReaderError(f"the AV ({av_id}) {what}")
        start, stop = _part_to_keep(raw.valid[row], at, now)
        lost = int(raw.valid[row].sum() - raw.valid[row, start:stop].sum())
        raw.valid[row, :start] = raw.valid[row, stop:] = False
        repairs.append(
            f"Agent {raw.ids[row]} {what}; {lost} states before or after the jump were dropped."
        )


def _jumps(raw: RawTracks, timestamps_s: Floats) -> tuple[Floats, Ints]:
    """(A, T - 1) length of the jump to the next step, 0 without one; the last valid step up to it.

    After a gap it counts from the last step before the gap.
    """
    steps = np.arange(raw.valid.shape[1])
    seen = np.where(raw.valid, steps, -1)
    before = np.maximum.accumulate(seen, axis=1)[:, :-1]
    both = raw.valid[:, 1:] & (before >= 0)
    rows = np.arange(len(raw.valid))[:, None]
    start = np.maximum(before, 0)
    xy = raw.position_m[..., :2]
    moved = np.where(both[..., None], xy[:, 1:] - xy[rows, start], 0.0)
    distance = np.hypot(moved[..., 0], moved[..., 1])
    speed = _speeds(raw)
    # A frame that the recorder lost doubles the distance between two steps; its timestamps tell.
    count = steps[1:] - start
    seconds = np.maximum(timestamps_s[1:] - timestamps_s[start], DT_S * count)
    unseen = np.where(count > 1, UNSEEN_MPS2 * seconds**2 / 4, 0.0)
    explained = np.maximum(speed[:, 1:], speed[rows, start]) * seconds + JUMP_M + unseen
    jumps = (distance > explained) | (distance > FASTEST_MPS * seconds)
    return np.where(jumps, distance, 0.0), before


def _speeds(raw: RawTracks) -> Floats:
    """(A, T) recorded speeds, 0 where there is no state."""
    velocity = np.where(raw.valid[..., None], raw.velocity_mps, 0.0)
    return np.hypot(velocity[..., 0], velocity[..., 1])


def _part_to_keep(valid: Bools, jumps: Ints, now: int) -> tuple[int, int]:
    borders = [0, *(int(jump) + 1 for jump in jumps), len(valid)]
    parts = list(itertools.pairwise(borders))
    if valid[now]:
        return next(part for part in parts if part[0] <= now < part[1])
    return max(parts, key=lambda part: int(valid[part[0] : part[1]].sum()))
