"""Rollouts and cases made by hand: what metrics and adversaries are tested with."""

from pathlib import Path

import numpy as np

from deepmf_sumo.scene import (
    DT_S,
    Contact,
    Driver,
    RecordedCase,
    Rollout,
    Scene,
    Signals,
    Source,
    SumoNet,
    Tracks,
    TrafficCase,
)

from tests.support.predictor_doubles import straight_road


def tracks_of(paths, size=(4.8, 2.0)):
    """Tracks from id -> (T, 3) x, y, heading; velocities are differences to the step before."""
    poses = np.stack(list(paths.values()))
    velocity = np.diff(poses[..., :2], axis=1) / DT_S
    count, steps = poses.shape[:2]
    return Tracks(
        ids=tuple(paths),
        kinds=("vehicle",) * count,
        size_m=np.tile([*size, 1.5], (count, 1)),
        position_m=poses[..., :2],
        z_m=np.zeros((count, steps)),
        heading_rad=poses[..., 2],
        velocity_mps=np.concatenate([velocity[:, :1], velocity], axis=1),
        valid=np.ones((count, steps), bool),
    )


def straight(x, y, speed, steps=91, heading=0.0, accel=0.0, now=10):
    """(T, 3) poses of a vehicle that is at x, y now; it accelerates from now on."""
    seconds = (np.arange(steps) - now) * DT_S
    along = speed * seconds + accel * np.maximum(seconds, 0) ** 2 / 2
    pose = np.stack([x + along * np.cos(heading), y + along * np.sin(heading)], -1)
    return np.concatenate([pose, np.full((steps, 1), heading)], axis=1)


def rollout_of(paths, contacts=(), opponent_id="b", plans=(), now=10):
    """A rollout in which the policy drives the opponent after now."""
    tracks = tracks_of(paths)
    driver = np.full((tracks.agents, tracks.steps), Driver.LOG)
    driver[tracks.row("av"), now + 1 :] = Driver.PLANNER
    if opponent_id is not None:
        driver[tracks.row(opponent_id), now + 1 :] = Driver.POLICY
    return Rollout(
        tracks=tracks,
        driver=driver,
        now=now,
        dt_s=DT_S,
        av_id="av",
        attackers=() if opponent_id is None else (opponent_id,),
        contacts=tuple(contacts),
        events=(),
        plans=tuple(plans),
        ended="contact" if contacts else "time",
    )


def contact_of(kind="av_opponent", step=40, first="av", second="b"):
    return Contact(
        kind=kind,
        step=step,
        first_id=first,
        second_id=second,
        striker_id=second,
        pose_first=np.zeros(3),
        pose_second=np.zeros(3),
        relative_mps=4.5,
        closing_mps=4.0,
        sector=0,
        delta_v_mps=2.25,
    )


def in_traffic(case):
    """The same situation in SUMO's own traffic: there is no recording."""
    return TrafficCase(
        name=case.name, road=case.road, av_id=case.av_id, duration_steps=case.duration_steps,
        seed=case.seed, config=Path("made.sumocfg"), start_s=0.0, net_file=Path("made.net.xml"),
    )  # fmt: skip


def case_of(paths=None, tmp="net.net.xml", partner_id=None):
    """A case whose recording holds the given paths."""
    tracks = tracks_of(paths or {"av": straight(0, 0, 10), "b": straight(-8, 3.5, 12)})
    road = straight_road()
    scene = Scene(
        name="made",
        source=Source(dataset="made", file="made", record=0, sha256=""),
        dt_s=DT_S,
        now=10,
        timestamps_s=np.arange(tracks.steps) * DT_S,
        tracks=tracks,
        road=road,
        signals=Signals(
            lane_ids=(),
            state=np.zeros((0, tracks.steps)),
            seen=np.zeros((0, tracks.steps)),
            stop_m=[],
        ),
        av_id="av",
    )
    return RecordedCase(
        name="made",
        road=road,
        av_id="av",
        duration_steps=80,
        traffic="log",
        seed=0,
        scene=scene,
        net=SumoNet(file=Path(tmp), additional=None),
        partner_id=partner_id,
    )
