"""A supporter: another road user that takes the AV's ways out, and touches nobody.

An attack leaves the AV ways out: it brakes, or swerves to the left or to the right. In traffic some
of them are taken by others: the lane beside it is full, somebody is close behind. DeepMF drives one
vehicle; here a second one is moved within its own prediction, so that the attack meets the AV in a
worse place. After the attacker's plan is chosen, one more argmax over bystanders and their likely
candidates S chooses it:

    P(S) * mean over the AV's open ways out of the share that S takes

- A **way out** (`WAYS`) is open as far as manoeuvres of it (`judge.avoidability.manoeuvres`, begun
  1 s to 2.5 s before the AV and the attacker would meet) touch neither attacker nor others, and
  stay on the road, if the supporter were not there. S takes the manoeuvres whose box it touches. It
  has to take more than the bystander's likeliest motion would: what is in the way anyway is no
  support.
- **Within its own prior**: modes of its predictor, driven within the limits of motion, with at
  least `WITHIN` of the probability of the likeliest.
- **It touches nobody**: with a margin neither the attacker, nor any other road user (at its
  velocity, and braking on if it brakes now), nor the AV in any of its likely reactions to the
  attack. It stays on the road and on its side. A contact that happens all the same makes the hit
  contrived (`judge.ladder`).
- **It stays fair**: of the reference drivers that avoid the attacker without it, at least one still
  does so and keeps clear of S; where none does, nobody supports. The verdict on the result asks the
  same of what was driven.

The supporter stays the same until the attack ends, and is planned with it. As soon as it can take
nothing more it takes its likeliest clear motion; where nothing is clear, the one that is clear for
longest. Only vehicles support: candidates of people are those of another part of the method.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.deepmf import candidates
from deepmf_sumo.deepmf.candidates import Candidates, References
from deepmf_sumo.deepmf.networks.predict import Marginal
from deepmf_sumo.deepmf.situation import OtherAgents, Situation
from deepmf_sumo.deepmf.tracking import track
from deepmf_sumo.judge.avoidability import manoeuvres, reference_drivers
from deepmf_sumo.judge.avoidability.av_path import AvPath, stays_on_road
from deepmf_sumo.judge.avoidability.encounter import ThirdParties, hit_by
from deepmf_sumo.judge.avoidability.reference_drivers import MODELS, Approach
from deepmf_sumo.scene import (
    FUTURE_STEPS,
    AgentId,
    Bools,
    Floats,
    Forecast,
    Futures,
    Ints,
    Plan,
    Support,
    Way,
)
from deepmf_sumo.scene.geometry import boxes, frames, polylines
from deepmf_sumo.scene.geometry.ground import clear

WAYS: Final[dict[Way, Bools]] = {
    "brake": manoeuvres.GRID.offset_m == 0,
    "left": manoeuvres.GRID.offset_m > 0,
    "right": manoeuvres.GRID.offset_m < 0,
}
"""(M) the manoeuvres of `manoeuvres.GRID` that belong to each way out."""
WITHIN: Final = 0.1
"""Candidates less likely than this share of the likeliest are not of the road user's own motion."""
_REACTS: Final = 0.1
"""The same for the AV's reactions that a supporter has to keep clear of."""
MARGIN_M: Final = 0.25
"""On every side of the supporter: where the AV goes is known to some decimetres at best."""
_BEFORE_STEPS: Final = (25, 20, 15, 10)
"""Before AV and attacker meet: when ways out begin. Drivers react within the last 2 s or so."""
_AFTER_STEPS: Final = 20
"""After they would have met: by then a way out has ended well."""
_NEAR_M: Final = 25.0
"""A bystander that never comes so near the AV, at constant velocity, is not asked."""
_ASKED: Final = 4
"""Bystanders that are asked, nearest first; each takes a prediction."""
_BRAKES_MPS2: Final = 0.5
"""Who slows down by more, over half a second, may go on to do so."""
_BRAKES_STEPS: Final = 5
_LEAST_GAIN: Final = 0.05
"""Of the ways out, beyond what the bystander takes anyway."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AttackPlan:
    """The attacker's plan that is to be supported.

    Attributes:
        situation: of the attacker. plan: its plan.
        reaction: the AV's futures given the plan. collides, collision_step: (N2) of each.
    """

    situation: Situation
    plan: Plan
    reaction: Forecast
    collides: Bools
    collision_step: Floats

    @classmethod
    def of(cls, situation: Situation, plan: Plan) -> "AttackPlan":
        """A plan with its reason."""
        why = plan.reason
        assert why is not None
        return cls(
            situation=situation,
            plan=plan,
            reaction=why.reactions[why.chosen],
            collides=why.collides[why.chosen],
            collision_step=why.collision_step[why.chosen],
        )


class Supported(NamedTuple):
    """The supporter's plan, None without a supporter, and what to say of it."""

    plan: Plan | None
    support: Support


