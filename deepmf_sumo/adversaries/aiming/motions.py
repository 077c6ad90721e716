"""Motions as trajectories: continued where they end, with headings and speeds, as plans."""

import numpy as np

from deepmf_sumo.adversaries.search.scouting import Motion, Scouted
from deepmf_sumo.datatypes import DT_S, AgentId, Floats, Plan, View
from deepmf_sumo.geometry import angles, boxes
from deepmf_sumo.geometry.ground import distance_m
from deepmf_sumo.geometry.slow import DIRECTION_MPS
from deepmf_sumo.policies.factorization.collision import Levels, footprint
from deepmf_sumo.policies.factorization.tracking import Start, Tracked

_SPAN = 2  # steps on each side of a difference


def continued(motion: Motion, start: Start) -> Floats:
    """(K, 2) positions of a motion; straight on at the last speed where it is not valid.

    Gaps in between are filled linearly. ``start`` is the state before the first step.
    """
    steps = len(motion.valid)
    there = np.flatnonzero(motion.valid)
    known = np.concatenate([[-1], there])
    points = np.concatenate([start.position_m[None], motion.position_m[there]])
    every = np.arange(steps)
    filled = np.stack([np.interp(every, known, points[:, axis]) for axis in (0, 1)], -1)
    last = known[-1]
    heading = motion.heading_rad[last] if len(there) else start.course_rad
    speed = motion.speed_mps[last] if len(there) else start.speed_mps
    beyond = np.maximum(every - last, 0)[:, None] * DT_S * speed
    path: Floats = filled + beyond * angles.unit(heading)
    return path


def headings(position_m: Floats, start: Start) -> Floats:
    """(K) directions of motion of positions (K, 2); where it stands, the heading before."""
    points = np.concatenate([start.position_m[None], position_m])
    last = len(points) - 1
    steps = np.arange(1, last + 1)
    low, high = np.maximum(steps - _SPAN, 0), np.minimum(steps + _SPAN, last)
    moved = points[high] - points[low]
    moving = np.hypot(*moved.T) > DIRECTION_MPS * DT_S * (high - low)
    course = np.concatenate([[start.heading_rad], np.arctan2(moved[:, 1], moved[:, 0])])
    valid = np.maximum.accumulate(np.where(moving, steps, 0))
    heading: Floats = course[valid]
    return heading


def plan_along(view: View, agent_id: AgentId, position_m: Floats) -> Plan:
    """A plan through positions (K, 2), one a step; the box points where it moves to."""
    start = Start.of(view, agent_id)
    moved = np.diff(np.concatenate([start.position_m[None], position_m]), axis=0)
    return Plan(
        agent_id=agent_id,
        first_step=view.step + 1,
        position_m=position_m,
        heading_rad=headings(position_m, start),
        speed_mps=np.hypot(*moved.T) / DT_S,
    )


def plan_of(view: View, agent_id: AgentId, tracked: Tracked, row: int) -> Plan:
    """One of M drivable futures as a plan."""
    return Plan(
        agent_id=agent_id,
        first_step=view.step + 1,
        position_m=tracked.position_m[row],
        heading_rad=tracked.heading_rad[row],
        speed_mps=tracked.speed_mps[row],
    )


def gaps(scouted: Scouted, av: Motion, position_m: Floats, heading_rad: Floats) -> Floats:
    """(M, K) gaps of the boxes between the AV and M trajectories (M, F, 2); inf without the AV.

    K steps are those that both have.
    """
    view = scouted.view
    steps = min(position_m.shape[1], len(av.valid))
    gap = boxes.gap(
        position_m[:, :steps],
        heading_rad[:, :steps],
        footprint(view, scouted.opponent_id),
        av.position_m[:steps],
        av.heading_rad[:steps],
        footprint(view, view.av_id),
    )
    levels = Levels.of(view, scouted.opponent_id)
    if levels is not None:
        own_z, av_z = levels.opponent_z_m(position_m), levels.av_z_m(av.position_m[None])
        gap = distance_m(gap, own_z[:, :steps], av_z[:, :steps])
    apart: Floats = np.where(av.valid[:steps], gap, np.inf)
    return apart
