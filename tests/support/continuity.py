"""The invariant of every rollout: no road user jumps, whoever drives it and whoever takes it over.

`violations` is written from what a rollout says alone: positions, headings and speeds of two
consecutive steps, and who drove. `tests/conftest.py` asks it for every rollout that a test makes.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from deepmf_sumo.datatypes import Driver, Rollout

DT_S = 0.1
FASTER = 1.15
"""A box turns about its rear axle, so its centre may be faster than the speed of SUMO's front."""
SLACK_M = 0.35
"""Ballistic steps of SUMO, and a commanded speed that holds from the middle of a step on: up to
half of 7 m/s2 in a step, and the noise of recorded positions."""
ASIDE_M = 0.3
"""A lane change that is shown over 3 s moves 3.7 m by at most 0.13 m a step; a hand-over to SUMO
leaves 0.1 m; the rest is noise of recordings."""
SLIP = 0.4
"""Sine of the angle between course and heading of the middle of a car in its narrowest turn."""
TURN_RAD = 0.15
TURN_PER_M = 0.35
"""The curvature of SUMO's narrowest turns, and a hand-over's 0.1 rad."""
LANE_M = 4.5
"""SUMO without its sublane model moves its own vehicles to the next lane within one step."""
OWN_MOVES = {int(Driver.SUMO)}
TELEPORTS = {"av_teleported", "teleported"}
"""Events by which a rollout says that SUMO moved a vehicle."""

_expected: list[str] = []


@contextmanager
def jumps_expected(reason: str) -> Iterator[None]:
    """Rollouts made here may jump: what a test commands is no motion."""
    _expected.append(reason)
    try:
        yield
    finally:
        _expected.pop()


def violations(rollout: Rollout) -> list[str]:
    """What jumps in a rollout, one sentence each; the recording's own steps are not judged."""
    tracks, driver = rollout.tracks, rollout.driver
    if _expected or tracks.steps < 2:
        return []
    both = tracks.valid[:, 1:] & tracks.valid[:, :-1]
    both &= (driver[:, 1:] != Driver.LOG) | (driver[:, :-1] != Driver.LOG)
    both[:, : rollout.now] = False
    moved = np.diff(tracks.position_m, axis=1)
    speed = np.hypot(*np.moveaxis(tracks.velocity_mps, -1, 0))
    fastest = np.maximum(speed[:, 1:], speed[:, :-1])
    turn = np.diff(tracks.heading_rad, axis=1)
    turn = np.abs((turn + np.pi) % (2 * np.pi) - np.pi)
    sumos = np.isin(driver[:, 1:], list(OWN_MOVES)) & np.isin(driver[:, :-1], list(OWN_MOVES))
    middle = (
        tracks.heading_rad[:, :-1]
        + (np.diff(tracks.heading_rad, axis=1) + np.pi) % (2 * np.pi) / 2
        - np.pi / 2
    )
    aside = np.abs(moved[..., 1] * np.cos(middle) - moved[..., 0] * np.sin(middle))
    far = np.hypot(*np.moveaxis(moved, -1, 0))
    way = FASTER * fastest * DT_S
    found = {
        "moves": (far, np.where(sumos, LANE_M, SLACK_M) + way),
        "moves sideways by": (aside, np.where(sumos, LANE_M, ASIDE_M) + SLIP * fastest * DT_S),
        "turns by": (turn, np.where(sumos, np.pi, TURN_RAD) + TURN_PER_M * fastest * DT_S),
    }
    told = {(one.agent_id, one.step) for one in rollout.events if one.kind in TELEPORTS}
    sentences = []
    for what, (value, most) in found.items():
        for row, at in zip(*np.nonzero(both & (value > most)), strict=True):
            agent, step = tracks.ids[row], int(at) + 1
            if (agent, step) not in told:
                owners = [Driver(int(driver[row, one])).name for one in (at, at + 1)]
                sentences.append(
                    f"{agent} {what} {value[row, at]:.2f} in the step to {step} "
                    f"({' -> '.join(owners)}, {fastest[row, at]:.1f} m/s)"
                )
    changed = {
        (tracks.ids[row], int(at) + 1)
        for row, at in zip(*np.nonzero(driver[:, 1:] != driver[:, :-1]), strict=True)
    }
    sentences += [
        f"a contact {one.kind} counts at {one.step}, where {agent} changes its owner"
        for one in rollout.contacts
        for agent in (one.first_id, one.second_id)
        if (agent, one.step) in changed
    ]
    return sentences
