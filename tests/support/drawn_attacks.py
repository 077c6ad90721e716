"""Attacks drawn by hand: two motions, their first contact, and what the plan says after it."""

from dataclasses import replace

import numpy as np

from deepmf_sumo.scene import DT_S, Plan, RoadMap
from deepmf_sumo.scene.geometry import boxes

from tests.support.rollout_doubles import case_of, contact_of, rollout_of

NOW, STEPS = 10, 91
SIZE = np.array([4.8, 2.0])


def attack(av, opponent, others=None, log=None, road=None):
    """Rollout until the first contact of two motions (91, 3) and its case; the plan is the rest.

    ``log`` is what the recording has of the opponent; by default the same, which is no departure.
    """
    hits = boxes.overlap(av[:, :2], av[:, 2], SIZE, opponent[:, :2], opponent[:, 2], SIZE)
    hit = np.flatnonzero(hits)
    stop = hit[0] + 1 if len(hit) else STEPS
    contacts = []
    if len(hit):
        poses = {"pose_first": av[hit[0]], "pose_second": opponent[hit[0]]}
        contacts = [replace(contact_of(step=int(hit[0])), **poses)]
    moved = np.diff(opponent[NOW:, :2], axis=0)
    plan = Plan(
        agent_id="b",
        first_step=NOW + 1,
        position_m=opponent[NOW + 1 :, :2],
        heading_rad=opponent[NOW + 1 :, 2],
        speed_mps=np.hypot(*moved.T) / DT_S,
    )
    paths = {"av": av, "b": opponent, **(others or {})}
    rollout = rollout_of(
        {name: path[:stop] for name, path in paths.items()}, contacts=contacts, plans=[plan]
    )
    case = case_of({**paths, "b": opponent if log is None else log})
    return rollout, case if road is None else replace(case, road=road)


def cut_in(gap_m, speed_mps, left_m=3.5, aside_mps=1.8):
    """A car so far ahead in the lane on the left that moves in from now on: (91, 3)."""
    seconds = (np.arange(STEPS) - NOW) * DT_S
    x = gap_m + SIZE[0] + speed_mps * seconds
    y = np.maximum(left_m - aside_mps * np.maximum(seconds, 0.0), 0.0)
    return np.stack([x, y, np.zeros(STEPS)], -1)


NO_ROAD = RoadMap(lanes={})
