"""Which vehicles attack when: one, several together, or several in turn until the time is over."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain

import numpy as np

from deepmf_sumo.errors import RunError
from deepmf_sumo.scene import DT_S, AgentId, Event, Floats, Plan, Turn, TurnRules, View
from deepmf_sumo.scene.geometry import boxes
from deepmf_sumo.scene.geometry.ground import distance_m, ground_of
from deepmf_sumo.scene.geometry.road import all_lanes, lanes_for_cars
from deepmf_sumo.scene.plan import TurnEnd
from deepmf_sumo.scene.policy import Policy, chosen, planned
from deepmf_sumo.scene.rollout import decisive
from deepmf_sumo.sumo.simulation.contacts import overlapping
from deepmf_sumo.sumo.simulation.frame import Frame, Pose
from deepmf_sumo.sumo.simulation.on_foot import Walk
from deepmf_sumo.sumo.simulation.ownership import NextOwner
from deepmf_sumo.sumo.simulation.way_on import WayOn

_MOVED_M = 0.05
_BACK_ON_LANE_STEPS = 300
"""A vehicle that is not back on a lane by then is SUMO's, which moves it to one or loses it."""


class AttackingVehicle:
    """A vehicle that a policy has chosen, its last plan, and how its attack goes.

    Args:
        agent: its id.
        view: at the step at which it was chosen.
        next_owner: drives it where no plan does; see `ownership`.

    Attributes:
        first_step: at which it was chosen.
        follows: whether the last plan has a pose for the last step.
        harmless: step since which no plan collides with a predicted future of the AV; None if the
            last plan does.
        hit: whether it has come into contact with the AV.
        gap_m, away_m: least gap to the AV so far, and the last distance between the centres.
    """

    def __init__(self, agent: AgentId, view: View, next_owner: NextOwner) -> None:
        self.id = agent
        self._kind = view.history.kinds[view.history.row(agent)]
        self._next_owner, self._road = next_owner, view.road
        self._plan: Plan | None = None
        self._driven: Pose | None = None  # where it was put for the last step
        self._way: WayOn | Walk | None = None
        self._alone_steps = 0
        self._planned_from = np.zeros(3)
        self.first_step = view.step
        self.follows = self.hit = False
        self.harmless: int | None = view.step
        self.gap_m = self.away_m = np.inf
        self.events: list[Event] = []

    def follow(self, plan: Plan, view: View) -> None:
        """Follow a new plan, made from the view."""
        self._plan = plan
        row = view.history.row(self.id)
        here = view.history.position_m[row, -1], view.history.z_m[row, -1:]
        self._planned_from = np.concatenate(here)
        if plan.reason is None or plan.reason.collides.any():
            self.harmless = None
        elif self.harmless is None:
            self.harmless = view.step

    def advance(self, step: int) -> Pose | None:
        """Go on to ``step``: where it is put, or None where its next owner drives it."""
        plan, ended = self._plan, self.follows
        self.follows = plan is not None and plan.covers(step)
        if plan is not None and self.follows:
            self._driven, self._way, self._alone_steps = _planned(plan, step), None, 0
            return self._driven
        pose = self.leave(step)
        if ended:
            detail = "it is driven on from where it is" if pose is None else self._on_its_way()
            self.events.append(Event(step=step, agent_id=self.id, kind="plan_ended", detail=detail))
        return pose

    def leave(self, step: int) -> Pose | None:
        """Go on to ``step`` without a plan: to the next owner as soon as that can take it."""
        owner = self._next_owner
        if self._driven is None:
            return None
        creep_mps = owner.creep_mps(self.id)
        given_up = creep_mps > 0 and self._alone_steps >= _BACK_ON_LANE_STEPS
        if given_up or owner.takes(self.id, step, self._driven):
            self._driven, self._way, self._alone_steps = None, None, 0
            return None
        self._alone_steps += 1
        if self._way is None:
            self._way = owner.walk(self.id, self._driven) or self._way_on(creep_mps)
        self._driven = self._way.next(partial(owner.clear, self.id))
        return self._driven

    def _way_on(self, creep_mps: float) -> WayOn:
        assert self._driven is not None
        cost, z_m = partial(self._next_owner.lane_cost, self.id), self._height_m()
        lanes = all_lanes if self._kind == "cyclist" else lanes_for_cars
        return WayOn(self._road, self._driven, z_m, creep_mps, cost, lanes)

    def go_on_as(self, before: "AttackingVehicle") -> None:
        """Continue the way to the next owner that it began as ``before``."""
        self._driven, self._way = before._driven, before._way  # noqa: SLF001
        self._alone_steps = before._alone_steps  # noqa: SLF001

    def measure(self, av: AgentId, frame: Frame, size_m: Floats, *, hit: bool) -> None:
        """How near it is to the AV in a frame that has both; see `AttackSchedule.after_step`."""
        pair = [frame.ids.index(av), frame.ids.index(self.id)]
        mine, theirs = frame.position_m[pair]
        heading, size = frame.heading_rad[pair], size_m[pair]
        gap_m = float(boxes.gap(mine, heading[0], size[0], theirs, heading[1], size[1]))
        gap_m = float(distance_m(np.array(gap_m), *frame.z_m[pair]))
        self.hit |= hit
        self.gap_m = 0.0 if hit else min(self.gap_m, gap_m)
        self.away_m = float(np.hypot(*(mine - theirs)))

    def _on_its_way(self) -> str:
        if self._next_owner.creep_mps(self.id) > 0:
            if self._kind == "pedestrian":
                return "SUMO cannot walk it on from where it is: it goes to a footway first"
            return "SUMO cannot drive it from where it is: it returns to a lane first"
        return "the log has it elsewhere: it comes to a stop"

    def _height_m(self) -> float:
        """Height at the last pose, which follows the road from where the plan began."""
        plan, driven = self._plan, self._driven
        assert plan is not None
        assert driven is not None
        way = [self._planned_from[:2], *plan.position_m, (driven.x_m, driven.y_m)]
        z_m = ground_of(self._road).follow(np.array([way]), self._planned_from[2:])
        return float(z_m[0, -1])


