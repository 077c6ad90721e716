"""Candidates of the opponent with the AV's reactions to them: what is asked of their pairs."""

from collections.abc import Sequence

import numpy as np

from deepmf_sumo.datatypes import FUTURE_STEPS, Forecast, View
from deepmf_sumo.policies.factorization import steering
from deepmf_sumo.policies.factorization.candidates import Candidates
from deepmf_sumo.policies.factorization.collision import (
    Levels,
    collisions,
    delta_v,
    footprint,
    impact_sectors,
)
from deepmf_sumo.policies.factorization.lawful import Law
from deepmf_sumo.policies.factorization.settings import Settings
from deepmf_sumo.policies.factorization.stopwatch import Stopwatch


def pairs(
    view: View,
    own: Candidates,
    reactions: Sequence[Forecast],
    alone: Forecast | None,
    settings: Settings,
    committed: bool,
    law: Law | None,
    watch: Stopwatch,
) -> steering.Pairs:
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
        fair = kept | steering.fair(view, futures, alone)
        watch.lap("fair")
    if law is not None:
        assert alone is not None
        lawful = law.lawful(view, futures, own.speed_mps, alone, step)
        watch.lap("lawful")
    return steering.Pairs(
        probability=own.forecast.probability,
        reaction_probability=np.stack([reaction.probability for reaction in reactions]),
        collides=collides,
        collision_step=step,
        sector=sector,
        fair=fair,
        lawful=lawful,
        severity=severity,
    )
