"""Pairs of candidates and reactions, and what narrows the choice: sector, fair, lawful.

A user may wish which side of the AV is hit, and that the contact can be avoided. Wishes narrow the
colliding pairs that count. Where no pair is left the plan goes on without the wish, or without an
attack, and says so: see `choose`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from deepmf_sumo.avoidability.av_path import State
from deepmf_sumo.avoidability.grading import avoidable
from deepmf_sumo.datatypes import (
    FUTURE_STEPS,
    AgentId,
    Bools,
    Floats,
    Forecast,
    Futures,
    Ints,
    View,
)
from deepmf_sumo.deepmf import scoring
from deepmf_sumo.deepmf.candidates import (
    Candidates,
    Levels,
    Stopwatch,
    collisions,
    delta_v,
    footprint,
    impact_sectors,
)
from deepmf_sumo.deepmf.scoring import Balance, Choice, Rule
from deepmf_sumo.deepmf.settings import Settings
from deepmf_sumo.deepmf.traffic_rules import Law
from deepmf_sumo.geometry import polylines

_REFUSALS = 12  # a candidate that is verified costs some milliseconds
ANY_SECTOR: Final = ", any sector"
"""What the rule ends with where no pair touches the AV in the wanted sector."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pairs:
    """N1 candidates with P_j and N2 reactions each with P_jk, and how they collide.

    Attributes:
        probability: (N1). reaction_probability, collides, collision_step: (N1, N2).
        sector: (N1, N2) in which the AV is hit; None where no sector is wanted.
        fair: (N1) a competent driver could avoid the candidate; None where that is not asked for.
        lawful: (N1) the candidate breaks no rule of the road; None where that is not asked for.
        severity: (N1, N2) delta-v of the AV; None where nothing depends on it.
    """

    probability: Floats
    reaction_probability: Floats
    collides: Bools
    collision_step: Floats
    sector: Ints | None = None
    fair: Bools | None = None
    lawful: Bools | None = None
    severity: Floats | None = None

    def among(self, rows: Ints) -> "Pairs":
        """Only these candidates (K), all of them lawful."""
        return Pairs(
            probability=self.probability[rows],
            reaction_probability=self.reaction_probability[rows],
            collides=self.collides[rows],
            collision_step=self.collision_step[rows],
            sector=None if self.sector is None else self.sector[rows],
            fair=None if self.fair is None else self.fair[rows],
            severity=None if self.severity is None else self.severity[rows],
        )


Decision = tuple[Pairs, Choice, tuple[str, ...]]
"""The pairs with what was found unfair on the way, the choice, the wishes that are unmet."""


def decide(
    pairs: Pairs,
    rule: Rule | Balance,
    likelihood_weight: float,
    wanted_sector: int | None,
    verify: Callable[[int], bool],
    rng: np.random.Generator | None = None,
) -> Decision:
    """`choose`, until the chosen one is fair on a closer look: ``verify`` of its row.

    After 12 refusals nothing is fair. Without the wish nothing is verified.
    """
    choice, unmet = choose(pairs, rule, likelihood_weight, wanted_sector, rng)
    refused = 0
    given_up = {"fair", "lawful"}
    while pairs.fair is not None and not given_up & {*unmet} and not verify(choice.index):
        refused += 1
        others = np.arange(len(pairs.fair)) != choice.index
        pairs = replace(pairs, fair=pairs.fair & others & (refused < _REFUSALS))
        choice, unmet = choose(pairs, rule, likelihood_weight, wanted_sector, rng)
    return pairs, choice, unmet


def choose(
    pairs: Pairs,
    rule: Rule | Balance,
    likelihood_weight: float,
    wanted_sector: int | None,
    rng: np.random.Generator | None = None,
) -> tuple[Choice, tuple[str, ...]]:
    """The choice by the pairs that count, and the wishes that no candidate meets.

    - Of the pairs that hit the wanted sector those count first whose candidate hits it more likely
      than other sectors, for a contact elsewhere ends the attack.
    - No pair hits the wanted sector: all sectors count; the rule ends with ``, any sector``.
    - Pairs collide, but no lawful or no fair ones: no attack (`scoring.harmless`), rule
      ``nothing lawful`` or ``nothing fair``. What is unlawful is driven only where nothing is
      lawful.
    """
    if pairs.lawful is not None:
        return _choose_lawful(pairs, pairs.lawful, rule, likelihood_weight, wanted_sector, rng)
    counted, barred, unmet = pairs.collides, None, []
    if pairs.fair is not None:
        counted = counted & pairs.fair[:, None]
        barred = pairs.collides.any(axis=1) & ~pairs.fair
        if pairs.collides.any() and not counted.any():
            return _harmless(pairs), ("fair",)
    if pairs.sector is not None:
        there = counted & (pairs.sector == wanted_sector)
        unmet = [] if there.any() else ["sector"]
        counted = _mostly(there, pairs) if there.any() else counted
    choice = scoring.choose(
        pairs.probability,
        pairs.reaction_probability,
        pairs.collides,
        pairs.collision_step,
        rule,
        likelihood_weight,
        counted=counted,
        barred=barred,
        severity=pairs.severity,
        rng=rng,
    )
    if unmet and counted.any():
        choice = replace(choice, rule=choice.rule + ANY_SECTOR)
    return choice, tuple(unmet)


