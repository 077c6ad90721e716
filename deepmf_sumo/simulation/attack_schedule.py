"""Which vehicle attacks when: one opponent, or several in turn until the time is over."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from deepmf_sumo.datatypes import DT_S, AgentId, Event, Floats, Plan, Turn, TurnRules, View
from deepmf_sumo.datatypes.plan import TurnEnd
from deepmf_sumo.datatypes.rollout import decisive
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.geometry import boxes
from deepmf_sumo.geometry.ground import clear, distance_m
from deepmf_sumo.policies.base import Policy
from deepmf_sumo.simulation.frame import Frame, Pose

_MOVED_M = 0.05


class Opponent:
    """Asks the policy for plans at the first view and every period after it.

    ``id`` is None where there is no policy, or nobody to attack.
    """

    def __init__(self, policy: Policy | None, view: View, rng: np.random.Generator) -> None:
        self._policy = policy
        self._start = view.step
        self._follows = False
        self.plans: list[Plan] = []
        self.events: list[Event] = []
        self.id: AgentId | None = policy.reset(view, rng) if policy else None
        if self.id is not None and (self.id == view.av_id or self.id not in view.history.ids):
            raise SimulationError(
                f"The policy chose '{self.id}' as the opponent, which is not one of the agents "
                "around the AV at the current step."
            )

    def due(self, step: int) -> bool:
        """Whether the policy has to plan at this step."""
        if self._policy is None or self.id is None:
            return False
        period = self._policy.period_steps
        elapsed = step - self._start
        return elapsed == 0 or (period is not None and elapsed % period == 0)

    def replan(self, view: View) -> None:
        """A new plan, unless the policy keeps the last one or the opponent has gone."""
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

    def pose(self, step: int) -> Pose | None:
        """Where the opponent shall be at ``step``; None where no plan says so."""
        plan = self.plans[-1] if self.plans else None
        follows = plan is not None and plan.covers(step)
        if self.id is not None and self._follows and not follows:
            detail = "the opponent goes on without a plan"
            self.events.append(Event(step=step, agent_id=self.id, kind="plan_ended", detail=detail))
        self._follows = follows
        if plan is None or not follows:
            return None
        at = step - plan.first_step
        return Pose(
            x_m=float(plan.position_m[at, 0]),
            y_m=float(plan.position_m[at, 1]),
            heading_rad=float(plan.heading_rad[at]),
            speed_mps=float(plan.speed_mps[at]),
            course_rad=_course(plan.position_m[max(at - 1, 0) : at + 2]),
        )


def _course(position_m: Floats) -> float | None:
    """Direction of motion: a car's centre does not move along its heading in a bend."""
    x, y = position_m[-1] - position_m[0]
    return float(np.arctan2(y, x)) if np.hypot(x, y) > _MOVED_M else None


_LOOK_AGAIN_STEPS = 10
"""After which somebody is looked for again where nobody could attack."""
_PAUSE_STEPS = 10
"""From one turn to the next: the second that views show of the past is free of the last attack."""
_SHORTEST_STEPS = 30
"""No turn is begun later before the end: it would be judged as one that failed."""


@dataclass(slots=True, kw_only=True)
class _Open:
    """The turn that is going on; ``harmless`` since a step, or None where the last plan may hit."""

    opponent: Opponent
    first_step: int
    harmless: int | None
    gap_m: float = np.inf
    driven: bool = True