class _Start(NamedTuple):
    """Manoeuvres that begin at a step, as futures (M, F) from the next one on, and which are open.

    ``first``: index of the future's first step that is driven; before it the AV drives on.
    """

    futures: Futures
    first: int
    open_: Bools


class _Moving(NamedTuple):
    """A road user to keep clear of, from the next step on: (K, 2), (K), and its size (2)."""

    position_m: Floats
    heading_rad: Floats
    size_m: Floats


class _Offer(NamedTuple):
    """A bystander's candidates (N), how much of each way they take, and which may be driven."""

    agent_id: AgentId
    own: Candidates
    taken: dict[Way, Floats]
    clear_steps: Ints
    fair: Bools

    @property
    def mass(self) -> Floats:
        """(N) mean over the open ways of the share that is taken; 0 where no way is open."""
        shares = [*self.taken.values()] or [np.zeros(len(self.fair))]
        return np.asarray(np.mean(shares, axis=0))

    @property
    def allowed(self) -> Bools:
        """(N) within its prior, clear of everybody, and fair."""
        likely = self.own.forecast.probability
        within = likely >= WITHIN * likely.max()
        return within & self.fair & (self.clear_steps >= FUTURE_STEPS)


def supported(attack: AttackPlan, marginal: Marginal, modes: int, held: Plan | None) -> Supported:
    """The plan of a supporter, if there is one.

    Args:
        attack: the attacker's plan.
        marginal: predicts bystanders.
        modes: how many futures of each.
        held: the last plan of the supporter that is there already.
    """
    if held is not None:
        if held.agent_id not in attack.situation.view.history.ids:
            return Supported(None, Support(note="the supporter has left"))
        return _goes_on(_Moment(attack, marginal, modes), held)
    if not attack.collides.any():
        return Supported(None, Support(note="the plan meets no future of the AV"))
    moment = _Moment(attack, marginal, modes)
    if not len(moment.drivers):
        return Supported(None, Support(note="no reference driver avoids the plan"))
    best: tuple[float, _Offer, int] | None = None
    for agent_id in moment.bystanders():
        offer = moment.offer(agent_id, None)
        value = np.where(offer.allowed, offer.own.forecast.probability * offer.mass, 0.0)
        value[offer.mass < offer.mass[0] + _LEAST_GAIN] = 0.0  # the likeliest is the first
        row = int(value.argmax())
        if value[row] > 0 and (best is None or value[row] > best[0]):
            best = float(value[row]), offer, row
    if best is None:
        return Supported(None, Support(note="no bystander takes a way out and touches nobody"))
    return moment.driven(best[1], best[2], "")


def _goes_on(moment: "_Moment", held: Plan) -> Supported:
    """The supporter that is there already, whose attack goes on."""
    offer = moment.offer(held.agent_id, held)
    likely, allowed = offer.own.forecast.probability, offer.allowed
    value = np.where(allowed, likely * offer.mass, 0.0)
    if value.max() > 0:
        return moment.driven(offer, int(value.argmax()), "")
    if allowed.any():
        return moment.driven(offer, int(np.where(allowed, likely, 0.0).argmax()), "it keeps clear")
    longest = offer.clear_steps == offer.clear_steps.max()
    row = int(np.where(longest, likely, 0.0).argmax())
    return moment.driven(offer, row, "nothing that it may do is clear or fair")


