"""What the opponent may do: candidates of all origins, made drivable and weighed, and a shortlist.

Modes of the marginal predictor, ways to the AV, what the law would have it do, and the rest of the
last plan; see `candidates` for their probabilities.
"""

from typing import Protocol

from deepmf_sumo.datatypes import FUTURE_STEPS, AgentId, Forecast, Plan, View
from deepmf_sumo.deepmf import candidates
from deepmf_sumo.deepmf.candidates import (
    Candidates,
    Levels,
    References,
    Stopwatch,
    collisions,
    footprint,
)
from deepmf_sumo.deepmf.reference_paths import aimed_paths, goal_paths
from deepmf_sumo.deepmf.settings import Settings
from deepmf_sumo.deepmf.tracking import Start, track
from deepmf_sumo.deepmf.traffic_rules import stops
from deepmf_sumo.predictors.base import MarginalPredictor


class DensePredictor(MarginalPredictor, candidates.Density, Protocol):
    """A marginal predictor that also knows the density of futures that it did not propose."""


def propose(
    view: View,
    agent_id: AgentId,
    marginal: DensePredictor,
    alone: Forecast | None,
    last: Plan | None,
    settings: Settings,
    watch: Stopwatch,
) -> Candidates:
    """Predicted and made candidates of the opponent, drivable, with P(OV).

    Args:
        view: the present.
        agent_id: the opponent.
        marginal: of its futures.
        alone: the AV's futures if nobody attacks; needed with ``settings.goal_candidates``.
        last: the plan whose rest is a candidate, if any.
        settings: of the policy.
        watch: its laps are ``marginal``, ``goals`` and ``track``.
    """
    start, limits = Start.of(view, agent_id), settings.limits
    (modes,) = marginal.predict(view, [agent_id], settings.candidates)
    count = len(modes.probability)
    parts = [References.of("mode", modes.futures.position_m, limits.rows(count))]
    watch.lap("marginal")
    if settings.goal_candidates:
        assert alone is not None
        parts += _goals(view, modes, alone, start, settings)
        watch.lap("goals")
    if settings.lawful:
        parts.append(stops(modes, start, limits))
    if last is not None:
        rest = candidates.tail(last, view, limits, FUTURE_STEPS)
        parts += [rest] if rest else []
    references = References.joined(parts)
    tracked = track(references.position_m, start, references.limits)
    watch.lap("track")
    probability = candidates.weights(modes, tracked.position_m[count:], marginal, view)
    watch.lap("marginal")
    if settings.comfort > 0.0:
        probability = candidates.comfortable(
            probability, tracked.speed_mps, start.speed_mps, view.dt_s, settings.comfort
        )
    return candidates.ranked(references, tracked, probability, modes)


def shortlisted(
    view: View, own: Candidates, alone: Forecast | None, settings: Settings
) -> Candidates:
    """What reactions are worth predicting to; all where the settings do not limit them."""
    most = settings.most_candidates
    if most is None or alone is None or len(own.origin) <= most:
        return own
    futures, horizon = own.forecast.futures, min(FUTURE_STEPS, view.steps_left)
    sizes = footprint(view, futures.agent_id), footprint(view, view.av_id)
    levels = Levels.of(view, futures.agent_id)
    meets, _ = collisions(futures, [alone] * len(own.origin), *sizes, horizon, levels)
    return candidates.of_use(own, meets @ alone.probability, most)


def _goals(
    view: View, modes: Forecast, av: Forecast, start: Start, settings: Settings
) -> list[References]:
    """Ways to the AV, and ways to the wanted side of it."""
    limits, count = settings.limits, settings.goal_candidates
    av_size, horizon = footprint(view, view.av_id), min(FUTURE_STEPS, view.steps_left)
    paths = goal_paths(modes, av, start, av_size, limits, horizon, count)
    found = [References.of("goal", paths.reference_m, paths.limits)]
    if settings.wanted_sector is not None:
        sizes = footprint(view, modes.futures.agent_id), av_size
        sector = settings.wanted_sector
        levels = Levels.of(view, modes.futures.agent_id)
        aimed = aimed_paths(modes, av, start, sizes, sector, limits, horizon, count, levels)
        found.append(References.of("aim", aimed.reference_m, aimed.limits))
    return found