def _choose_lawful(
    pairs: Pairs,
    lawful: Bools,
    rule: Rule | Balance,
    likelihood_weight: float,
    wanted_sector: int | None,
    rng: np.random.Generator | None,
) -> tuple[Choice, tuple[str, ...]]:
    """The choice among the lawful candidates alone."""
    rows = np.flatnonzero(lawful)
    left = pairs.among(rows) if len(rows) else replace(pairs, lawful=None)
    meets = bool(len(rows)) and bool(left.collides.any())
    if meets or not pairs.collides.any():
        choice, unmet = choose(left, rule, likelihood_weight, wanted_sector, rng)
    else:
        choice, unmet = replace(_harmless(left), rule="nothing lawful"), ("lawful",)
    return (choice.among(rows, len(lawful)) if len(rows) else choice), unmet


def _mostly(there: Bools, pairs: Pairs) -> Bools:
    """Pairs ``there`` of candidates that collide there rather than elsewhere; all if none does."""
    mass = (pairs.reaction_probability * pairs.collides).sum(axis=1)
    rather = 2 * (pairs.reaction_probability * there).sum(axis=1) > mass
    narrowed: Bools = there & rather[:, None]
    return narrowed if narrowed.any() else there


def _harmless(pairs: Pairs) -> Choice:
    return scoring.harmless(
        pairs.probability, pairs.reaction_probability, pairs.collides, pairs.collision_step
    )


def fair_candidates(view: View, futures: Futures, av: Forecast) -> Bools:
    """(N1) futures of the opponent that a reference driver in the AV's place avoids from here on.

    Until that driver reacts, the AV does the likeliest of its predicted futures ``av``.
    """
    now = _state(view, view.av_id)
    ahead = av.futures.position_m[int(np.argmax(av.probability))]
    return avoidable(
        now,
        footprint(view, view.av_id),
        ahead,
        _state(view, futures.agent_id),
        footprint(view, futures.agent_id),
        futures.position_m,
        futures.heading_rad,
        view.dt_s,
        av_along_m=polylines.arc_lengths(np.concatenate([now.position_m[None], ahead])),
    )


def verified(view: View, row: int, futures: Futures, reaction: Forecast, hits: Bools) -> bool:
    """Whether candidate ``row`` is fair also where the AV does the likeliest of what it hits.

    ``hits`` (N2) are the modes of its ``reaction`` that it collides with; without any it is fair.
    """
    if not hits.any():
        return True
    one = Futures(
        agent_id=futures.agent_id,
        position_m=futures.position_m[row : row + 1],
        heading_rad=futures.heading_rad[row : row + 1],
    )
    hit = Forecast(futures=reaction.futures, probability=reaction.probability * hits)
    return bool(fair_candidates(view, one, hit)[0])


def _state(view: View, agent_id: AgentId) -> State:
    row = view.history.row(agent_id)
    return State(
        view.history.position_m[row, -1],
        float(view.history.heading_rad[row, -1]),
        float(view.history.speed_mps[row, -1]),
    )


def pairs(
    view: View,
    own: Candidates,
    reactions: Sequence[Forecast],
    alone: Forecast | None,
    settings: Settings,
    committed: bool,
    law: Law | None,
    watch: Stopwatch,
) -> Pairs:
    """How candidates and reactions collide within the time left, and what the settings ask of it.

    Args:
        view: the present.
        own: N1 candidates of the opponent.
        reactions: N1 forecasts of the AV, one for each candidate, of N2 futures each.
        alone: the AV's futures if nobody attacks; needed with ``settings.fair`` and ``lawful``.
        settings: of the policy.
        committed: whether the tail of the last plan was fair when it was chosen.
        law: with ``settings.lawful``, what the opponent owes since earlier plans.
        watch: its laps are ``collision``, ``fair`` and ``lawful``.
    """
    futures = own.forecast.futures
    sizes = footprint(view, futures.agent_id), footprint(view, view.av_id)
    horizon = min(FUTURE_STEPS, view.steps_left)
    levels = Levels.of(view, futures.agent_id)
    collides, step = collisions(futures, reactions, *sizes, horizon, levels)
    sector = fair = severity = lawful = None
    if settings.wanted_sector is not None:
        sector = impact_sectors(futures, reactions, *sizes, step)
    if settings.aggressiveness is not None:
        severity = delta_v(futures, reactions, *sizes, step)
    watch.lap("collision")
    if settings.fair:
        assert alone is not None
        # What was avoidable when the opponent set out stays so while it goes through with it.
        kept = np.array([origin == "tail" for origin in own.origin]) & committed
        fair = kept | fair_candidates(view, futures, alone)
        watch.lap("fair")
    if law is not None:
        assert alone is not None
        lawful = law.lawful(view, futures, own.speed_mps, alone, step)
        watch.lap("lawful")
    return Pairs(
        probability=own.forecast.probability,
        reaction_probability=np.stack([reaction.probability for reaction in reactions]),
        collides=collides,
        collision_step=step,
        sector=sector,
        fair=fair,
        lawful=lawful,
        severity=severity,
    )