class Turns:
    """The opponents of an episode, each chosen by the policy as if the episode began there.

    Args:
        policy: drives them; None attacks nobody.
        view: at the first step.
        rng: for the policy.
        rules: when an opponent is spent; None: one attacks, and a hit ends the episode.
    """

    def __init__(
        self, policy: Policy | None, view: View, rng: np.random.Generator, rules: TurnRules | None
    ) -> None:
        self._policy, self._rng, self._rules = policy, rng, rules
        self._av = view.av_id
        self._opponents: list[Opponent] = []
        self._closed: list[Turn] = []
        self._open: _Open | None = None
        self._released: AgentId | None = None
        self._clear = True
        self._next = self._latest = view.step
        self._begin(view)

    @property
    def id(self) -> AgentId | None:
        """Whom the stage is to put at the pose, or to let go."""
        return self.attacker or self._released

    @property
    def attacker(self) -> AgentId | None:
        """Whose contact with the AV is a hit."""
        return self._open.opponent.id if self._open else None

    @property
    def opponent_id(self) -> AgentId | None:
        """The opponent; of several the one of the decisive turn."""
        if self._rules is None:
            return self._opponents[0].id
        turn = decisive(self._closed)
        return turn.opponent_id if turn else None

    @property
    def plans(self) -> list[Plan]:
        """Of all opponents so far."""
        return list(chain.from_iterable(one.plans for one in self._opponents))

    @property
    def events(self) -> list[Event]:
        """Of all opponents so far."""
        return list(chain.from_iterable(one.events for one in self._opponents))

    @property
    def closed(self) -> tuple[Turn, ...]:
        """The turns that are over; none where there is one opponent alone."""
        return tuple(self._closed)

    def due(self, step: int) -> bool:
        """Whether an opponent is to be chosen, or the policy has to plan."""
        if self._open is not None:
            return self._open.opponent.due(step)
        return step >= self._next and (self._clear or step >= self._latest)

    def replan(self, view: View) -> None:
        """Choose an opponent if there is none, and plan."""
        if self._open is None:
            self._begin(view)
        if self._open is None:
            return
        opponent = self._open.opponent
        count = len(opponent.plans)
        opponent.replan(self._within_turn(view, self._open.first_step))
        if len(opponent.plans) > count:
            reason = opponent.plans[-1].reason
            if reason is None or reason.collides.any():
                self._open.harmless = None
            elif self._open.harmless is None:
                self._open.harmless = view.step

    def pose(self, step: int) -> Pose | None:
        """Where the opponent shall be at ``step``; None where no plan says so.

        To be asked once a step.
        """
        if self._open is None:
            return None
        pose = self._open.opponent.pose(step)
        self._open.driven = pose is not None
        return pose

    def after_step(self, step: int, frame: Frame, size_m: Floats, *, hit: bool) -> bool:
        """Look at what has become of a step; whether the episode is over.

        Args:
            step: of the frame.
            frame: of N agents.
            size_m: (N, 2) their lengths and widths.
            hit: the AV and the attacker have come into contact.
        """
        self._released = None
        if self._rules is None:
            return hit
        if self._av not in frame.ids:
            return False
        if self._open is None:
            touching = _overlapping(
                self._av, frame.ids, frame.position_m, frame.heading_rad, size_m, frame.z_m
            )
            self._clear = not touching
            return False
        ended = self._ending(self._open, self._rules, step, frame, size_m, hit=hit)
        if ended is not None:
            self._released = self.attacker if self.attacker in frame.ids else None
            self._close(step, ended)
        return False

    def finish(self, step: int, ended: TurnEnd) -> None:
        """The episode is over."""
        if self._rules is not None and self._open is not None:
            self._close(step, ended)

    def _begin(self, view: View) -> None:
        """Choose an opponent, unless the end is near or nobody can attack."""
        if self._rules is None:
            self._start(Opponent(self._policy, view, self._rng), view.step)
            return
        self._next = view.step + _LOOK_AGAIN_STEPS
        if self._policy is None or view.steps_left < _SHORTEST_STEPS:
            return
        for shown in self._choices(self._within_turn(view, view.step), self._rules):
            opponent = Opponent(self._policy, shown, self._rng)
            if opponent.id is not None:
                self._start(opponent, view.step)
                return

    def _start(self, opponent: Opponent, step: int) -> None:
        self._opponents.append(opponent)
        self._open = _Open(opponent=opponent, first_step=step, harmless=step)

    def _choices(self, view: View, rules: TurnRules) -> Iterator[View]:
        """The view without who had a turn lately, then with all; never with who touches the AV.

        Such a one cannot come into contact with it any more.
        """
        tracks = view.history
        touching = _overlapping(
            self._av,
            tracks.ids,
            tracks.position_m[:, -1],
            tracks.heading_rad[:, -1],
            tracks.size_m[:, :2],
            tracks.z_m[:, -1],
        )
        since = view.step - _steps(rules.again_after_s)
        tired = {turn.opponent_id for turn in self._closed if turn.last_step > since}
        shown: list[int] = []
        for left_out in (touching | tired, touching):
            rows = [row for row, agent in enumerate(tracks.ids) if agent not in left_out]
            if rows != shown:
                yield replace(view, history=tracks.select(rows))
            shown = rows

    def _within_turn(self, view: View, first_step: int) -> View:
        """The view with the turn's end as that of the case."""
        if self._rules is None:
            return view
        left = first_step + _steps(self._rules.longest_s) - view.step
        return replace(view, steps_left=min(view.steps_left, left))

    def _ending(
        self, turn: _Open, rules: TurnRules, step: int, frame: Frame, size_m: Floats, *, hit: bool
    ) -> TurnEnd | None:
        """Why the opponent is spent; None while it is not."""
        if turn.opponent.id not in frame.ids:
            return "gone"
        pair = [frame.ids.index(self._av), frame.ids.index(turn.opponent.id)]
        mine, theirs = frame.position_m[pair]
        heading, size = frame.heading_rad[pair], size_m[pair]
        gap_m = float(boxes.gap(mine, heading[0], size[0], theirs, heading[1], size[1]))
        gap_m = float(distance_m(np.array(gap_m), *frame.z_m[pair]))
        turn.gap_m = 0.0 if hit else min(turn.gap_m, gap_m)
        plans_once = self._policy is not None and self._policy.period_steps is None
        reasons: dict[TurnEnd, bool] = {
            "contact": hit,
            "out_of_reach": bool(np.hypot(*(mine - theirs)) > rules.reach_m),
            "too_long": step - turn.first_step >= _steps(rules.longest_s),
            "plan_ended": plans_once and not turn.driven,
            "harmless": turn.harmless is not None
            and step - turn.harmless >= _steps(rules.harmless_s),
        }
        return next((reason for reason, holds in reasons.items() if holds), None)

    def _close(self, step: int, ended: TurnEnd) -> None:
        assert self._open is not None
        assert self._open.opponent.id is not None
        assert self._rules is not None
        self._closed.append(
            Turn(
                opponent_id=self._open.opponent.id,
                first_step=self._open.first_step,
                last_step=step,
                ended=ended,
                gap_m=self._open.gap_m,
            )
        )
        self._open = None
        self._clear = False
        self._next = step + _PAUSE_STEPS
        self._latest = step + _steps(self._rules.clear_s)


def _steps(seconds: float) -> int:
    return round(seconds / DT_S)


def _overlapping(
    agent: AgentId,
    ids: Sequence[AgentId],
    centre_m: Floats,
    heading_rad: Floats,
    size_m: Floats,
    z_m: Floats,
) -> set[AgentId]:
    """Whose boxes overlap an agent's, of N centres (N, 2), headings, sizes (N, 2) and heights."""
    me = ids.index(agent)
    hit = boxes.overlap(centre_m[me], heading_rad[me], size_m[me], centre_m, heading_rad, size_m)
    hit &= ~clear(z_m[me], z_m)
    return {ids[row] for row in np.flatnonzero(hit).tolist()} - {agent}
