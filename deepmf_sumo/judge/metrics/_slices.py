"""Slices of a rollout for metrics, and the motion in them.

Accelerations and steering are differences over 0.2 s, which keeps noise of a centimetre below
1 m/s2. Boxes of people tremble by several: their accelerations are differences over 0.5 s.
"""

from typing import NamedTuple

import numpy as np

from deepmf_sumo.judge.avoidability.counterfactual import Counterfactual, counterfactual
from deepmf_sumo.judge.metrics import NotMeasurable
from deepmf_sumo.scene import (
    AgentId,
    Bools,
    Case,
    Contact,
    Driver,
    Floats,
    Rollout,
)
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.slow import DIRECTION_MPS

NO_OPPONENT = "no vehicle was attacked"
NEVER_DRIVEN = "the policy never drove the opponent"
NO_COLLISION = "AV and opponent did not collide"
NO_LOG = "the case has no recording to compare with"
NO_REFERENCE = "the opponent's motion without the attack is not known"
TOO_SHORT = "fewer than three steps with both a planned pose and one without the attack"
SPAN = 2
"""Steps on each side of a second difference."""
SPAN_OF_PEOPLE = 5
"""The same for pedestrians and cyclists."""


def opponent_row(rollout: Rollout) -> int:
    """Row of the opponent in the tracks. Raises NotMeasurable if there was no attack."""
    if rollout.opponent_id is None or rollout.opponent_id not in rollout.tracks.ids:
        raise NotMeasurable(NO_OPPONENT)
    return rollout.tracks.row(rollout.opponent_id)


def collision(rollout: Rollout) -> Contact:
    """The first contact of AV and opponent. Raises NotMeasurable if there is none."""
    contact = rollout.first("av_opponent")
    if contact is None:
        raise NotMeasurable(NO_COLLISION)
    return contact


def driven(rollout: Rollout, row: int) -> Bools:
    """(T) steps after the current one at which the policy drove the agent, or no driver did yet."""
    mask: Bools = (rollout.driver[row] == Driver.POLICY) & rollout.tracks.valid[row]
    return mask & (np.arange(rollout.tracks.steps) > rollout.now)


class Driving(NamedTuple):
    """Row of the opponent, and (T) steps after the current one at which the policy drove it."""

    row: int
    steps: Bools


def driving(rollout: Rollout) -> Driving:
    """The steps in which the policy drove the opponent. Raises NotMeasurable if there are none."""
    row = opponent_row(rollout)
    steps = driven(rollout, row)
    if not steps.any():
        raise NotMeasurable(NEVER_DRIVEN)
    return Driving(row, steps)


def places(rollout: Rollout, at: tuple[int, Bools]) -> tuple[Floats, Floats]:
    """(N, 2) box centres and (N) heights of an agent's row at the steps of a mask (T)."""
    row, steps = at
    return rollout.tracks.position_m[row, steps], rollout.tracks.z_m[row, steps]


def together(rollout: Rollout, row: int) -> tuple[int, Bools]:
    """Row of the AV, and (T) steps after the current one at which it and the agent are present."""
    av = rollout.tracks.row(rollout.av_id)
    both = rollout.tracks.valid[av] & rollout.tracks.valid[row]
    return av, both & (np.arange(rollout.tracks.steps) > rollout.now)


class Stretch(NamedTuple):
    """Positions (K, 2) of the opponent at K successive steps: of the attack, and without it."""

    attack_m: Floats
    unattacked_m: Floats


def compared_stretches(rollout: Rollout, case: Case, *, beyond: bool) -> list[Stretch]:
    """The opponent with and without the attack, over the steps that both have.

    Without the attack it moves as `unattacked` has it; most logs end early. The attack is what the
    policy drove; ``beyond`` the end of the episode, which is the contact, its last plan continues,
    up to the case's duration. Raises NotMeasurable without an opponent or its motion without the
    attack, or if the policy never drove.
    """
    row = opponent_row(rollout)
    reference = unattacked(rollout, case, rollout.tracks.ids[row])
    if not driven(rollout, row).any():
        raise NotMeasurable(NEVER_DRIVEN)
    last = rollout.now + case.duration_steps
    attack = planned_poses(rollout, row, last if beyond else rollout.tracks.steps - 1)
    shared = np.zeros(len(reference.known), bool)
    shared[[step for step in attack if step < len(shared)]] = True
    return [
        Stretch(
            np.array([attack[step] for step in range(run.start, run.stop)]),
            reference.position_m[run],
        )
        for run in runs(shared & reference.known)
    ]


