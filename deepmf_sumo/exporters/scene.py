"""A recorded scene, as ``scene.npz``: attacks become training data.

The package's own format, see `readers.npz`.
"""

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from deepmf_sumo import files, plugins
from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.scene import Plan, RoadMap, Rollout, Scene, Signals, Tracks, frozen
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.ground import ground_of
from deepmf_sumo.scene.readers import npz

FILE: Final = "scene.npz"


class Settings(plugins.Settings):
    """None."""


def write(run: Exportable, path: Path, settings: Settings) -> None:
    """Write the scene, see `scene_of`. Raises OutputError."""
    with files.writing(path):
        npz.write(scene_of(run), path)


def scene_of(run: Exportable) -> Scene:
    """The run as a scene whose labelled pair is the AV and its opponent.

    After a contact the AV is not valid, since its further motion is unknown; the attackers' last
    plans continue, since the AV reacted to them. Signals of recordings are kept; a rollout has none
    of network cases, so there they are unknown.
    """
    rollout, around = run.rollout, run.around
    steps = max(rollout.tracks.steps, rollout.now + 1 + run.duration_steps)
    tracks = rollout.tracks.padded(steps - rollout.tracks.steps)
    tracks = _with_plans(tracks, rollout, around.road)
    interest = (rollout.av_id, rollout.opponent_id) if rollout.opponent_id else ()
    known = around.signals
    signals = _unknown(steps) if known is None else _continued(known, steps)
    return Scene(
        name=run.name,
        source=around.source,
        dt_s=rollout.dt_s,
        now=rollout.now,
        timestamps_s=frozen(np.arange(steps) * rollout.dt_s),
        tracks=tracks,
        road=around.road,
        signals=signals,
        av_id=rollout.av_id,
        interest=interest,
    )


def _with_plans(tracks: Tracks, rollout: Rollout, road: RoadMap) -> Tracks:
    """The attackers' last plans after the end of the episode, at the heights of the road."""
    for agent in rollout.attackers:
        plans = rollout.plans_of(agent)
        if plans and agent in tracks.ids:
            tracks = _with_plan(tracks, plans[-1], rollout.tracks.steps, road)
    return tracks


def _with_plan(tracks: Tracks, plan: Plan, begin: int, road: RoadMap) -> Tracks:
    """The tracks with a plan from a step on."""
    row = tracks.row(plan.agent_id)
    stop = min(tracks.steps, plan.first_step + len(plan.position_m))
    if stop <= begin:
        return tracks
    of_plan = slice(begin - plan.first_step, stop - plan.first_step)
    way = np.concatenate([tracks.position_m[row, begin - 1 : begin], plan.position_m[of_plan]])
    z_m = tracks.z_m.copy()
    z_m[row, begin:stop] = ground_of(road).follow(way[None], z_m[row, begin - 1 : begin])[0, 1:]
    position, heading = tracks.position_m.copy(), tracks.heading_rad.copy()
    velocity, valid = tracks.velocity_mps.copy(), tracks.valid.copy()
    heading_plan, speed = plan.heading_rad[of_plan], plan.speed_mps[of_plan]
    position[row, begin:stop] = plan.position_m[of_plan]
    heading[row, begin:stop] = heading_plan
    velocity[row, begin:stop] = speed[:, None] * frames.unit(heading_plan)
    valid[row, begin:stop] = True
    return replace(
        tracks,
        position_m=position,
        z_m=z_m,
        heading_rad=heading,
        velocity_mps=velocity,
        valid=valid,
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
