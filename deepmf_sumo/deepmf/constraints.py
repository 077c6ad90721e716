"""Constraints on the choice: e.g. the side of the AV that is hit, fair, lawful, on the road.

A constraint is a mask of the candidates, or pairs of candidate and reaction, that it allows;
`scoring.choose_allowed` narrows the choice to these, and reports if nothing is left. To add one,
write a class here and list it in `CONSTRAINTS`; ``adversary: {name: deepmf, constraints:
[its_name]}`` then uses it. `CONTRIBUTING.md` shows an example.
"""

from collections.abc import Sequence
from typing import ClassVar, Final, Protocol

import numpy as np

from deepmf_sumo.deepmf.candidates import (
    Candidates,
    References,
    against_traffic,
    av_stands,
    leaves_road,
    off_front,
    rear_ends,
)
from deepmf_sumo.deepmf.reference_paths import OwnPath, aimed_paths
from deepmf_sumo.deepmf.scoring import Pairs, Scope
from deepmf_sumo.deepmf.settings import Settings
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.deepmf.traffic_rules import TrafficRules, stops
from deepmf_sumo.judge.avoidability.av_path import VehicleState
from deepmf_sumo.judge.avoidability.counterfactual import likeliest
from deepmf_sumo.judge.avoidability.grading import (
    AvAhead,
    OpponentFutures,
    PastPoses,
    TakeOver,
    avoidable,
)
from deepmf_sumo.judge.avoidability.intention import intends_since
from deepmf_sumo.scene import AgentId, Bools, Floats, Forecast, Futures, Ints, View
from deepmf_sumo.scene.geometry import boxes, frames, polylines
from deepmf_sumo.scene.geometry.ground import clear

_EVERY_STEPS = 3  # boxes touch for longer than 0.3 s, unless they only graze each other
_BEHIND_SHARE = 0.1  # of a candidate's collision mass; some AVs may brake in any case


class Constraint(Protocol):
    """A restriction of the opponent. There is one object per attack, so that it may keep a state.

    Attributes:
        name: in the settings and in `PlanReason`.
        scope: treatment of forbidden candidates. ``driven``: driven only if all are forbidden;
            ``attack``: do not count as an attack, and are not driven if they collide;
            ``preferred``: their pairs count only if no others do.
        keeps_plan: the rest of the last plan is a candidate for the next one.
    """

    name: ClassVar[str]
    scope: ClassVar[Scope]
    keeps_plan: bool = False

    def __init__(self, settings: Settings) -> None: ...

    def references(self, situation: Situation, paths: list[OwnPath]) -> list[References]:
        """Additional candidates that the constraint allows; ``paths``: the opponent's own."""
        return []

    def allowed(
        self, situation: Situation, own: Candidates, reactions: Sequence[Forecast], pairs: Pairs
    ) -> Bools:
        """(N1) allowed candidates; of scope ``preferred`` (N1, N2) allowed pairs."""
        ...

    def confirmed(
        self, situation: Situation, own: Candidates, reaction: Forecast, pairs: Pairs, row: int
    ) -> bool:
        """Whether the chosen candidate passes a closer check, which is too slow for all."""
        return True


class Lawful(Constraint):
    """The candidate breaks no traffic rule (`traffic_rules`, which says what people must obey)."""

    name = "lawful"
    scope = "driven"

    def __init__(self, settings: Settings) -> None:
        self._law = TrafficRules()

    def references(self, situation: Situation, paths: list[OwnPath]) -> list[References]:
        return [stops(situation, paths)]

    def allowed(
        self, situation: Situation, own: Candidates, reactions: Sequence[Forecast], pairs: Pairs
    ) -> Bools:
        return self._law.lawful(situation, own, pairs.collision_step)


