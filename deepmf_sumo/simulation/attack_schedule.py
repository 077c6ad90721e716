"""Which vehicle attacks when: one opponent, or several in turn until the time is over."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import chain

import numpy as np

from deepmf_sumo.datatypes import DT_S, AgentId, Event, Floats, Plan, Turn, TurnRules, View
from deepmf_sumo.datatypes.plan import TurnEnd
from deepmf_sumo.datatypes.rollout import decisive
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.geometry import boxes
from deepmf_sumo.geometry.ground import distance_m, ground_of
from deepmf_sumo.policies.base import Policy
from deepmf_sumo.simulation.contacts import overlapping
from deepmf_sumo.simulation.frame import Frame, Pose
from deepmf_sumo.simulation.ownership import NextOwner
from deepmf_sumo.simulation.way_on import WayOn

_MOVED_M = 0.05
_PATIENCE_STEPS = 300
"""A vehicle that has not got back onto a lane by then is SUMO's, wherever it is."""


class Opponent:
    """The vehicle that a policy has chosen, the plans for it, and how its attack goes.

    Args:
        policy: chooses and drives it.
        view: now.
        rng: for the policy.
        next_owner: drives it where no plan does; see `ownership`.

    Attributes:
        id: None if there is no policy, or the policy found no opponent.
        first_step: at which it was chosen.
        follows: whether the last plan has a pose for the last step.
        harmless: step since which no plan collides with a predicted future of the AV; None if the
            last plan does.
        gap_m: least distance from the AV so far.

    Raises SimulationError for a choice that is not among the agents of the view.
    """

    def __init__(
        self,
        policy: Policy | None,
        view: View,
        rng: np.random.Generator,
        next_owner: NextOwner,
    ) -> None:
        self._policy = policy
        self._next_owner, self._road = next_owner, view.road
        self._driven: Pose | None = None  # where it was put for the last step
        self._way: WayOn | None = None
        self._alone_steps = 0
        self._planned_from = np.zeros(3)
        self.first_step = view.step
        self.follows = False
        self.harmless: int | None = view.step
        self.gap_m = np.inf
        self.plans: list[Plan] = []
        self.events: list[Event] = []
        self.id: AgentId | None = policy.reset(view, rng) if policy else None
        if self.id is not None and (self.id == view.av_id or self.id not in view.history.ids):
            raise SimulationError(
                f"The policy chose '{self.id}' as the opponent, which is not one of the agents "
                "around the AV at the current step."
            )

    def due(self, step: int) -> bool:
        """Whether the policy plans at this step: at the first, and every period after it."""
        if self._policy is None or self.id is None:
            return False
        period = self._policy.period_steps
        elapsed = step - self.first_step
        return elapsed == 0 or (period is not None and elapsed % period == 0)

    def replan(self, view: View) -> None:
        """Ask for a new plan, unless the opponent has left; the policy may keep the last one."""
        if self._policy is None or self.id not in view.history.ids:
            return
        plan = self._policy.plan(view)
        if plan is None:
            return
        if plan.agent_id != self.id:
            raise SimulationError(
                f"The policy planned for '{plan.agent_id}', but its opponent is '{self.id}'."
            )
        self.plans.append(plan)
        row = view.history.row(self.id)
        here = view.history.position_m[row, -1], view.history.z_m[row, -1:]
        self._planned_from = np.concatenate(here)
        if plan.reason is None or plan.reason.collides.any():
            self.harmless = None
        elif self.harmless is None:
            self.harmless = view.step

    def advance(self, step: int) -> Pose | None:
        """Go on to ``step``: where the opponent is put, or None where its next owner drives it."""
        plan = self.plans[-1] if self.plans else None
        ended = self.follows
        self.follows = plan is not None and plan.covers(step)
        if plan is not None and self.follows:
            self._driven, self._way, self._alone_steps = _planned(plan, step), None, 0
            return self._driven
        pose = self.leave(step)
        if ended and self.id is not None:
            detail = "it is driven on from where it is" if pose is None else self._on_its_way()
            self.events.append(Event(step=step, agent_id=self.id, kind="plan_ended", detail=detail))
        return pose

    def leave(self, step: int) -> Pose | None:
        """Go on to ``step`` without a plan: to the next owner as soon as that can take it."""
        agent, owner = self.id, self._next_owner
        if agent is None or self._driven is None:
            return None
        creep_mps = owner.creep_mps(agent)
        given_up = creep_mps > 0 and self._alone_steps >= _PATIENCE_STEPS
        if given_up or owner.takes(agent, step, self._driven):
            self._driven, self._way, self._alone_steps = None, None, 0
            return None
        self._alone_steps += 1
        if self._way is None:
            cost = partial(owner.lane_cost, agent)
            self._way = WayOn(self._road, self._driven, self._height_m(), creep_mps, cost)
        self._driven = self._way.next(partial(owner.clear, agent))
        return self._driven

    def go_on_as(self, before: "Opponent") -> None:
        """It was the opponent ``before``, and is still on its way to its next owner."""
        self._driven, self._way = before._driven, before._way  # noqa: SLF001
        self._alone_steps = before._alone_steps  # noqa: SLF001

    def _on_its_way(self) -> str:
        assert self.id is not None
        if self._next_owner.creep_mps(self.id) > 0:
            return "SUMO cannot drive it from where it is: it returns to a lane first"
        return "the log has it elsewhere: it comes to a stop"

    def _height_m(self) -> float:
        """Height at the last pose, which follows the road from where the plan began."""
        plan, driven = self.plans[-1], self._driven
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
"""An attack that began later before the end would be judged as one that failed."""


