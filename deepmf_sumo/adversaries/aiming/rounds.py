"""Rounds of aiming and driving: scout, aim at the AV's rollouts, drive, look, aim again.

The first round aims at the AV's un-attacked rollout, each further one also knows how the AV
answered the attacks before. A round costs one simulation, scouting another.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from deepmf_sumo.adversaries.base import Simulate
from deepmf_sumo.adversaries.search.planned import Planned
from deepmf_sumo.adversaries.search.scouting import Choose, Motion, Scouted, motion_of, scout
from deepmf_sumo.adversaries.search.spending import Spending
from deepmf_sumo.datatypes import Attack, Budget, Case, Plan, Rollout, Trial
from deepmf_sumo.geometry import boxes


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
    objective is minus the least gap in metres. ``generation_s`` leaves out the episode of the
    attack where there is only one, for nothing depends on it.
    """
    spending = Spending(simulate, budget, 1 + rounds)
    scouted = scout(case, spending.simulate, choose)
    if scouted is None:
        spent = spending.seconds
        return Attack(rollout=spending.simulate(None), simulations=2, generation_s=spent)
    answers = [scouted.av]
    attacks: list[Rollout] = []
    trials: list[Trial] = []
    while True:
        aimed = aim(scouted, answers)
        planned_s = spending.seconds
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
        generation_s=planned_s if len(attacks) == 1 else spending.seconds,
    )


def nearest_m(rollout: Rollout) -> float:
    """Least gap between the boxes of AV and opponent from now on; 0 at a contact."""
    tracks = rollout.tracks
    assert rollout.opponent_id is not None
    av, own = tracks.row(rollout.av_id), tracks.row(rollout.opponent_id)
    together = tracks.valid[av] & tracks.valid[own]
    together[: rollout.now] = False
    gap = boxes.gap(
        tracks.position_m[av, together],
        tracks.heading_rad[av, together],
        tracks.size_m[av, :2],
        tracks.position_m[own, together],
        tracks.heading_rad[own, together],
        tracks.size_m[own, :2],
    )
    return float(gap.min())