class _Moment:
    """What all bystanders are asked about: the AV's way and ways out, and reference drivers."""

    def __init__(self, attack: AttackPlan, marginal: Marginal, modes: int) -> None:
        self._attack, self._marginal, self._modes = attack, marginal, modes
        situation, view = attack.situation, attack.situation.view
        self._view, self._situation = view, situation
        row = view.history.row(view.av_id)
        now_m, now_rad = view.history.position_m[row, -1], view.history.heading_rad[row, -1]
        likely = np.where(attack.collides, attack.reaction.probability, 0.0)
        likely = likely if likely.any() else attack.reaction.probability
        mode = int(likely.argmax())
        ahead = attack.reaction.futures
        self._av_m = np.concatenate([now_m[None], ahead.position_m[mode]])
        self._av_rad = np.append(now_rad, ahead.heading_rad[mode])
        self._along_m = polylines.arc_lengths(self._av_m)
        self._path = AvPath.through(self._av_m[:1], self._av_rad[:1], self._av_m[1:])
        self._z_m = view.history.z_m[row, -1:]
        meets = attack.collision_step[mode] if attack.collides[mode] else FUTURE_STEPS
        self._meets = int(min(meets, situation.horizon))
        self._end = int(min(self._meets + _AFTER_STEPS, situation.horizon, FUTURE_STEPS))

    def bystanders(self) -> list[AgentId]:
        """The vehicles that come near the AV until the end, nearest first, at most `_ASKED`."""
        tracks = self._view.history
        after = self._view.dt_s * np.arange(self._end + 1)[:, None]
        ways = tracks.position_m[:, -1, None] + tracks.velocity_mps[:, -1, None] * after
        away = np.hypot(*np.moveaxis(ways - self._av_m[: self._end + 1], -1, 0)).min(axis=1)
        level = ~clear(tracks.z_m[:, -1], self._z_m)
        taken = {self._view.av_id, self._situation.opponent_id}
        return [
            tracks.ids[row]
            for row in np.argsort(away, kind="stable").tolist()
            if tracks.ids[row] not in taken
            and tracks.kinds[row] == "vehicle"
            and level[row]
            and away[row] <= _NEAR_M
        ][:_ASKED]

    def offer(self, agent_id: AgentId, held: Plan | None) -> _Offer:
        """What a bystander could do, likeliest first."""
        situation = Situation.of(
            self._view,
            agent_id,
            self._situation.limits,
            None,
            held,
            self._situation.seen,
        )
        own = self._candidates(situation)
        others = self._others(agent_id)
        return _Offer(
            agent_id=agent_id,
            own=own,
            taken=self._taken(situation, own, others),
            clear_steps=self._clear_steps(situation, own, others),
            fair=self._fair(situation, own),
        )

    def driven(self, offer: _Offer, row: int, note: str) -> Supported:
        """A candidate as the supporter's plan."""
        futures = offer.own.forecast.futures
        plan = Plan(
            agent_id=offer.agent_id,
            first_step=self._view.step + 1,
            position_m=futures.position_m[row],
            heading_rad=futures.heading_rad[row],
            speed_mps=offer.own.speed_mps[row],
            supports=self._situation.opponent_id,
        )
        ways = {way: float(share[row]) for way, share in offer.taken.items()}
        chance = float(offer.own.forecast.probability[row])
        said = Support(agent_id=offer.agent_id, ways=ways, probability=chance, note=note)
        return Supported(plan, said)

    def _candidates(self, situation: Situation) -> Candidates:
        """Its modes and the rest of its last plan, as it can drive them."""
        prediction = self._marginal.predict(situation.view, situation.opponent_id)
        modes = prediction.modes(self._modes)
        count = len(modes.probability)
        parts = [
            References.of("mode", modes.futures.position_m, situation.limits.rows(count)),
            *candidates.tail(situation, FUTURE_STEPS),
        ]
        references = References.joined(parts)
        tracked = track(references.position_m, situation.start, references.limits)
        probability = candidates.weights(modes, tracked.position_m[count:], prediction)
        return candidates.ranked(references, tracked, probability, modes)

    def _others(self, agent_id: AgentId) -> OtherAgents:
        """All but AV, attacker and bystander."""
        without = {self._view.av_id, self._situation.opponent_id, agent_id}
        return OtherAgents.of(self._view, without, self._situation.seen)

    # The AV's ways out ------------------------------------------------------------------------

    @cached_property
    def _starts(self) -> list[_Start]:
        """Manoeuvres from each start on; open: they touch neither attacker nor leave the road."""
        begins = sorted({max(self._meets - before, 0) for before in _BEFORE_STEPS})
        return [self._start(begin) for begin in begins if begin + 2 <= self._end]

    def _start(self, begin: int) -> _Start:
        """``begin``: steps from now."""
        along = self._along_m[begin : self._end + 1]
        driven = manoeuvres.drive(self._path, along, self._view.dt_s)
        position, heading = driven.centre_m[:, 1:], driven.heading_rad[:, 1:]
        futures = Futures(agent_id=self._view.av_id, position_m=position, heading_rad=heading)
        half_width = float(self._situation.av_size_m[1]) / 2
        kept = driven.along_m, driven.left_m, half_width, float(self._z_m[0])
        free = driven.holds & stays_on_road(self._view.road, self._path, *kept)
        plan = self._attack.plan
        attacker = Futures(
            agent_id=plan.agent_id,
            position_m=plan.position_m[None],
            heading_rad=plan.heading_rad[None],
        )
        free &= ~self._hits(attacker, self._situation.size_m, futures, begin)[0]
        return _Start(futures, begin, free)

    def _hits(self, own: Futures, size_m: Floats, av: Futures, begin: int) -> Bools:
        """(N, M) whether futures (N, F) touch the AV's (M, K), which begin at ``begin``."""
        steps = slice(begin, begin + av.heading_rad.shape[1])
        own = replace(
            own, position_m=own.position_m[:, steps], heading_rad=own.heading_rad[:, steps]
        )
        count = own.heading_rad.shape[1]
        ways = Forecast(futures=av, probability=np.ones(len(av.heading_rad)))
        alike = [ways] * len(own.position_m)
        sizes = size_m, self._situation.av_size_m
        return candidates.collisions(own, alike, *sizes, count)[0]

    def _taken(
        self, situation: Situation, own: Candidates, others: OtherAgents
    ) -> dict[Way, Floats]:
        """(N) the share of each open way out that candidates take; without the ways not open."""
        count = len(own.forecast.probability)
        there = dict.fromkeys(WAYS, 0)
        gone = {way: np.zeros(count) for way in WAYS}
        level = ~clear(others.z_m, self._z_m)
        for start in self._starts:
            steps = slice(start.first, start.first + start.futures.heading_rad.shape[1])
            third = ThirdParties(
                others.position_m[level][:, steps],
                others.heading_rad[level][:, steps],
                others.valid[level][:, steps],
                others.size_m[level],
            )
            av = start.futures.position_m, start.futures.heading_rad
            straight = manoeuvres.GRID.lateral_mps2 == 0
            free = start.open_ & ~hit_by(*av, third, self._situation.av_size_m, straight)
            hit = self._hits(own.forecast.futures, situation.size_m, start.futures, start.first)
            for way, its in WAYS.items():
                there[way] += int((free & its).sum())
                gone[way] += (hit & free & its).sum(axis=1)
        return {way: gone[way] / there[way] for way in WAYS if there[way]}

    # What a supporter keeps clear of -----------------------------------------------------------

    def _clear_steps(self, situation: Situation, own: Candidates, others: OtherAgents) -> Ints:
        """(N) steps until a candidate touches anybody or leaves its part of the road; F: never."""
        count = len(own.forecast.probability)
        first = np.full(count, FUTURE_STEPS)
        for road_user in self._road_users(situation, others):
            begins = _touches(own.forecast.futures, situation.size_m, road_user)
            first = np.minimum(first, begins)
        until = np.full(count, float(self._end))
        astray = candidates.leaves_road(situation, own, until)
        astray |= candidates.against_traffic(situation, own, until)
        return np.where(astray, 0, first)

    def _road_users(self, situation: Situation, others: OtherAgents) -> Iterator[_Moving]:
        """The attacker, the AV in each likely reaction, and all others on its level.

        A reaction that meets the attacker ends there.
        """
        plan, end = self._attack.plan, self._end
        attacker = self._situation.size_m
        yield _Moving(plan.position_m[:end], plan.heading_rad[:end], attacker)
        reaction, met = self._attack.reaction, self._attack.collision_step
        ahead = reaction.futures
        for mode in np.flatnonzero(reaction.probability >= _REACTS * reaction.probability.max()):
            until = int(min(met[mode] + 1, end))
            position, heading = ahead.position_m[mode, :until], ahead.heading_rad[mode, :until]
            yield _Moving(position, heading, self._situation.av_size_m)
        history = self._view.history
        z_m = history.z_m[history.row(situation.opponent_id), -1:]
        for row in np.flatnonzero(others.valid[:, 0] & ~clear(others.z_m, z_m)):
            until = int(others.valid[row, :end].argmin()) or end
            position, heading = others.position_m[row, :until], others.heading_rad[row, :until]
            yield _Moving(position, heading, others.size_m[row])
        yield from self._braking(situation.opponent_id, z_m)

    def _braking(self, agent_id: AgentId, z_m: Floats) -> Iterator[_Moving]:
        """Road users that brake now and go on to do so, until they stand: who follows must stop."""
        tracks, dt_s = self._view.history, self._view.dt_s
        after_s = dt_s * np.arange(1, self._end + 1)
        without = {self._view.av_id, self._situation.opponent_id, agent_id}
        then = max(tracks.steps - 1 - _BRAKES_STEPS, 0)
        for row, name in enumerate(tracks.ids):
            if name in without or not tracks.valid[row, then] or clear(tracks.z_m[row, -1:], z_m):
                continue
            speed, before = tracks.speed_mps[row, [-1, then]].tolist()
            braking = (before - speed) / (dt_s * (tracks.steps - 1 - then))
            if braking < _BRAKES_MPS2:
                continue
            moving_s = np.minimum(after_s, speed / braking)
            moved_m = speed * moving_s - braking * moving_s**2 / 2
            heading = float(tracks.heading_rad[row, -1])
            position = tracks.position_m[row, -1] + moved_m[:, None] * frames.unit(heading)
            yield _Moving(position, np.full(self._end, heading), tracks.size_m[row, :2])

    # Reference drivers ---------------------------------------------------------------------------

    @cached_property
    def drivers(self) -> Floats:
        """(D, K + 1) arc lengths of the reference drivers that avoid the attacker's plan."""
        situation, plan = self._situation, self._attack.plan
        position = np.concatenate([situation.start.position_m[None], plan.position_m[: self._end]])
        heading = np.append(situation.start.heading_rad, plan.heading_rad[: self._end])
        sizes = situation.size_m, situation.av_size_m
        approach = Approach.of(self._path, position[None], heading[None], *sizes, self._view.dt_s)
        along_m = self._along_m[: self._end + 1]
        along = reference_drivers.drive(list(MODELS.values()), approach, along_m)[:, 0]
        hit = reference_drivers.overlaps(approach, *self._path.at(along))
        return along[~hit.any(axis=1)]

    def _fair(self, situation: Situation, own: Candidates) -> Bools:
        """(N) whether a driver that avoids the attacker keeps clear of a candidate, too."""
        if not len(self.drivers):  # it is too late: the supporter changes nothing
            return np.ones(len(own.forecast.probability), bool)
        position, heading = self._path.at(self.drivers[:, 1:])
        ways = Futures(agent_id=self._view.av_id, position_m=position, heading_rad=heading)
        hit = self._hits(own.forecast.futures, situation.size_m, ways, 0)
        return np.asarray(~hit.all(axis=1))


def _touches(own: Futures, size_m: Floats, other: _Moving) -> Ints:
    """(N) first step at which futures come within the margin of a road user; F: never.

    Where they are nearer than that at the first step already, the boxes themselves count; a road
    user whose box overlaps there is left out: its recorded place is wrong.
    """
    steps = min(own.heading_rad.shape[1], len(other.heading_rad))
    mine = own.position_m[:, :steps], own.heading_rad[:, :steps]
    theirs = other.position_m[:steps], other.heading_rad[:steps], other.size_m
    for size in (size_m + 2 * MARGIN_M, size_m):
        hit = boxes.touching(*mine, size, *theirs)
        if steps and not hit[:, 0].any():
            return np.where(hit.any(axis=1), hit.argmax(axis=1), FUTURE_STEPS)
    return np.full(len(own.heading_rad), FUTURE_STEPS)