class AttackSchedule:
    """The opponents of an episode, each chosen by the policy as if the episode began there.

    A loop calls `replan` where it is `due`, `advance` before each step and `after_step` after it.

    Args:
        policy: drives the opponents; None: no attack.
        view: at the first step.
        rng: for the policy.
        rules: when an attack ends; None: one opponent attacks, and a contact ends the episode.
        next_owner: drives opponents where no plan does; see `ownership`.

    Attributes:
        closed: the attacks in turn that are over; empty without rules.
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
        self._opponents: list[Opponent] = []
        self.closed: tuple[Turn, ...] = ()
        self._ongoing: Opponent | None = None
        self._leaving: list[Opponent] = []
        self._clear = True
        self._next = self._latest = view.step
        self._begin(view)

    @property
    def attacker(self) -> AgentId | None:
        """The vehicle whose contact with the AV counts as a hit."""
        return self._ongoing.id if self._ongoing else None

    @property
    def leaving(self) -> bool:
        """Whether a vehicle whose attack is over is still on its way to its next owner."""
        return bool(self._leaving)

    @property
    def opponent_id(self) -> AgentId | None:
        """The opponent of the episode; of several the one of the decisive attack."""
        if self._rules is None:
            return self._opponents[0].id
        turn = decisive(self.closed)
        return turn.opponent_id if turn else None

    @property
    def plans(self) -> list[Plan]:
        """The plans of all opponents so far."""
        return list(chain.from_iterable(one.plans for one in self._opponents))

    @property
    def events(self) -> list[Event]:
        """The events of all opponents so far."""
        return list(chain.from_iterable(one.events for one in self._opponents))

    def due(self, step: int) -> bool:
        """Whether an opponent is to be chosen, or the policy has to plan."""
        if self._ongoing is not None:
            return self._ongoing.due(step)
        return step >= self._next and (self._clear or step >= self._latest)

    def replan(self, view: View) -> None:
        """Choose an opponent if there is none, and plan."""
        if self._ongoing is None:
            self._begin(view)
        if self._ongoing is not None:
            self._ongoing.replan(self._within_turn(view, self._ongoing.first_step))

    def advance(self, step: int) -> dict[AgentId, Pose | None]:
        """Go on to ``step``: where the vehicles of attacks are put.

        None: the world drives the vehicle as all others, from this step on.
        """
        poses = {one.id: one.leave(step) for one in self._leaving if one.id is not None}
        self._leaving = [one for one in self._leaving if one.id and poses[one.id] is not None]
        if self._ongoing is not None and self._ongoing.id is not None:
            poses[self._ongoing.id] = self._ongoing.advance(step)
        return poses

    def after_step(self, step: int, frame: Frame, size_m: Floats, *, hit: bool) -> bool:
        """Close the attack if it is over; returns whether the episode is.

        Args:
            step: of the frame.
            frame: of N agents.
            size_m: (N, 2) their lengths and widths.
            hit: the AV and the attacker have come into contact.
        """
        if self._rules is None:
            return hit
        self._leaving = [one for one in self._leaving if one.id in frame.ids]
        if self._av not in frame.ids:
            return False
        if self._ongoing is None:
            me = frame.ids.index(self._av)
            self._clear = not overlapping(
                me, frame.position_m, frame.heading_rad, size_m, frame.z_m
            )
            return False
        ended = self._ending(self._ongoing, self._rules, step, frame, size_m, hit=hit)
        if ended is not None:
            self._close(step, ended)
            self._leaving = [one for one in self._leaving if one.id in frame.ids]
        return False

    def finish(self, step: int, ended: TurnEnd) -> None:
        """Close the current attack: the episode is over."""
        if self._rules is not None and self._ongoing is not None:
            self._close(step, ended)

    def _begin(self, view: View) -> None:
        """Choose an opponent, unless the end is near or no vehicle can attack."""
        if self._rules is None:
            self._start(Opponent(self._policy, view, self._rng, self._next_owner))
            return
        self._next = view.step + _RETRY_STEPS
        if self._policy is None or view.steps_left < _SHORTEST_STEPS:
            return
        for shown in self._choices(self._within_turn(view, view.step), self._rules):
            opponent = Opponent(self._policy, shown, self._rng, self._next_owner)
            if opponent.id is not None:
                self._start(opponent)
                return

    def _start(self, opponent: Opponent) -> None:
        for one in self._leaving:
            if one.id == opponent.id:
                opponent.go_on_as(one)
        self._leaving = [one for one in self._leaving if one.id != opponent.id]
        self._opponents.append(opponent)
        self._ongoing = opponent

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

    def _ending(
        self,
        opponent: Opponent,
        rules: TurnRules,
        step: int,
        frame: Frame,
        size_m: Floats,
        *,
        hit: bool,
    ) -> TurnEnd | None:
        """Why the attack is over; None while it goes on."""
        if opponent.id not in frame.ids:
            return "gone"
        pair = [frame.ids.index(self._av), frame.ids.index(opponent.id)]
        mine, theirs = frame.position_m[pair]
        heading, size = frame.heading_rad[pair], size_m[pair]
        gap_m = float(boxes.gap(mine, heading[0], size[0], theirs, heading[1], size[1]))
        gap_m = float(distance_m(np.array(gap_m), *frame.z_m[pair]))
        opponent.gap_m = 0.0 if hit else min(opponent.gap_m, gap_m)
        plans_once = self._policy is not None and self._policy.period_steps is None
        reasons: dict[TurnEnd, bool] = {
            "contact": hit,
            "out_of_reach": bool(np.hypot(*(mine - theirs)) > rules.reach_m),
            "too_long": step - opponent.first_step >= _steps(rules.longest_s),
            "plan_ended": plans_once and not opponent.follows,
            "harmless": opponent.harmless is not None
            and step - opponent.harmless >= _steps(rules.harmless_s),
        }
        return next((reason for reason, holds in reasons.items() if holds), None)

    def _close(self, step: int, ended: TurnEnd) -> None:
        opponent, rules = self._ongoing, self._rules
        assert opponent is not None
        assert opponent.id is not None
        assert rules is not None
        turn = Turn(
            opponent_id=opponent.id,
            first_step=opponent.first_step,
            last_step=step,
            ended=ended,
            gap_m=opponent.gap_m,
        )
        self.closed = (*self.closed, turn)
        self._leaving.append(opponent)
        self._ongoing = None
        self._clear = False
        self._next = step + _PAUSE_STEPS
        self._latest = step + _steps(rules.clear_s)


def _steps(seconds: float) -> int:
    return round(seconds / DT_S)