class Fair(Constraint):
    """A competent driver in the AV's place could avoid the candidate (`avoidability.grading`).

    That driver takes over at the first sign of the attack, as in the judgement of the result: what
    both have driven since the first plan is part of what it had to avoid. A plan knows no future:
    where the opponent would have been is its likeliest prediction here, while the judgement takes
    what happens without the attack (`avoidability.counterfactual`). So the two may differ.

    To people the driver of `avoidability.intention` reacts, not before they show their intention.
    Whether the AV sees them past others is not predicted here; the judgement knows it.
    """

    name = "fair"
    scope = "attack"
    keeps_plan = True

    def __init__(self, settings: Settings) -> None:
        self._driven = EpisodeHistory()

    def allowed(
        self, situation: Situation, own: Candidates, reactions: Sequence[Forecast], pairs: Pairs
    ) -> Bools:
        assert situation.unattacked is not None
        self._driven.note(situation, own)
        futures = own.forecast.futures
        return fair_candidates(situation, futures, situation.unattacked, self._driven)

    def confirmed(
        self, situation: Situation, own: Candidates, reaction: Forecast, pairs: Pairs, row: int
    ) -> bool:
        """Whether it is fair also if the AV follows the likeliest colliding reaction."""
        hits = pairs.collides[row]
        if not hits.any():
            return True
        futures = own.forecast.futures
        one = Futures(
            agent_id=futures.agent_id,
            position_m=futures.position_m[row : row + 1],
            heading_rad=futures.heading_rad[row : row + 1],
        )
        hit = Forecast(futures=reaction.futures, probability=reaction.probability * hits)
        return bool(fair_candidates(situation, one, hit, self._driven)[0])


class EpisodeHistory:
    """What AV and opponent have driven since the first plan, and what was expected of the opponent.

    A view contains the last second; between plans that are farther apart poses are interpolated.
    """

    def __init__(self) -> None:
        self._poses = np.empty((0, 2, 3))  # of both, at the steps up to the last plan
        self._step = 0
        self._expected_m = np.empty((0, 2))  # from the step after the first plan on

    def note(self, situation: Situation, own: Candidates) -> None:
        """Add the steps since the last plan; ``own``: the candidates of this one."""
        view = situation.view
        rows = [view.history.row(one) for one in (view.av_id, situation.opponent_id)]
        poses = np.concatenate(
            [view.history.position_m[rows], view.history.heading_rad[rows][..., None]], axis=-1
        ).swapaxes(0, 1)
        if not len(self._poses):
            self._expected_m = likeliest(own.forecast.futures.position_m, own.origin)
            self._poses = poses[-1:]
        elif view.step > self._step:
            seen = min(view.step - self._step, len(poses))
            gap = np.linspace(0, 1, view.step - self._step - seen + 2)[1:-1, None, None]
            before, after = self._poses[-1], poses[-seen]
            moved = after - before
            moved[:, 2] = frames.difference(after[:, 2], before[:, 2])
            self._poses = np.concatenate([self._poses, before + gap * moved, poses[-seen:]])
        self._step = view.step

    @property
    def past(self) -> PastPoses:
        """Without the present."""
        return PastPoses(self._poses[:-1, 0], self._poses[:-1, 1])

    def expected_m(self, steps: int) -> Floats:
        """(H + 1 + steps, 2) where the opponent was expected, from the first plan on."""
        count = len(self._poses) + steps
        found = np.full((count, 2), np.nan)
        known = self._expected_m[: count - 1]
        found[1 : 1 + len(known)] = known
        return found


def fair_candidates(
    situation: Situation, futures: Futures, av: Forecast, driven: EpisodeHistory | None = None
) -> Bools:
    """(N1) futures of the opponent that a reference driver in the AV's place can avoid.

    It takes over at the first sign of the attack since ``driven`` began, or now. Until it reacts,
    the AV drives as in the past and then follows the likeliest of its predicted futures ``av``.
    """
    view = situation.view
    now = _state(view, view.av_id)
    best = int(np.argmax(av.probability))
    ahead = av.futures.position_m[best]
    since = None
    if situation.person:
        since = _understood(situation, futures, av.futures.heading_rad[best], ahead, driven)
    return avoidable(
        AvAhead(
            now=now,
            size_m=situation.av_size_m,
            path_m=ahead,
            along_m=polylines.arc_lengths(np.concatenate([now.position_m[None], ahead])),
        ),
        OpponentFutures(
            now=_state(view, situation.opponent_id),
            size_m=situation.size_m,
            position_m=futures.position_m,
            heading_rad=futures.heading_rad,
        ),
        view.dt_s,
        by="vru" if situation.person else "any",
        take_over=TakeOver(
            past=PastPoses.none() if driven is None else driven.past,
            expected_m=None if driven is None else driven.expected_m(futures.position_m.shape[1]),
            since=since,
        ),
    )


