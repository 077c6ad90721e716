"""One attack on a running simulation: views for the policy, the opponent's motion, its end."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import (
    DT_S,
    AgentId,
    Driver,
    Event,
    RoadMap,
    Rollout,
    SignalState,
    Turn,
    TurnRules,
    View,
)
from deepmf_sumo.geometry import frames
from deepmf_sumo.live.connection import LiveApi
from deepmf_sumo.live.observer import Observer, Sighting
from deepmf_sumo.network.sumo_road import road_of_net, signal_links
from deepmf_sumo.policies.base import Policy
from deepmf_sumo.simulation.attack_schedule import Turns
from deepmf_sumo.simulation.av import ShownMotion
from deepmf_sumo.simulation.contacts import Judge
from deepmf_sumo.simulation.frame import Frame, Pose
from deepmf_sumo.simulation.observation import LiveSignals
from deepmf_sumo.simulation.recorder import Recorder
from deepmf_sumo.simulation.vehicle_control import Crowd, Places, Takeover

_NEAR_M: Final = 150.0
"""Lights farther from the AV are not asked for: each costs a message."""


class Surroundings:
    """Map, free places and lights.

    Args:
        api: the simulation.
        net: its network. additional: its additional files.

    Raises SimulationError where a file cannot be read.
    """

    def __init__(self, api: LiveApi, net: Path, additional: tuple[Path, ...]) -> None:
        self.net = net
        self.road: RoadMap = road_of_net(net, additional)
        self.places = Places(api, self.road)
        self._api = api
        links = signal_links(net)
        self._links = {lane: row for lane, row in links.items() if lane in self.road.lanes}
        stops = [self.road.lanes[lane].centre_m[0] for lane in self._links]
        self._stop_m = np.array(stops).reshape(-1, 2)

    def signals(self, at_m: tuple[float, float]) -> dict[str, SignalState]:
        """States of the lights around a point, by lane id."""
        near = np.hypot(*(self._stop_m - at_m).T) < _NEAR_M
        links = {
            lane: row for (lane, row), close in zip(self._links.items(), near, strict=True) if close
        }
        return LiveSignals(self._api, links).states()


_LAST_STEPS: Final = 2
"""Beyond the longest attack: the step in which its end is seen."""
_CROWD_M: Final = 150.0
"""Around the opponent: whoever could be in the way of it where it is put, 50 m off at most."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scenery:
    """What all attacks of a session share."""

    api: LiveApi
    av_id: AgentId
    observer: Observer
    surroundings: Surroundings
    rules: TurnRules


