"""Rollout -> Scene: what happened under attack as a recording, e.g. to learn reactions from."""

from dataclasses import replace

import numpy as np

from deepmf_sumo.datatypes import (
    ROLLOUT,
    Case,
    RecordedCase,
    Rollout,
    Scene,
    Signals,
    Source,
    Tracks,
    frozen,
)


def scene_of(rollout: Rollout, case: Case) -> Scene:
    """The rollout as a scene whose labelled pair is the AV and its opponent.

    After a contact the AV is not valid any more, since what it would have done is not known; the
    opponent's last plan goes on, since that is what the AV's motion was an answer to. Signals of
    recordings are kept; of network cases they are not in a rollout and stay unknown.
    """
    steps = max(rollout.tracks.steps, rollout.now + 1 + case.duration_steps)
    tracks = _with_plan(_padded(rollout.tracks, steps), rollout)
    interest = (rollout.av_id, rollout.opponent_id) if rollout.opponent_id else ()
    if isinstance(case, RecordedCase):
        source = replace(case.scene.source, dataset=ROLLOUT)
        signals = _continued(case.scene.signals, steps)
    else:
        source = Source(dataset=ROLLOUT, file=str(case.config), record=0, sha256="")
        signals = _unknown(steps)
    return Scene(
        name=case.name,
        source=source,
        dt_s=rollout.dt_s,
        now=rollout.now,
        timestamps_s=frozen(np.arange(steps) * rollout.dt_s),
        tracks=tracks,
        road=case.road,
        signals=signals,
        av_id=rollout.av_id,
        interest=interest,
    )


def _padded(tracks: Tracks, steps: int) -> Tracks:
    """The tracks, with steps at the end in which nobody is valid."""
    flat, vector = [(0, 0), (0, steps - tracks.steps)], [(0, 0), (0, steps - tracks.steps), (0, 0)]
    return replace(
        tracks,
        position_m=np.pad(tracks.position_m, vector),
        z_m=np.pad(tracks.z_m, flat),
        heading_rad=np.pad(tracks.heading_rad, flat),
        velocity_mps=np.pad(tracks.velocity_mps, vector),
        valid=np.pad(tracks.valid, flat),
    )


def _with_plan(tracks: Tracks, rollout: Rollout) -> Tracks:
    """The opponent's last plan after the end of the episode."""
    if not rollout.plans or rollout.opponent_id not in tracks.ids:
        return tracks
    plan, row, begin = rollout.plans[-1], tracks.row(str(rollout.opponent_id)), rollout.tracks.steps
    stop = min(tracks.steps, plan.first_step + len(plan.position_m))
    if stop <= begin:
        return tracks
    of_plan = slice(begin - plan.first_step, stop - plan.first_step)
    position, heading = tracks.position_m.copy(), tracks.heading_rad.copy()
    velocity, valid = tracks.velocity_mps.copy(), tracks.valid.copy()
    heading_plan, speed = plan.heading_rad[of_plan], plan.speed_mps[of_plan]
    position[row, begin:stop] = plan.position_m[of_plan]
    heading[row, begin:stop] = heading_plan
    direction = np.stack([np.cos(heading_plan), np.sin(heading_plan)], -1)
    velocity[row, begin:stop] = speed[:, None] * direction
    valid[row, begin:stop] = True
    return replace(
        tracks, position_m=position, heading_rad=heading, velocity_mps=velocity, valid=valid
    )


def _continued(signals: Signals, steps: int) -> Signals:
    pad = [(0, 0), (0, max(0, steps - signals.seen.shape[1]))]
    return replace(
        signals,
        state=np.pad(signals.state, pad)[:, :steps],
        seen=np.pad(signals.seen, pad)[:, :steps],
    )


def _unknown(steps: int) -> Signals:
    return Signals(
        lane_ids=(),
        state=np.zeros((0, steps), np.uint8),
        seen=np.zeros((0, steps), bool),
        stop_m=np.zeros((0, 2)),
    )