def _understood(
    situation: Situation,
    futures: Futures,
    av_heading_rad: Floats,
    av_m: Floats,
    driven: EpisodeHistory | None,
) -> Ints:
    """(N) steps since ``driven`` began from which on a driver can act on futures of a person."""
    touch = boxes.overlap(
        futures.position_m,
        futures.heading_rad,
        situation.size_m,
        av_m,
        av_heading_rad,
        situation.av_size_m,
    )
    meets = touch.any(axis=1)
    view, past = situation.view, PastPoses.none() if driven is None else driven.past
    here = [view.history.position_m[view.history.row(one), -1]
            for one in (situation.opponent_id, view.av_id)]  # fmt: skip
    own_m = np.concatenate([past.opponent[:, :2], here[:1]])
    own_m = np.broadcast_to(own_m, (len(touch), *own_m.shape))
    since = intends_since(
        view.road,
        np.concatenate([own_m, futures.position_m], axis=1),
        np.concatenate([past.av[:, :2], here[1:], av_m]),
        np.where(meets, touch.argmax(axis=1) + own_m.shape[1], 0),
        view.dt_s,
        _heights_m(situation, own_m.shape[1], futures, av_m),
    )
    # a person that would miss the AV gives its driver no reason to act
    return np.where(meets, since, touch.shape[1] + own_m.shape[1])


def _heights_m(
    situation: Situation, known: int, futures: Futures, av_m: Floats
) -> tuple[Floats, Floats] | None:
    """Heights (N, K) of the opponent and (K) of the AV; in the first ``known`` steps as now."""
    levels = situation.levels
    if levels is None:
        return None
    own_z_m = levels.opponent_z_m(futures.position_m)
    now = np.full((len(own_z_m), known), levels.opponent[2])
    av_z_m = levels.av_z_m(av_m[None])[0]
    return np.concatenate([now, own_z_m], 1), np.append(np.full(known, levels.av[2]), av_z_m)


def _state(view: View, agent_id: AgentId) -> VehicleState:
    row = view.history.row(agent_id)
    return VehicleState(
        view.history.position_m[row, -1],
        float(view.history.heading_rad[row, -1]),
        float(view.history.speed_mps[row, -1]),
    )


class Clean(Constraint):
    """Up to its collision the candidate does not leave the road, nor touch another agent.

    A pedestrian comes from beside the road, but meets the AV on it, as in `OnRoad`. Agents that it
    touches at the first step do not count.
    """

    name = "clean"
    scope = "driven"

    def __init__(self, settings: Settings) -> None:
        pass

    def allowed(
        self, situation: Situation, own: Candidates, reactions: Sequence[Forecast], pairs: Pairs
    ) -> Bools:
        steps, first = np.arange(0, situation.horizon, _EVERY_STEPS), _first(pairs)
        touches = _touches_others(situation, own, steps) & (steps <= first[:, None])
        return ~(leaves_road(situation, own, first) | touches.any(axis=1))


def _first(pairs: Pairs) -> Floats:
    """(N1) first step at which a candidate collides with a reaction."""
    return np.asarray(pairs.collision_step.min(axis=1))


