"""Attacks aimed at the AV's earlier rollouts, round by round: `art`, `cat`, `king`, ...

The first round aims at the AV's unattacked rollout; each further round also knows the AV's
rollouts under the attacks before. A round costs one simulation, the unattacked rollout another.

The rollouts stand for what the AV may do: `score` compares candidates of the opponent with them.
With P_j the weight of candidate j, P_k that of rollout k, and CAT's decay of 0.99 per half second:

    value_j = P_j * sum_k P_k * 0.99^(1 + first contact of j and k in half seconds)

If no candidate touches a rollout, the candidate whose centre comes closest to the AV's is chosen.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from deepmf_sumo.attacks._episodes import (
    AgentMotion,
    BudgetMeter,
    Choose,
    LimitedSettings,
    OpponentChoice,
    Planned,
    Scouted,
    motion_of,
    nearest_m,
    scout,
)
from deepmf_sumo.attacks.base import Simulate
from deepmf_sumo.deepmf.candidates import collisions
from deepmf_sumo.deepmf.situation import Levels, footprint
from deepmf_sumo.deepmf.tracking import Start
from deepmf_sumo.scene import (
    DT_S,
    FUTURE_STEPS,
    AgentId,
    Attack,
    Bools,
    Budget,
    Case,
    Floats,
    Forecast,
    Futures,
    Plan,
    Rollout,
    Trial,
    View,
)
from deepmf_sumo.scene.geometry import boxes, frames
from deepmf_sumo.scene.geometry.ground import distance_m
from deepmf_sumo.scene.geometry.slow import DIRECTION_MPS


def curve_into(start_m: Floats, own_m: Floats, av_m: Floats, meeting_steps: int) -> Floats:
    """(K, 2) a curve that reaches the AV at the meeting step and then follows its path.

    Control points are the opponent's position now and after a third of the time, the AV's after
    two thirds and at the meeting. ``start_m`` (2) is now; ``own_m`` and ``av_m`` (K, 2) are the
    unattacked paths of both from the next step on; ``meeting_steps`` lies in 1..K. The curve's
    parameter is proportional to time.
    """
    third = max(meeting_steps // 3, 1)
    control = np.stack(
        [start_m, own_m[third - 1], av_m[meeting_steps - third - 1], av_m[meeting_steps - 1]]
    )
    share = np.arange(1, meeting_steps + 1)[:, None] / meeting_steps
    rest = 1 - share
    weight = np.concatenate([rest**3, 3 * rest**2 * share, 3 * rest * share**2, share**3], axis=1)
    return np.concatenate([weight @ control, av_m[meeting_steps:]])


_SPAN = 2  # steps on each side of a difference


def continued(motion: AgentMotion, start: Start) -> Floats:
    """(K, 2) positions of a motion, continued straight at the last speed after its end.

    Gaps are filled linearly. ``start`` is the state before the first step.
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
    path: Floats = filled + beyond * frames.unit(heading)
    return path


def headings(position_m: Floats, start: Start) -> Floats:
    """(K) headings of a vehicle at positions (K, 2): along its motion, as before at a standstill.

    Where the motion turns by more than a right angle within a step the vehicle backs up.
    """
    points = np.concatenate([start.position_m[None], position_m])
    last = len(points) - 1
    steps = np.arange(1, last + 1)
    low, high = np.maximum(steps - _SPAN, 0), np.minimum(steps + _SPAN, last)
    moved = points[high] - points[low]
    moving = np.hypot(*moved.T) > DIRECTION_MPS * DT_S * (high - low)
    course = np.concatenate([[start.heading_rad], np.arctan2(moved[:, 1], moved[:, 0])])
    valid = np.maximum.accumulate(np.where(moving, steps, 0))
    along = np.concatenate([course[:1], course[valid]])
    backs_up = np.cumsum(np.cos(np.diff(along)) < 0) % 2
    heading: Floats = np.where(backs_up, frames.wrap(along[1:] + np.pi), along[1:])
    return heading