class Engagement:
    """The AV, its opponent, and what becomes of them. Steps count from the first of the history.

    Args:
        scenery: the simulation and the rules.
        history: the last second, oldest first; the last of them is now.
        policy: drives the opponent.
        rng: for the policy.
        tired: who attacks only if nobody else can.

    Raises RunError where the policy wants an opponent that is not there.
    """

    def __init__(
        self,
        scenery: Scenery,
        history: Sequence[Sighting],
        policy: Policy,
        rng: np.random.Generator,
        tired: Collection[AgentId] = (),
    ) -> None:
        self.events: list[Event] = []
        self._scenery = scenery
        observer, av = scenery.observer, scenery.av_id
        self._takeover = Takeover(
            scenery.api, self.events, scenery.surroundings.places, may_remove=False
        )
        self._av_pose = observer.pose(history[0], av)
        self._motion = ShownMotion(scenery.api, av, observer.body(av).size_m[0])
        longest = round(scenery.rules.longest_s / DT_S) + _LAST_STEPS
        self._steps = len(history) + longest
        self._recorder = Recorder(self._steps, observer.body)
        for sighting in history:
            self._av_pose = observer.pose(sighting, av)
            frame = self._shown(sighting)
            self._recorder.add(frame)
        self._now = self._recorder.step
        self._turns = self._chosen(policy, rng, tired)
        self._judge = Judge(av, self._turns.attacker)
        self._judge.look(self._now, frame, observer.sizes_m(frame.ids))
        self._frame = frame
        touching = any(event.agent_id == av for event in self._judge.events)
        self.opponent_id = None if touching else self._turns.attacker
        """Who attacks; None where nobody can, or the AV touches somebody already."""
        self._from: Pose | None = None
        self._to: Pose | None = None

    @property
    def turn(self) -> Turn | None:
        """How it ended; None while it goes on."""
        return self._turns.closed[0] if self._turns.closed else None

    def decide(self) -> None:
        """Say where the opponent shall be 0.1 s from now; the policy plans if it is time to."""
        step = self._recorder.step
        if self._turns.due(step):
            self._turns.replan(self._view())
        self._from = self._to or self._opponent_pose()
        self._to = self._turns.pose(step + 1)

    def place(self, share: float) -> None:
        """Put the opponent at a share of the way to where it shall be; without a plan let it go."""
        opponent, step = self._turns.attacker, self._recorder.step
        if opponent is None:
            return
        if self._to is None or self._from is None:
            self._let_go(opponent)
            return
        pose = self._to if share > 1 - 1e-9 else _between(self._from, self._to, share)
        length_m = self._scenery.observer.body(opponent).size_m[0]
        self._takeover.place(step + 1, opponent, pose, length_m)

    def settle(self) -> None:
        """What SUMO has to be told after each of its steps."""
        self._takeover.after_step(self._recorder.step + 1)

    def look(self, sighting: Sighting) -> None:
        """See what has become of 0.1 s; where that was the end, the opponent is handed back."""
        scenery = self._scenery
        self._av_pose = self._motion.advance(scenery.observer.pose(sighting, scenery.av_id))
        frame = self._frame = self._shown(sighting)
        self._recorder.add(frame)
        size_m = scenery.observer.sizes_m(frame.ids)
        step, opponent = self._recorder.step, self._turns.attacker
        self._judge.look(step, frame, size_m)
        self._turns.after_step(step, frame, size_m, hit=self._judge.hit(step))
        if self.turn is not None:
            self._let_go(opponent)

    def stop(self, *, av_gone: bool) -> None:
        """End it here: the AV has gone, or the session is over."""
        opponent = self._turns.attacker
        self._turns.finish(self._recorder.step, "av_gone" if av_gone else "time")
        self._let_go(opponent)

    def rollout(self) -> Rollout:
        """What happened, the last second before it included."""
        tracks, driver = self._recorder.tracks()
        turn = self.turn
        assert turn is not None
        events = [*self._turns.events, *self.events, *self._judge.events]
        return Rollout(
            tracks=tracks,
            driver=driver,
            now=self._now,
            dt_s=DT_S,
            av_id=self._scenery.av_id,
            opponent_id=turn.opponent_id,
            contacts=tuple(self._judge.contacts),
            events=tuple(sorted(events, key=lambda event: event.step)),
            plans=tuple(self._turns.plans),
            ended=turn.ended,
            turns=(turn,),
        )

    def _chosen(
        self, policy: Policy, rng: np.random.Generator, tired: Collection[AgentId]
    ) -> Turns:
        """The opponent, somebody who is not tired if there is one that the policy takes."""
        view, rules = self._view(), self._scenery.rules
        rested = [row for row, agent in enumerate(view.history.ids) if agent not in tired]
        if len(rested) < view.history.agents:
            turns = Turns(policy, replace(view, history=view.history.select(rested)), rng, rules)
            if turns.attacker is not None:
                return turns
        return Turns(policy, view, rng, rules)

    def _let_go(self, opponent: AgentId | None) -> None:
        if opponent is not None and self._takeover.placed() is not None:
            self._takeover.hand_back(self._recorder.step, opponent, self._crowd(opponent))

    def _crowd(self, opponent: AgentId) -> Crowd | None:
        """Who is around the opponent, which may be far from the AV by now; None where it is not."""
        observer, placed = self._scenery.observer, self._takeover.placed()
        at = observer.position(opponent)
        if at is None or placed is None:
            return None
        known = {opponent: (placed[1], Driver.POLICY)}
        av = self._scenery.av_id
        if observer.position(av) is not None:
            known[av] = (self._av_pose, Driver.PLANNER)
        frame = observer.frame(observer.around(at, _CROWD_M), known)
        return Crowd(frame=frame, size_m=observer.sizes_m(frame.ids), av_id=av)

    def _view(self) -> View:
        recorder, scenery = self._recorder, self._scenery
        signals = scenery.surroundings.signals((self._av_pose.x_m, self._av_pose.y_m))
        left = self._steps - 1 - recorder.step
        return recorder.view(scenery.av_id, scenery.surroundings.road, signals, left)

    def _shown(self, sighting: Sighting) -> Frame:
        """The sighting as policies and judges see it: the opponent is where it was put."""
        scenery = self._scenery
        known = {scenery.av_id: (self._av_pose, Driver.PLANNER)}
        placed = self._takeover.placed()
        if placed is not None and self._there(placed[0], sighting):
            known[placed[0]] = (placed[1], Driver.POLICY)
        return scenery.observer.frame(sighting, known)

    def _there(self, agent: AgentId, sighting: Sighting) -> bool:
        """Whether SUMO has it; its search does not find who is off every lane."""
        return agent in sighting.vehicles or self._scenery.observer.position(agent) is not None

    def _opponent_pose(self) -> Pose | None:
        """Where SUMO has the opponent now."""
        opponent = self._turns.attacker
        if opponent is None or opponent not in self._frame.ids:
            return None
        row = self._frame.ids.index(opponent)
        x, y = self._frame.position_m[row]
        return Pose(
            x_m=float(x),
            y_m=float(y),
            heading_rad=float(self._frame.heading_rad[row]),
            speed_mps=float(np.hypot(*self._frame.velocity_mps[row])),
        )


def _between(start: Pose, end: Pose, share: float) -> Pose:
    """A pose on the way, for simulations with shorter steps than ours."""
    turn = float(frames.difference(end.heading_rad, start.heading_rad))
    return Pose(
        x_m=start.x_m + share * (end.x_m - start.x_m),
        y_m=start.y_m + share * (end.y_m - start.y_m),
        heading_rad=float(frames.wrap(start.heading_rad + share * turn)),
        speed_mps=start.speed_mps + share * (end.speed_mps - start.speed_mps),
        course_rad=end.course_rad,
    )
