"""One attack on a running simulation: views for the policy, the attackers' motion, its end."""

import functools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from deepmf_sumo.deepmf.networks.lanes import road_index
from deepmf_sumo.live.connection import LiveApi
from deepmf_sumo.live.observer import LiveObserver, Sighting
from deepmf_sumo.scene import (
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
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.ground import ground_of
from deepmf_sumo.scene.plan import TurnEnd
from deepmf_sumo.scene.policy import Policy
from deepmf_sumo.scene.rollout import decisive
from deepmf_sumo.sumo.network.footways import footways_of
from deepmf_sumo.sumo.network.sumo_road import road_of_net, signal_links
from deepmf_sumo.sumo.simulation.attack_schedule import AttackSchedule
from deepmf_sumo.sumo.simulation.frame import Frame, Pose, raised
from deepmf_sumo.sumo.simulation.observation import LiveSignals
from deepmf_sumo.sumo.simulation.occupancy import Occupancy
from deepmf_sumo.sumo.simulation.recorder import EpisodeRecord, Recorder
from deepmf_sumo.sumo.simulation.shown_motion import ShownMotion
from deepmf_sumo.sumo.simulation.sumo_jumps import SumoJumps
from deepmf_sumo.sumo.simulation.vehicle_control import OwnStop, SumoOwner, Takeover

_NEAR_M: Final = 150.0
"""Lights farther from the AV are not read: each costs a message."""


class LiveRoad:
    """The road and its lights.

    Args:
        api: the simulation.
        net: its network. additional: its additional files.

    Raises SimulationError if a file cannot be read.
    """

    def __init__(self, api: LiveApi, net: Path, additional: tuple[Path, ...]) -> None:
        self.net = net
        self.road: RoadMap = road_of_net(net, additional)
        road_index(self.road)  # seconds for a town: now, and not in the step of the first attack
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
"""After the longest attack: the step in which its end is observed."""
_AROUND_M: Final = 150.0
"""Around the opponent: the agents that could be in its way to a lane."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scenery:
    """What all attacks of a session share: the simulation, the AV, and the rules of an attack.

    ``pause_s``: from the end of an attack to the next.
    """

    api: LiveApi
    av_id: AgentId
    observer: LiveObserver
    surroundings: LiveRoad
    rules: TurnRules
    pause_s: float


class Engagement:
    """The AV and its attackers during one attack. Steps count from the first of the history.

    Args:
        scenery: the simulation and the rules.
        history: the last second, oldest first; the last of them is now.
        policy: drives the attackers.
        rng: for the policy.
        tired: vehicles that attack only if no other can.
        taken: vehicles that do not attack.

    Attributes:
        attackers: empty if no vehicle can attack, or the AV overlaps an agent already.

    Raises RunError if the policy chooses an opponent that is absent.
    """

    def __init__(
        self,
        scenery: Scenery,
        history: Sequence[Sighting],
        policy: Policy,
        rng: np.random.Generator,
        tired: Collection[AgentId] = (),
        taken: Collection[AgentId] = (),
    ) -> None:
        self._scenery = scenery
        observer, av = scenery.observer, scenery.av_id
        self._events: list[Event] = []
        self._ground = ground_of(scenery.surroundings.road)
        footways = functools.partial(footways_of, scenery.surroundings.net)
        self._takeover = Takeover(scenery.api, self._events, footways=footways)
        owner = SumoOwner(self._takeover, self._around)
        self._jumps = SumoJumps(scenery.api, av, self._events)
        self._own_stop = OwnStop(scenery.api, av, self._events)
        self._motion = ShownMotion(scenery.api, av, observer.bodies.ask(av).size_m[0])
        if detail := observer.bodies.stiffened():
            now = len(history) - 1
            self._events.append(Event(step=now, agent_id=av, kind="av_is_stiff", detail=detail))
        longest = round(scenery.rules.longest_s / DT_S) + _LAST_STEPS
        recorder = Recorder(len(history) + longest, observer.bodies.ask)
        self._own_stop.note(len(history) - 1)
        for sighting in history:
            self._av_pose = observer.pose(sighting, av)
            frame = self._shown(sighting)
            recorder.add(frame)

        def schedule(view: View) -> AttackSchedule:
            free = _without(view, taken)
            rested = _without(free, tired)
            if rested is not free:
                found = AttackSchedule(policy, rested, rng, scenery.rules, owner)
                if found.attackers:
                    return found
            return AttackSchedule(policy, free, rng, scenery.rules, owner)

        road = scenery.surroundings.road
        self._record = EpisodeRecord(av, road, recorder, frame, longest, self._signals, schedule)
        touching = any(event.agent_id == av for event in self._record.contact_finder.events)
        self.attackers = () if touching else self._record.schedule.attackers
        self._step = self._record.step
        self._from: Mapping[AgentId, Pose | None] = {}
        self._to: Mapping[AgentId, Pose | None] = {}
        self._seen: dict[AgentId, Occupancy] = {}
        self._lights: list[dict[str, SignalState]] = []

    @property
    def turns(self) -> tuple[Turn, ...]:
        """How the attack ended, by vehicle; empty while it goes on."""
        schedule = self._record.schedule
        return () if schedule.attackers else schedule.closed

    @property
    def leaving(self) -> bool:
        """Whether attackers of an attack that is over are on their way to where SUMO drives on."""
        return bool(self.turns and self._takeover.placed())

    def decide(self) -> None:
        """Choose the attackers' poses 0.1 s from now; the policy plans if that is due."""
        self._seen.clear()
        if not self.turns:
            self._lights.append(self._signals())
            self._record.replan()
        self._from, self._step = self._to, self._step + 1
        self._to = self._record.schedule.advance(self._step)

    def place(self, share: float) -> None:
        """Put attackers at a share of the way to their next poses; hand back those without one."""
        for agent, to in self._to.items():
            if to is None:
                self._takeover.hand_back(self._step, agent)
                continue
            start = self._from.get(agent) or self._pose(agent)
            pose = to if share > 1 - 1e-9 or start is None else _between(start, to, share)
            length_m = self._scenery.observer.bodies[agent].size_m[0]
            self._takeover.place(self._step, agent, pose, length_m)

    def settle(self) -> None:
        """Correct what SUMO assumes of the attackers, after each of its steps."""
        self._takeover.after_step()

    def look(self, sighting: Sighting) -> None:
        """Record and judge 0.1 s."""
        scenery = self._scenery
        self._av_pose = self._motion.advance(scenery.observer.pose(sighting, scenery.av_id))
        frame = self._shown(sighting)
        self._record.add(frame)
        self._own_stop.note(self._record.step)
        self._jumps.note(self._record.step, frame, self._takeover.placed())

    def stop(self, ended: TurnEnd) -> None:
        """End the attack here: the AV has gone (``av_gone``), or the session is over (``time``)."""
        self._record.schedule.finish(self._record.step, ended)

    def let_go(self) -> None:
        """Hand back to SUMO what is still driven here: the session is over."""
        for agent in self._takeover.placed():
            self._takeover.hand_back(self._step, agent)

    def forget(self) -> None:
        """SUMO has loaded another state, in which nothing is driven here."""
        self._takeover.forget()

    def rollout(self) -> Rollout:
        """What happened, with the last second before it; only after the end."""
        turn = decisive(self.turns)
        assert turn is not None
        return self._record.rollout(turn.ended, self._events, signals=self._lights)

    def _around(self, agent: AgentId) -> Occupancy:
        """The agents around a vehicle that is driven here, which may be far from the AV."""
        if agent not in self._seen:
            self._seen[agent] = self._look_around(agent)
        return self._seen[agent]

    def _look_around(self, agent: AgentId) -> Occupancy:
        observer, av = self._scenery.observer, self._scenery.av_id
        placed = self._takeover.placed()
        known = {one: (pose, Driver.POLICY) for one, pose in placed.items()}
        if observer.position(av) is not None:
            known[av] = (self._av_pose, Driver.PLANNER)
        at = observer.position(agent)
        around = Sighting({}, {}) if at is None else observer.around(at, _AROUND_M)
        frame = self._on_their_levels(observer.frame(around, known))
        return Occupancy(frame=frame, size_m=observer.bodies.sizes_m(frame.ids), av_id=av)

    def _signals(self) -> dict[str, SignalState]:
        return self._scenery.surroundings.signals((self._av_pose.x_m, self._av_pose.y_m))

    def _shown(self, sighting: Sighting) -> Frame:
        """The sighting as policies and judges see it: attackers are where they were placed."""
        scenery = self._scenery
        known = {scenery.av_id: (self._av_pose, Driver.PLANNER)}
        for agent, pose in self._takeover.placed().items():
            if self._there(agent, sighting):
                known[agent] = (pose, Driver.POLICY)
        return self._on_their_levels(scenery.observer.frame(sighting, known))

    def _on_their_levels(self, frame: Frame) -> Frame:
        """The frame with the heights of those that are placed, see `raised`."""
        placed = {
            agent: pose for agent, pose in self._takeover.placed().items() if agent in frame.ids
        }
        if not (placed and self._ground.has_levels):
            return frame
        z_m, before = dict(zip(frame.ids, frame.z_m.tolist(), strict=True)), self._record.frame
        return frame.with_poses(
            {
                agent: (raised(agent, pose, z_m[agent], before, self._ground), Driver.POLICY)
                for agent, pose in placed.items()
            }
        )

    def _there(self, agent: AgentId, sighting: Sighting) -> bool:
        """Whether SUMO has the agent; its search does not find vehicles off every lane."""
        return agent in sighting.all() or self._scenery.observer.position(agent) is not None

    def _pose(self, agent: AgentId) -> Pose | None:
        """Where SUMO has an agent now."""
        frame = self._record.frame
        if agent not in frame.ids:
            return None
        row = frame.ids.index(agent)
        x, y = frame.position_m[row]
        return Pose(
            x_m=float(x),
            y_m=float(y),
            heading_rad=float(frame.heading_rad[row]),
            speed_mps=float(np.hypot(*frame.velocity_mps[row])),
        )


def _without(view: View, agents: Collection[AgentId]) -> View:
    """The view as if these were not there; the same one where none of them is."""
    kept = [row for row, agent in enumerate(view.history.ids) if agent not in agents]
    if len(kept) == view.history.agents:
        return view
    return replace(view, history=view.history.select(kept))


def _between(start: Pose, end: Pose, share: float) -> Pose:
    """A pose between two, for simulations with steps below 0.1 s."""
    turn = float(frames.difference(end.heading_rad, start.heading_rad))
    return Pose(
        x_m=start.x_m + share * (end.x_m - start.x_m),
        y_m=start.y_m + share * (end.y_m - start.y_m),
        heading_rad=float(frames.wrap(start.heading_rad + share * turn)),
        speed_mps=start.speed_mps + share * (end.speed_mps - start.speed_mps),
        course_rad=end.course_rad,
    )