def plan_along(view: View, agent_id: AgentId, position_m: Floats) -> Plan:
    """A plan through positions (K, 2), one per step, with headings along the motion."""
    start = Start.of(view, agent_id)
    moved = np.diff(np.concatenate([start.position_m[None], position_m]), axis=0)
    return Plan(
        agent_id=agent_id,
        first_step=view.step + 1,
        position_m=position_m,
        heading_rad=headings(position_m, start),
        speed_mps=np.hypot(*moved.T) / DT_S,
    )


def gaps(scouted: Scouted, av: AgentMotion, position_m: Floats, heading_rad: Floats) -> Floats:
    """(M, K) gaps of the boxes between the AV and M trajectories (M, F, 2); inf without the AV.

    K: steps that both have.
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


_DECAY = 0.99
_DECAY_STEPS = 5  # CAT looks at every fifth step


@dataclass(frozen=True, slots=True, kw_only=True)
class Answers:
    """N2 rollouts of the AV, equally likely.

    Attributes:
        forecast: (N2, 80) poses; continued straight after the AV has left.
        there: (N2, 80) False after the AV has left.
    """

    forecast: Forecast
    there: Bools

    def lasts(self, row: int) -> int:
        """Steps until the AV leaves for good in a rollout."""
        there = np.flatnonzero(self.there[row])
        return int(there[-1]) + 1 if len(there) else 0

    @classmethod
    def of(cls, view: View, rollouts: Sequence[AgentMotion]) -> "Answers":
        """The AV's rollouts from the view on."""
        start = Start.of(view, view.av_id)
        paths = [_lengthened(continued(rollout, start)) for rollout in rollouts]
        there = np.zeros((len(rollouts), FUTURE_STEPS), dtype=bool)
        heading = np.stack([headings(path, start) for path in paths])
        for row, rollout in enumerate(rollouts):
            steps = min(len(rollout.valid), FUTURE_STEPS)
            there[row, :steps] = rollout.valid[:steps]
            known = there[row, :steps]
            heading[row, :steps][known] = rollout.heading_rad[:steps][known]
        futures = Futures(agent_id=view.av_id, position_m=np.stack(paths), heading_rad=heading)
        share = np.full(len(rollouts), 1.0 / len(rollouts))
        return cls(forecast=Forecast(futures=futures, probability=share), there=there)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scored:
    """Candidates against rollouts.

    Attributes:
        collides, collision_step: (N1, N2) as from `candidates.collisions`.
        value: (N1) see above. chosen: the best. fallback: no candidate touches a rollout.
    """

    collides: Bools
    collision_step: Floats
    value: Floats
    chosen: int
    fallback: bool


def flattened(probability: Floats, kept: int) -> Floats:
    """(N1) weights, likeliest first, whose entries after the ``kept`` first weigh as the next.

    CAT's: unlikely candidates differ no more, so that one of them is chosen where it alone hits.
    """
    weight = np.array(probability)
    if kept < len(weight):
        weight[kept:] = weight[kept]
    share: Floats = weight / weight.sum()
    return share