def planned_poses(rollout: Rollout, row: int, last: int) -> dict[int, Floats]:
    """(2) positions by step up to ``last``: driven ones, then those of the last plan."""
    steps = np.flatnonzero(driven(rollout, row)).tolist()
    found = {step: rollout.tracks.position_m[row, step] for step in steps if step <= last}
    plans = rollout.plans_of(rollout.tracks.ids[row])
    if steps and plans:
        plan = plans[-1]
        end = plan.first_step + len(plan.position_m)
        for step in range(max(steps[-1] + 1, plan.first_step), min(end, last + 1)):
            found[step] = plan.position_m[step - plan.first_step]
    return found


def unattacked(rollout: Rollout, case: Case, agent_id: AgentId) -> Counterfactual:
    """The agent's motion without the attack (`avoidability.counterfactual`).

    Raises NotMeasurable where the agent is only taken to keep lane and speed, and where it would
    have been absent after now, within the case's duration.
    """
    found = counterfactual(rollout, case, agent_id)
    steps = slice(rollout.now + 1, rollout.now + 1 + case.duration_steps)
    if found.by == "lane" or not found.known[steps].any():
        raise NotMeasurable(NO_REFERENCE)
    return found


class Accelerations(NamedTuple):
    """(K) accelerations along and across the direction of motion, in m/s2."""

    along: Floats
    across: Floats


def accelerations(
    position_m: Floats, heading_rad: Floats, dt_s: float, steps: int = SPAN
) -> Accelerations:
    """Second differences of box centres (T, 2) over some steps on each side; K = T - 2 * steps.

    Empty for fewer poses. The direction is that of the motion, below 0.5 m/s the heading.
    """
    position = np.asarray(position_m, float)
    if len(position) <= 2 * steps:
        return Accelerations(np.empty(0), np.empty(0))
    span = steps * dt_s
    before, here, after = position[: -2 * steps], position[steps:-steps], position[2 * steps :]
    second = (after - 2 * here + before) / span**2
    velocity = (after - before) / (2 * span)
    course = np.where(
        np.hypot(*velocity.T) > DIRECTION_MPS,
        np.arctan2(velocity[:, 1], velocity[:, 0]),
        np.asarray(heading_rad, float)[steps:-steps],
    )
    ahead = frames.unit(course)
    along = (second * ahead).sum(-1)
    across = ahead[:, 0] * second[:, 1] - ahead[:, 1] * second[:, 0]
    return Accelerations(along, across)


class Steering(NamedTuple):
    """(K) motion of boxes over 0.4 s; ``sideways`` is the sine of heading to motion, unsigned."""

    speed_mps: Floats
    distance_m: Floats
    turn_rad: Floats
    sideways: Floats


def steering(position_m: Floats, heading_rad: Floats, dt_s: float) -> Steering:
    """Of box centres (T, 2) and headings (T); K = T - 4, empty for fewer than 5 poses."""
    position, heading = np.asarray(position_m, float), np.asarray(heading_rad, float)
    if len(position) <= 2 * SPAN:
        return Steering(*(np.empty(0) for _ in Steering._fields))
    moved = position[2 * SPAN :] - position[: -2 * SPAN]
    distance = np.hypot(*moved.T)
    course = np.arctan2(moved[:, 1], moved[:, 0])
    return Steering(
        speed_mps=distance / (2 * SPAN * dt_s),
        distance_m=distance,
        turn_rad=np.abs(frames.difference(heading[2 * SPAN :], heading[: -2 * SPAN])),
        sideways=np.abs(np.sin(course - heading[SPAN:-SPAN])),
    )


def runs(mask: Bools) -> list[slice]:
    """Uninterrupted stretches of a mask (T)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [slice(int(first), int(end)) for first, end in edges.reshape(-1, 2)]