def _touches_others(situation: Situation, own: Candidates, steps: Ints) -> Bools:
    """(N1, S) whether candidates touch an agent other than the AV at steps (S)."""
    others, futures = situation.others(), own.forecast.futures
    position, heading = futures.position_m[:, steps], futures.heading_rad[:, steps]
    touched = np.zeros(heading.shape, bool)
    z_m = situation.view.history.z_m[situation.view.history.row(situation.opponent_id), -1]
    reach = (np.hypot(*situation.size_m) + np.hypot(*others.size_m.T))[:, None, None] / 2
    low, high = position.min(axis=0) - reach, position.max(axis=0) + reach
    theirs_m, theirs_rad = others.position_m[:, steps], others.heading_rad[:, steps]
    near = ((theirs_m >= low) & (theirs_m <= high)).all(axis=-1) & others.valid[:, steps]
    for row in np.flatnonzero(near.any(axis=1) & ~clear(others.z_m, z_m)):
        at = np.flatnonzero(near[row])
        theirs = theirs_m[row, at], theirs_rad[row, at], others.size_m[row]
        hit = boxes.touching(position[:, at], heading[:, at], situation.size_m, *theirs)
        if at[0] > 0 or not hit[:, 0].all():
            touched[:, at] |= hit
    return touched


class OnRoad(Constraint):
    """Up to its collision the candidate does not leave the road.

    A hit beside the road says little about the road. To cyclists cycle lanes are road. A pedestrian
    comes from beside it: the place where it meets the AV is on a lane of any kind.
    """

    name = "on_road"
    scope = "attack"

    def __init__(self, settings: Settings) -> None: ...

    def allowed(
        self, situation: Situation, own: Candidates, reactions: Sequence[Forecast], pairs: Pairs
    ) -> Bools:
        return ~leaves_road(situation, own, _first(pairs))


class WithTraffic(Constraint):
    """Up to its collision the candidate does not drive against the traffic for more than 1 s.

    A vehicle on the wrong side can hit anyone anywhere; one that drifts over the middle of the road
    meets the AV within that second. A pedestrian crosses: it does not walk along a lane for more
    than 2 s.
    """

    name = "with_traffic"
    scope = "attack"

    def __init__(self, settings: Settings) -> None:
        self._since: int | None = None

    def allowed(
        self, situation: Situation, own: Candidates, reactions: Sequence[Forecast], pairs: Pairs
    ) -> Bools:
        if self._since is None:
            self._since = situation.view.step
        return ~against_traffic(situation, own, _first(pairs), self._since)


class NoRearEnd(Constraint):
    """The candidate does not drive into the AV's rear end from behind.

    A vehicle that follows can do so anywhere, so that it says little about the road. A person does
    not run into its sides either: the AV's front meets it, while the AV drives. One that stands or
    creeps can do nothing against who walks into it.
    """

    name = "no_rear_end"
    scope = "attack"

    def __init__(self, settings: Settings) -> None: ...

    def allowed(
        self, situation: Situation, own: Candidates, reactions: Sequence[Forecast], pairs: Pairs
    ) -> Bools:
        sizes = situation.size_m, situation.av_size_m
        ends = off_front if situation.person else rear_ends
        behind = ends(own.forecast.futures, reactions, *sizes, pairs.collision_step)
        mass = (pairs.reaction_probability * behind).sum(axis=1)
        allowed: Bools = mass <= _BEHIND_SHARE * pairs.mass
        if situation.person:
            stands = av_stands(situation, reactions, pairs.collision_step)
            allowed &= 2 * (pairs.reaction_probability * stands).sum(axis=1) <= pairs.mass
        return allowed


class Sector(Constraint):
    """The AV is first hit in the wanted sector."""

    name = "sector"
    scope = "preferred"
    keeps_plan = True

    def __init__(self, settings: Settings) -> None:
        self._sector, self._count = settings.wanted_sector, settings.form.goal_candidates

    def references(self, situation: Situation, paths: list[OwnPath]) -> list[References]:
        assert self._sector is not None
        return [aimed_paths(situation, paths, self._sector, self._count)]

    def allowed(
        self, situation: Situation, own: Candidates, reactions: Sequence[Forecast], pairs: Pairs
    ) -> Bools:
        assert pairs.sector is not None
        return pairs.sector == self._sector


CONSTRAINTS: Final[tuple[type[Constraint], ...]] = (
    Sector, Lawful, Clean, Fair, OnRoad, WithTraffic, NoRearEnd,
)  # fmt: skip
"""All constraints; their candidates are added in this order."""


def made(settings: Settings) -> tuple[Constraint, ...]:
    """The constraints of the settings, for one attack."""
    return tuple(one(settings) for one in CONSTRAINTS if one.name in settings.constrained)