def score(weight: Floats, candidates: Futures, answers: Answers, view: View) -> Scored:
    """Score candidates (N1) with weights (N1) against the rollouts, within the time left."""
    horizon, levels = min(FUTURE_STEPS, view.steps_left), Levels.of(view, candidates.agent_id)
    share = answers.forecast.probability
    # Rollouts end at different times: each is compared separately, up to its end.
    rows = [
        collisions(
            candidates,
            [_one(answers.forecast, row)] * len(weight),
            footprint(view, candidates.agent_id),
            footprint(view, view.av_id),
            min(horizon, answers.lasts(row)),
            levels,
        )
        for row in range(len(share))
    ]
    collides = np.concatenate([hit for hit, _ in rows], axis=1)
    first = np.concatenate([step for _, step in rows], axis=1)
    early = np.where(collides, _DECAY ** (1 + first // _DECAY_STEPS), 0.0)
    value = weight * (early @ share)
    if collides.any():
        return Scored(
            collides=collides, collision_step=first, value=value,
            chosen=int(value.argmax()), fallback=False,
        )  # fmt: skip
    distance = _nearest_m(candidates, answers, horizon)
    return Scored(
        collides=collides, collision_step=first, value=-distance,
        chosen=int(distance.argmin()), fallback=True,
    )  # fmt: skip


def _nearest_m(candidates: Futures, answers: Answers, horizon: int) -> Floats:
    """(N1) least distance of the centres over all rollouts."""
    other = answers.forecast.futures.position_m
    offset = candidates.position_m[:, None, :horizon] - other[None, :, :horizon]
    apart = np.where(answers.there[:, :horizon], np.hypot(offset[..., 0], offset[..., 1]), np.inf)
    nearest: Floats = apart.min(axis=(1, 2))
    return nearest


def _one(forecast: Forecast, row: int) -> Forecast:
    futures = forecast.futures
    return Forecast(
        futures=Futures(
            agent_id=futures.agent_id,
            position_m=futures.position_m[row : row + 1],
            heading_rad=futures.heading_rad[row : row + 1],
        ),
        probability=np.ones(1),
    )


def _lengthened(path_m: Floats) -> Floats:
    """(80, 2) a path (K, 2), cut, or standing at its last point."""
    cut = path_m[:FUTURE_STEPS]
    return np.concatenate([cut, np.repeat(cut[-1:], FUTURE_STEPS - len(cut), axis=0)])


@dataclass(frozen=True, slots=True, kw_only=True)
class Aimed:
    """A trajectory, and numbers that describe how it was found."""

    plan: Plan
    parameters: dict[str, float]


Aim = Callable[[Scouted, Sequence[AgentMotion]], Aimed]
"""Aims at the AV's rollouts so far, the unattacked one first."""


def attack_in_rounds(
    case: Case, simulate: Simulate, choose: Choose, aim: Aim, rounds: int, budget: Budget
) -> Attack:
    """Aim and drive until the AV is hit or the budget is used up; returns the best attack.

    The best attack is the one that hits, else the one that comes closest. ``rounds`` is the limit
    if the budget has none; at least one attack is driven, so the minimum is two simulations. The
    objective is minus the smallest gap in metres. ``generation_s`` is `BudgetMeter.generation_s`.
    """
    spending = BudgetMeter(simulate, budget, 1 + rounds)
    scouted = scout(case, spending.simulate, choose)
    if scouted is None:
        return Attack(
            rollout=spending.unattacked(),
            simulations=spending.simulations,
            generation_s=spending.generation_s,
        )
    answers = [scouted.av]
    attacks: list[Rollout] = []
    trials: list[Trial] = []
    while True:
        aimed = aim(scouted, answers)
        spending.check_time()  # aiming stops at the same time
        rollout = spending.simulate(Planned(aimed.plan))
        attacks.append(rollout)
        trials.append(Trial(values=aimed.parameters, objective=0.0 - nearest_m(rollout)))
        if rollout.first("av_opponent") or spending.over:
            break
        answers.append(motion_of(rollout, case.av_id, case.duration_steps))
    best = max(range(len(attacks)), key=lambda number: trials[number].objective)
    return Attack(
        rollout=attacks[best],
        trials=tuple(trials),
        simulations=spending.simulations,
        generation_s=spending.generation_s,
        out_of_time=spending.out_of_time,
    )


class AimedSettings(LimitedSettings):
    """Opponent, its limits, and the number of attacks.

    Attributes:
        rounds: number of attacks, until one hits, if the budget has no limit.
    """

    rounds: int = Field(default=1, ge=1)


class AimedRounds:
    """An adversary that aims at the AV's rollouts, round by round.

    Args:
        settings: opponent and rounds.
        weights: of the network that chooses the opponent.
        aim: aims at the rollouts.
    """

    several = True

    def __init__(self, settings: AimedSettings, weights: str, aim: Aim) -> None:
        self._settings = settings
        self._opponent = OpponentChoice(settings.opponent, weights)
        self._aim = aim

    def load(self) -> None:
        """Load the network that chooses opponents."""
        self._opponent.load()

    def attack(
        self, case: Case, simulate: Simulate, budget: Budget, rng: np.random.Generator
    ) -> Attack:
        """The attack; trials are the rounds."""
        choose, rounds = self._opponent.of(case), self._settings.rounds
        return attack_in_rounds(case, simulate, choose, self._aim, rounds, budget)
