"""Candidates of the opponent with their weights, and where they collide with the AV.

The opponent's N1 candidates: marginal modes, ways to goals, the rest of the last plan.

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

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, Protocol

import numpy as np

from deepmf_sumo.datatypes import DT_S, AgentId, Bools, Floats, Forecast, Futures, Ints, Plan, View
from deepmf_sumo.deepmf.opponent import softmax
from deepmf_sumo.deepmf.tracking import Limits, Tracked
from deepmf_sumo.geometry import boxes, frames, impact
from deepmf_sumo.geometry.ground import Ground, clear, ground_of

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
    more = left[-1] + beyond * frames.unit(plan.heading_rad[-1])
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


NO_SECTOR: Final = -1


def footprint(view: View, agent_id: AgentId) -> Floats:
    """(2) length and width of an agent."""
    size: Floats = view.history.size_m[view.history.row(agent_id), :2]
    return size


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Levels:
    """An opponent and the AV now, (3) x, y, z each, on a road that passes over itself."""

    ground: Ground
    opponent: Floats
    av: Floats

    @classmethod
    def of(cls, view: View, opponent_id: AgentId) -> "Levels | None":
        """None where the road passes nowhere over itself, and heights decide nothing."""
        ground, tracks = ground_of(view.road), view.history
        if not ground.has_levels:
            return None
        rows = [tracks.row(opponent_id), tracks.row(view.av_id)]
        now = np.column_stack([tracks.position_m[rows, -1], tracks.z_m[rows, -1]])
        return cls(ground=ground, opponent=now[0], av=now[1])

    def opponent_z_m(self, futures_m: Floats) -> Floats:
        """(N, F) heights of futures (N, F, 2) of the opponent, which follow the road."""
        return self._along(futures_m, self.opponent)

    def av_z_m(self, futures_m: Floats) -> Floats:
        """(N, F) heights of futures (N, F, 2) of the AV."""
        return self._along(futures_m, self.av)

    def clear(self, own_m: Floats, av_m: Floats, at: tuple[Ints, Ints, Ints]) -> Bools:
        """(K) whether candidates (N, F, 2) and reactions (N, M, F, 2) pass over each other.

        ``at``: K rows, modes and steps.
        """
        row, mode, step = at
        mine, own = np.unique(row, return_inverse=True)
        theirs, other = np.unique(row * av_m.shape[1] + mode, return_inverse=True)
        reactions = av_m[np.divmod(theirs, av_m.shape[1])]
        own_z, other_z = self.opponent_z_m(own_m[mine]), self.av_z_m(reactions)
        return clear(own_z[own, step], other_z[other, step])

    def _along(self, futures_m: Floats, now: Floats) -> Floats:
        begin = np.broadcast_to(now[:2], (len(futures_m), 1, 2))
        paths = np.concatenate([begin, futures_m], axis=1)
        return self.ground.follow(paths, np.full(len(paths), now[2]))[:, 1:]


def collisions(
    candidates: Futures,
    reactions: Sequence[Forecast],
    opponent_size_m: Floats,
    av_size_m: Floats,
    horizon: int,
    levels: Levels | None = None,
) -> tuple[Bools, Floats]:
    """(N1, N2) overlap of the oriented boxes at the same time, and (N1, N2) its first step.

    Every step (10 Hz) of the first ``horizon`` is tested; where there is no overlap the step is F,
    the length of the futures. Sizes are (2): length, width. Pairs of poses whose centres are
    farther apart than the half diagonals reach are not tested: they cannot overlap. ``levels`` says
    which of them pass over each other.
    """
    own, other = candidates.position_m, _stacked([each.futures.position_m for each in reactions])
    other_heading = _stacked([each.futures.heading_rad for each in reactions])
    # each axis by itself: numpy is slow at sums over the two of them
    x, y = (own[:, None, :horizon, axis] - other[:, :, :horizon, axis] for axis in range(2))
    reach = (np.hypot(*opponent_size_m) + np.hypot(*av_size_m)) / 2
    near = np.nonzero(x * x + y * y < reach**2)
    row, mode, step = near
    hit = boxes.overlap(
        own[row, step],
        candidates.heading_rad[row, step],
        opponent_size_m,
        other[near],
        other_heading[near],
        av_size_m,
    )
    if levels is not None:
        hit[hit] = ~levels.clear(own, other, (row[hit], mode[hit], step[hit]))
    steps = own.shape[1]
    first = np.full(other.shape[:2], float(steps))
    np.minimum.at(first, (row[hit], mode[hit]), step[hit].astype(float))
    return first < steps, first


def _stacked(arrays: Sequence[Floats]) -> Floats:
    """(N, ...); the same array for all is not copied."""
    if all(each is arrays[0] for each in arrays):
        return np.broadcast_to(arrays[0], (len(arrays), *arrays[0].shape))
    return np.stack(arrays)


def impact_sectors(
    candidates: Futures,
    reactions: Sequence[Forecast],
    opponent_size_m: Floats,
    av_size_m: Floats,
    collision_step: Floats,
) -> Ints:
    """(N1, N2) sector of the AV, 0..7, in which each pair first overlaps; `NO_SECTOR` without.

    The same judgement as that of contacts in the simulation (`geometry.impact`).
    """
    found = np.full(collision_step.shape, NO_SECTOR)
    row, mode = np.nonzero(collision_step < candidates.position_m.shape[1])
    step = collision_step[row, mode].astype(int)
    other = np.stack([reaction.futures.position_m for reaction in reactions])
    other_heading = np.stack([reaction.futures.heading_rad for reaction in reactions])
    found[row, mode] = impact.sectors(
        other[row, mode, step],
        other_heading[row, mode, step],
        av_size_m,
        candidates.position_m[row, step],
        candidates.heading_rad[row, step],
        opponent_size_m,
    )
    return found


def delta_v(
    candidates: Futures,
    reactions: Sequence[Forecast],
    opponent_size_m: Floats,
    av_size_m: Floats,
    collision_step: Floats,
) -> Floats:
    """(N1, N2) change of the AV's velocity in m/s (`Contact.delta_v_mps`); 0 without contact."""
    change = np.zeros(collision_step.shape)
    row, mode = np.nonzero(collision_step < candidates.position_m.shape[1])
    after = np.maximum(collision_step[row, mode].astype(int), 1)
    other = np.stack([reaction.futures.position_m for reaction in reactions])
    apart = other[row, mode, after] - candidates.position_m[row, after]
    before = other[row, mode, after - 1] - candidates.position_m[row, after - 1]
    area, av_area = np.prod(opponent_size_m), np.prod(av_size_m)
    relative = np.hypot(*(apart - before).T) / DT_S
    change[row, mode] = relative * area / (area + av_area)
    return change


class Stopwatch:
    """Wall time by part."""

    def __init__(self) -> None:
        self._since = time.perf_counter()
        self.milliseconds: dict[str, float] = {}

    def lap(self, part: str) -> None:
        """Add the time since the last lap to a part."""
        now = time.perf_counter()
        spent = 1000 * (now - self._since)
        self.milliseconds[part] = self.milliseconds.get(part, 0.0) + spent
        self._since = now

    @property
    def seconds(self) -> float:
        """Sum of all laps."""
        return sum(self.milliseconds.values()) / 1000
