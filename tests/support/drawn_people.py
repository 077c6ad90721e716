"""Hits by people, drawn by hand: an AV that drives east, a person, and what stands beside."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from deepmf_sumo.judge.metrics import Episode
from deepmf_sumo.scene import View
from deepmf_sumo.scene.geometry import boxes
from deepmf_sumo.scene.road_users import ROAD_USERS

from tests.support.predictor_doubles import straight_road
from tests.support.rollout_doubles import case_of, contact_of, in_traffic, rollout_of

STEPS, NOW = 91, 10
CAR = (4.8, 2.0, 1.5)
WALKER = (0.5, 0.5, 1.75)
TRUCK = ROAD_USERS["truck"].size_m


class Drawn(NamedTuple):
    """A road user: (T, 3) poses, its kind, and length, width and height."""

    path: np.ndarray
    kind: str = "pedestrian"
    size_m: tuple[float, float, float] = WALKER


def stands(x, y, heading=0.0):
    """(T, 3) poses of what stands."""
    return np.tile([x, y, heading], (STEPS, 1)).astype(float)


def walks(x, y, *parts, heading=np.pi / 2, begin=NOW):
    """(T, 3) of a person at x, y until a step; parts: (seconds, speed), the last goes on."""
    speed = np.zeros(STEPS)
    at = begin
    for seconds, mps in parts:
        speed[at + 1 :] = mps
        at += round(10 * seconds)
    along = np.cumsum(speed * 0.1)
    pose = np.stack([x + along * np.cos(heading), y + along * np.sin(heading)], -1)
    return np.concatenate([pose, np.full((STEPS, 1), heading)], axis=1)


def episode(av, person, others=(), road=None, alone=None):
    """The episode in SUMO's own traffic up to the contact of AV and person ``b``.

    ``alone``: (T, 3) poses of the person without the attack; by default it stands where it was.
    """
    boxes_of = [av[:, :2], av[:, 2], np.array(CAR[:2])]
    theirs = [person.path[:, :2], person.path[:, 2], np.array(person.size_m[:2])]
    hit = np.flatnonzero(boxes.overlap(*boxes_of, *theirs))
    stop = int(hit[0]) + 1 if len(hit) else STEPS
    contacts = []
    if len(hit):
        at = int(hit[0])
        poses = {"pose_first": av[at], "pose_second": person.path[at]}
        speeds = [(one[at] - one[at - 1])[:2] / 0.1 for one in (av, person.path)]
        apart = float(np.hypot(*(speeds[1] - speeds[0])))
        area = person.size_m[0] * person.size_m[1]
        gained = apart * area / (area + CAR[0] * CAR[1])
        found = replace(contact_of(step=at), relative_mps=apart, delta_v_mps=gained)
        contacts = [replace(found, **poses)]
    everyone = {"av": Drawn(av, "vehicle", CAR), "b": person}
    everyone |= {f"o{number}": one for number, one in enumerate(others)}
    cut = {name: one.path[:stop] for name, one in everyone.items()}
    rollout = rollout_of(cut, contacts=contacts)
    kinds = tuple(one.kind for one in everyone.values())
    sizes = np.array([one.size_m for one in everyone.values()], float)
    rollout = replace(rollout, tracks=replace(rollout.tracks, kinds=kinds, size_m=sizes))
    whole = {name: one.path for name, one in everyone.items()}
    before = stands(*person.path[NOW]) if alone is None else alone
    without = case_of({**whole, "b": before}).scene.tracks
    case = replace(in_traffic(case_of()), road=road or straight_road(), unattacked=without)
    return Episode(rollout, case)


def view_at(found, step):
    """What a policy sees at a step of an episode: the last second."""
    rollout = found.rollout
    return View(
        step=step,
        dt_s=0.1,
        av_id="av",
        history=rollout.tracks.window(max(step - 10, 0), step + 1),
        road=found.case.road,
        signals={},
        steps_left=STEPS - 1 - step,
    )


def _runner_from_behind_a_truck():
    person = Drawn(walks(40.0, -7.7, (9, 3.0)))
    return episode(
        np.concatenate([np.arange(STEPS)[:, None] * 0.4, np.zeros((STEPS, 2))], 1),
        person,
        [Drawn(stands(33.4, -4.1), "vehicle", TRUCK)],
    )


STREET_VIEW = _runner_from_behind_a_truck()
"""An AV at 4 m/s, a runner from behind a parked truck far ahead; they do not meet."""
