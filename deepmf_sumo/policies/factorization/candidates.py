"""The opponent's N1 candidates: marginal modes, ways to goals, the rest of the last plan.

Probabilities. A marginal mode j keeps the mass P_j that the predictor gave it. For a made candidate
g only a density f_g = exp(log_density(Y_g)) is known. It is taken to stand for as much of the space
of futures as the modes do on average, with V the P-weighted geometric mean of P_j / f_j:

    log w_j = log P_j        log w_g = min(log f_g + log V, max_j log P_j)        P = softmax(log w)

so that no made candidate is likelier than the likeliest mode, and candidates that the predictor
thinks unlikely remain so.

Comfort. The predictor knows where vehicles go better than how hard they accelerate on the way, and
of the many candidates that meet the AV some do so by driving harder than others. With a_j(t) the
acceleration along candidate j and the weight c (`settings.Settings.comfort`; 0 as published):

    P'_j  ~  P_j exp(-c mean over the first 3 s of a_j(t)^2)
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from deepmf_sumo.datatypes import AgentId, Floats, Forecast, Futures, Plan, View
from deepmf_sumo.geometry import angles
from deepmf_sumo.policies.factorization.opponent import softmax
from deepmf_sumo.policies.factorization.tracking import Limits, Tracked

Origin = Literal["mode", "goal", "aim", "tail", "stop"]

_LEAST = 1e-12  # probabilities below are rounding
_COMFORT_STEPS = 30  # 3 s; most of what comes after is planned anew before it is driven


class Density(Protocol):
    """Log-density of given futures under a marginal prediction."""

    def log_density(self, view: View, agent_id: AgentId, position_m: Floats) -> Floats:
        """(K) of futures (K, F, 2)."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class References:
    """What is to be tracked: positions (K, F, 2), limits (K, 3), where each comes from (K)."""

    position_m: Floats
    limits: Floats
    origin: tuple[Origin, ...]

    @classmethod
    def of(cls, origin: Origin, position_m: Floats, limits: Floats) -> "References":
        """References that come from one place."""
        return cls(position_m=position_m, limits=limits, origin=(origin,) * len(position_m))

    @classmethod
    def joined(cls, parts: Sequence["References"]) -> "References":
        """All parts after one another."""
        return cls(
            position_m=np.concatenate([part.position_m for part in parts]),
            limits=np.concatenate([part.limits for part in parts]),
            origin=tuple(origin for part in parts for origin in part.origin),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidates:
    """Drivable candidates, likeliest first: forecast, speeds (N1, F), bent (N1), origins (N1)."""

    forecast: Forecast
    speed_mps: Floats
    bent_m: Floats
    origin: tuple[Origin, ...]


def tail(plan: Plan, view: View, limits: Limits, steps: int) -> References | None:
    """What is left of the last plan, continued straight at its last speed; None if nothing is."""
    begin = view.step + 1 - plan.first_step
    left = plan.position_m[begin:]
    if begin < 0 or len(left) < 2:
        return None
    beyond = np.arange(1, steps - len(left) + 1)[:, None] * view.dt_s * plan.speed_mps[-1]
    more = left[-1] + beyond * angles.unit(plan.heading_rad[-1])
    rest = np.concatenate([left, more])[None, :steps]
    return References.of("tail", rest, limits.rows(1))


def weights(modes: Forecast, made_m: Floats, density: Density, view: View) -> Floats:
    """(N1) joint probabilities of the modes and of made candidates (K, F, 2) after them."""
    if len(made_m) == 0:
        return modes.probability
    futures = np.concatenate([modes.futures.position_m, made_m])
    log_density = density.log_density(view, modes.futures.agent_id, futures)
    mass = np.log(np.maximum(modes.probability, _LEAST))
    own, made = log_density[: len(mass)], log_density[len(mass) :]
    volume = float((modes.probability * (mass - own)).sum() / modes.probability.sum())
    return softmax(np.concatenate([mass, np.minimum(made + volume, mass.max())]))


def comfortable(
    probability: Floats, speed_mps: Floats, start_mps: float, dt_s: float, weight: float
) -> Floats:
    """(N1) probabilities that fall with the acceleration along the speeds (N1, F), see above.

    ``weight`` is in s4/m2, ``start_mps`` the present speed.
    """
    speed = np.column_stack([np.full(len(speed_mps), start_mps), speed_mps[:, :_COMFORT_STEPS]])
    square = ((np.diff(speed, axis=1) / dt_s) ** 2).mean(axis=1)
    return softmax(np.log(np.maximum(probability, _LEAST)) - weight * square)


def ranked(
    references: References, tracked: Tracked, probability: Floats, modes: Forecast
) -> Candidates:
    """The tracked references as candidates, likeliest first."""
    order = np.argsort(-probability, kind="stable")
    return Candidates(
        forecast=Forecast(
            futures=Futures(
                agent_id=modes.futures.agent_id,
                position_m=tracked.position_m[order],
                heading_rad=tracked.heading_rad[order],
            ),
            probability=probability[order],
            temperature=modes.temperature,
        ),
        speed_mps=tracked.speed_mps[order],
        bent_m=tracked.bent_m[order],
        origin=tuple(references.origin[row] for row in order),
    )


def of_use(own: Candidates, mass: Floats, count: int) -> Candidates:
    """At most ``count`` of them, likeliest first: the largest ``mass`` (N1), then the likeliest.

    Their probabilities are those that they have among each other.
    """
    rows = np.sort(np.argsort(-mass, kind="stable")[:count])
    futures, probability = own.forecast.futures, own.forecast.probability[rows]
    return Candidates(
        forecast=replace(
            own.forecast,
            futures=replace(
                futures,
                position_m=futures.position_m[rows],
                heading_rad=futures.heading_rad[rows],
            ),
            probability=probability / probability.sum(),
        ),
        speed_mps=own.speed_mps[rows],
        bent_m=own.bent_m[rows],
        origin=tuple(own.origin[row] for row in rows),
    )