def _planned(plan: Plan, step: int) -> Pose:
    """The pose that a plan has for a step."""
    at = step - plan.first_step
    return Pose(
        x_m=float(plan.position_m[at, 0]),
        y_m=float(plan.position_m[at, 1]),
        heading_rad=float(plan.heading_rad[at]),
        speed_mps=float(plan.speed_mps[at]),
        course_rad=_course(plan.position_m[max(at - 1, 0) : at + 2]),
    )


def _course(position_m: Floats) -> float | None:
    """Direction of motion: the centre of a car does not move along its heading in a bend."""
    x, y = position_m[-1] - position_m[0]
    return float(np.arctan2(y, x)) if np.hypot(x, y) > _MOVED_M else None


_RETRY_STEPS = 10
"""Until the next choice after one in which no vehicle could attack."""
_PAUSE_STEPS = 10
"""From one attack to the next: after it the history in views is free of the last attack."""
_SHORTEST_STEPS = 30
"""An attack that begins with less time left would count as a failure."""


class AttackSchedule:
    """Which vehicles attack when: one, several together, or one after another.

    A loop calls `replan` where it is `due`, `advance` before each step and `after_step` after it.
    Each attack is chosen by the policy as if the episode began there, and begins for all its
    vehicles at the same step. It is over for all of them when one comes into contact with the AV.

    Args:
        policy: drives the vehicles; None: no attack.
        view: at the first step.
        rng: for the policy.
        rules: when an attack ends and another one begins; None: there is one attack, which lasts
            as long as the episode, and a contact ends both.
        next_owner: drives the vehicles where no plan does; see `ownership`.

    Attributes:
        closed: the attacks that are over, vehicle by vehicle; of a vehicle that attacks alone
            only with rules.
        plans: of all vehicles, in the order in which they were made.
    """

    def __init__(
        self,
        policy: Policy | None,
        view: View,
        rng: np.random.Generator,
        rules: TurnRules | None,
        next_owner: NextOwner,
    ) -> None:
        self._policy, self._rng, self._rules = policy, rng, rules
        self._next_owner = next_owner
        self._av = view.av_id
        self._vehicles: list[AttackingVehicle] = []
        self.closed: tuple[Turn, ...] = ()
        self.plans: list[Plan] = []
        self._ongoing: list[AttackingVehicle] = []
        self._supporting: list[AttackingVehicle] = []
        self._leaving: list[AttackingVehicle] = []
        self._clear = True
        self._next = self._latest = view.step
        self._begin(view)

    @property
    def attackers(self) -> tuple[AgentId, ...]:
        """The vehicles whose contact with the AV counts as a hit."""
        return tuple(one.id for one in self._ongoing)

    @property
    def supporters(self) -> tuple[AgentId, ...]:
        """The vehicles that support the attackers by their motion (`Plan.supports`)."""
        return tuple(one.id for one in self._supporting)

    @property
    def leaving(self) -> bool:
        """Whether a vehicle whose attack is over is still on its way to its next owner."""
        return bool(self._leaving)

    @property
    def of_episode(self) -> tuple[AgentId, ...]:
        """The vehicles of the decisive attack, after `finish`; see `Rollout.attackers`."""
        turn = decisive(self.closed)
        if turn is None:
            return self.attackers
        others = (one for one in self.closed if one.first_step == turn.first_step)
        return tuple(dict.fromkeys([turn.opponent_id, *(one.opponent_id for one in others)]))

    @property
    def events(self) -> list[Event]:
        """The events of all vehicles so far."""
        return list(chain.from_iterable(one.events for one in self._vehicles))

    def due(self, step: int) -> bool:
        """Whether vehicles are to be chosen, or the policy has to plan.

        It plans at the first step of an attack, and every period after it.
        """
        if self._policy is not None and self._ongoing:
            period = self._policy.period_steps
            elapsed = step - self._ongoing[0].first_step
            return elapsed == 0 or (period is not None and elapsed % period == 0)
        if self._rules is None:
            return False
        return step >= self._next and (self._clear or step >= self._latest)

    def replan(self, view: View) -> None:
        """Choose vehicles if none attacks, and plan, unless all of them have left."""
        if self._rules is not None and not self._ongoing:
            self._begin(view)
        there = [one for one in self._ongoing if one.id in view.history.ids]
        if self._policy is None or not there:
            return
        view = self._within_turn(view, there[0].first_step)
        plans = planned(self._policy, view, self.attackers)
        for agent, plan in plans.items():
            if plan.supports is not None and agent not in self.supporters:
                self._supporting += self._joining([agent], view)
        for one in (*there, *self._supporting):
            if one.id in plans:
                one.follow(plans[one.id], view)
                self.plans.append(plans[one.id])

    def advance(self, step: int) -> dict[AgentId, Pose | None]:
        """Go on to ``step``: where the vehicles of attacks are put.

        None: the world drives the vehicle as all others, from this step on.
        """
        poses = {one.id: one.leave(step) for one in self._leaving}
        self._leaving = [one for one in self._leaving if poses[one.id] is not None]
        driven = (*self._ongoing, *self._supporting)
        return poses | {one.id: one.advance(step) for one in driven}

    def after_step(
        self, step: int, frame: Frame, size_m: Floats, hits: Collection[AgentId]
    ) -> bool:
        """Close finished attacks; returns whether the episode is finished.

        Args:
            step: of the frame.
            frame: of N agents.
            size_m: (N, 2) their lengths and widths.
            hits: the attackers that have come into contact with the AV.
        """
        self._leaving = [one for one in self._leaving if one.id in frame.ids]
        self._supporting = [one for one in self._supporting if one.id in frame.ids]
        if self._av not in frame.ids:
            return False
        if self._rules is None and len(self._ongoing) < 2:
            return bool(hits)
        for one in self._ongoing:
            if one.id in frame.ids:
                one.measure(self._av, frame, size_m, hit=one.id in hits)
        if self._rules is None:
            return bool(hits)
        if not self._ongoing:
            me = frame.ids.index(self._av)
            self._clear = not overlapping(
                me, frame.position_m, frame.heading_rad, size_m, frame.z_m
            )
            return False
        self._close_ended(self._rules, step, frame)
        self._leaving = [one for one in self._leaving if one.id in frame.ids]
        return False

    def finish(self, step: int, ended: TurnEnd) -> None:
        """Close the current attack: the episode is over."""
        if self._rules is not None or len(self._ongoing) > 1:
            for one in self._ongoing:
                self._close(one, step, _own_end(one) if ended == "contact" else ended)
            self._ongoing = []

    def _begin(self, view: View) -> None:
        """Choose vehicles, unless the end is near or none can attack."""
        self._next = view.step + _RETRY_STEPS
        if self._policy is None:
            return
        if self._rules is None:
            self._start(self._chosen(self._policy, view), view)
            return
        if view.steps_left < _SHORTEST_STEPS:
            return
        for shown in self._choices(self._within_turn(view, view.step), self._rules):
            self._start(self._chosen(self._policy, shown), shown)
            if self._ongoing:
                return

    def _chosen(self, policy: Policy, view: View) -> tuple[AgentId, ...]:
        """The choice of the policy among those that it can drive.

        Raises RunError as the policy does; the message says who was left out, and why.
        """
        refusals = self._next_owner.refusals(view.history.ids)
        if not refusals:
            return chosen(policy, view, self._rng)
        tracks = view.history
        kept = [row for row, agent in enumerate(tracks.ids) if agent not in refusals]
        try:
            return chosen(policy, replace(view, history=tracks.select(kept)), self._rng)
        except RunError as error:
            why = "; ".join(dict.fromkeys(refusals.values()))
            raise RunError(f"{error} Left out: {why}.") from None

    def _start(self, agents: Sequence[AgentId], view: View) -> None:
        self._ongoing = self._joining(agents, view)

    def _joining(self, agents: Sequence[AgentId], view: View) -> list[AttackingVehicle]:
        """Vehicles that the policy drives from now on; some may be on their way from before."""
        joining = [AttackingVehicle(agent, view, self._next_owner) for agent in agents]
        before = {one.id: one for one in self._leaving}
        for one in joining:
            if one.id in before:
                one.go_on_as(before.pop(one.id))
        self._leaving = list(before.values())
        self._vehicles += joining
        return joining

    def _choices(self, view: View, rules: TurnRules) -> Iterator[View]:
        """The view without vehicles that attacked lately, then with them.

        Neither has the agents that overlap the AV: they cannot come into contact with it any more.
        """
        tracks = view.history
        touching = overlapping(
            tracks.row(self._av),
            tracks.position_m[:, -1],
            tracks.heading_rad[:, -1],
            tracks.size_m[:, :2],
            tracks.z_m[:, -1],
        )
        since = view.step - _steps(rules.again_after_s)
        tired = {turn.opponent_id for turn in self.closed if turn.last_step > since}
        able = [row for row in range(tracks.agents) if row not in touching]
        rested = [row for row in able if tracks.ids[row] not in tired]
        for rows in (rested, able) if rested != able else (able,):
            yield replace(view, history=tracks.select(rows))

    def _within_turn(self, view: View, first_step: int) -> View:
        """The view with the end of the attack as that of the case."""
        if self._rules is None:
            return view
        left = first_step + _steps(self._rules.longest_s) - view.step
        return replace(view, steps_left=min(view.steps_left, left))

    def _close_ended(self, rules: TurnRules, step: int, frame: Frame) -> None:
        """Close the attacks of the vehicles that are done; a contact ends those of all."""
        over = any(one.hit for one in self._ongoing)
        going = []
        for one in self._ongoing:
            ended = self._ending(one, rules, step, frame)
            if ended is None and not over:
                going.append(one)
            else:
                self._close(one, step, ended or _own_end(one))
        self._ongoing = going
        if not going:
            self._leaving += self._supporting
            self._supporting = []
            self._clear = False
            self._next = step + _PAUSE_STEPS
            self._latest = step + _steps(rules.clear_s)

    def _ending(
        self, one: AttackingVehicle, rules: TurnRules, step: int, frame: Frame
    ) -> TurnEnd | None:
        """Why the attack of a vehicle is over; None while it goes on."""
        if one.id not in frame.ids:
            return "gone"
        plans_once = self._policy is not None and self._policy.period_steps is None
        reasons: dict[TurnEnd, bool] = {
            "contact": one.hit,
            "out_of_reach": one.away_m > rules.reach_m,
            "too_long": step - one.first_step >= _steps(rules.longest_s),
            "plan_ended": plans_once and not one.follows,
            "harmless": one.harmless is not None
            and step - one.harmless >= _steps(rules.harmless_s),
        }
        return next((reason for reason, holds in reasons.items() if holds), None)

    def _close(self, one: AttackingVehicle, step: int, ended: TurnEnd) -> None:
        turn = Turn(
            opponent_id=one.id,
            first_step=one.first_step,
            last_step=step,
            ended=ended,
            gap_m=one.gap_m,
        )
        self.closed = (*self.closed, turn)
        self._leaving.append(one)


def _own_end(one: AttackingVehicle) -> TurnEnd:
    """How an attack ended for one of its vehicles, where a contact ended it for all."""
    return "contact" if one.hit else "other_hit"


def _steps(seconds: float) -> int:
    return round(seconds / DT_S)
