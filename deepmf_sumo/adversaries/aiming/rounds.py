"""Rounds of aiming and driving: scout, aim at the AV's rollouts, drive, look, aim again.

The first round aims at the AV's un-attacked rollout, each further one also knows how the AV
answered the attacks before. A round costs one simulation, scouting another.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from deepmf_sumo.adversaries.base import Simulate
from deepmf_sumo.adversaries.search.cost import nearest_m
from deepmf_sumo.adversaries.search.planned import Planned
from deepmf_sumo.adversaries.search.scouting import Choose, Motion, Scouted, motion_of, scout
from deepmf_sumo.adversaries.search.spending import Spending
from deepmf_sumo.datatypes import Attack, Budget, Case, Plan, Rollout, Trial


@dataclass(frozen=True, slots=True, kw_only=True)
class Aimed:
    """A trajectory, and the numbers that describe how it was found."""

    plan: Plan
    parameters: dict[str, float]


Aim = Callable[[Scouted, Sequence[Motion]], Aimed]
"""Aims at the AV's rollouts so far, the un-attacked one first."""


def attack_in_rounds(
    case: Case, simulate: Simulate, choose: Choose, aim: Aim, rounds: int, budget: Budget
) -> Attack:
    """Aim and drive until the AV is hit or the budget is spent; the best attack is kept.

    The best is the one that hits, else the one that comes nearest. ``rounds`` count where the
    budget says nothing; at least one attack is driven, so that two simulations are the least. An
    objective is minus the least gap in metres. ``generation_s`` is `Spending.generation_s`.
    """
    spending = Spending(simulate, budget, 1 + rounds)
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
        spending.look_at_the_clock()  # aiming stops at the same time
        rollout = spending.simulate(Planned(aimed.plan))
        attacks.append(rollout)
        trials.append(Trial(parameters=aimed.parameters, objective=0.0 - nearest_m(rollout)))
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
