"""The AV's rollouts as what it may do: the candidates of an opponent are scored against them.

With P_j the weight of candidate j, P_k that of rollout k, and decay the 0.99 a half second of CAT:

    value_j = P_j * sum_k P_k * 0.99^(1 + first contact of j and k in half seconds)

Where no candidate touches a rollout, the one whose centre comes nearest to the AV's.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deepmf_sumo.adversaries.aiming import motions
from deepmf_sumo.adversaries.search.scouting import Motion
from deepmf_sumo.datatypes import FUTURE_STEPS, Bools, Floats, Forecast, Futures, View
from deepmf_sumo.policies.factorization.collision import Levels, collisions, footprint
from deepmf_sumo.policies.factorization.tracking import Start

_DECAY = 0.99
_DECAY_STEPS = 5  # CAT looks at every fifth step


@dataclass(frozen=True, slots=True, kw_only=True)
class Answers:
    """N2 rollouts of the AV, equally likely.

    Attributes:
        forecast: (N2, 80) poses; continued straight where the AV is gone.
        there: (N2, 80) where it is not gone.
    """

    forecast: Forecast
    there: Bools

    def lasts(self, row: int) -> int:
        """Steps until the AV is gone for good in a rollout."""
        there = np.flatnonzero(self.there[row])
        return int(there[-1]) + 1 if len(there) else 0

    @classmethod
    def of(cls, view: View, rollouts: Sequence[Motion]) -> "Answers":
        """The AV's rollouts from the view on."""
        start = Start.of(view, view.av_id)
        paths = [_lengthened(motions.continued(rollout, start)) for rollout in rollouts]
        there = np.zeros((len(rollouts), FUTURE_STEPS), dtype=bool)
        heading = np.stack([motions.headings(path, start) for path in paths])
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
        collides, collision_step: (N1, N2) as from `collision.collisions`.
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
    # Rollouts end at different times: each is judged by itself, up to its own end.
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
    """(80, 2) a path (K, 2), cut or held at its end."""
    cut = path_m[:FUTURE_STEPS]
    return np.concatenate([cut, np.repeat(cut[-1:], FUTURE_STEPS - len(cut), axis=0)])
