"""Control of persons in SUMO's traffic: placing them at poses, and letting SUMO walk them on.

How SUMO 1.28 treats a person that a client moves (`studies/notebook/moved-people.md`):

- It belongs to one lane, and cars of that lane see it; those of all lanes see who is on a crossing.
  With keepRoute 2 it belongs to the nearest lane for pedestrians, whatever it stands on, and cars
  drive through it on theirs. With keepRoute 6 it belongs to some lane that is near; so SUMO is told
  which one (`Footways.lane_at`).
- Put onto a walking area off its way it crashes SUMO. There it belongs to no lane.
- It changes the way of who is moved, and ends where that becomes none. So the way is a single edge
  where people may not walk, and a new one begins where it is before SUMO walks it on.
- SUMO walks on from a footway smoothly. From a walking area it may jump by metres, from a lane for
  cars it walks on along that lane. So it is handed back on footways alone.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from deepmf_sumo.scene import AgentId, Floats, agent_ids
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.road_users import ROAD_USERS
from deepmf_sumo.sumo.network.footways import Footways
from deepmf_sumo.sumo.network.sumo_net import edge_of
from deepmf_sumo.sumo.simulation.frame import Pose
from deepmf_sumo.sumo.simulation.on_foot import Walk
from deepmf_sumo.sumo.simulation.road_users import on_foot
from deepmf_sumo.sumo.simulation.sumo_api import MATCH_M, SumoApi

SEEN_ON_ANY_LANE: Final = 4
"""Added to keepRoute: SUMO takes it on lanes that its class may not use, too."""
_EXACT: Final = 2
_MATCH_NOTHING_M: Final = -1.0
_SNAP_M: Final = 100.0
_REACH_M: Final = 30.0
"""A footway farther away is not looked for."""
_WAITS, _WALKS = 1, 2  # SUMO's types of stages
_STAGES: Final = {
    0: "waits for its departure",
    3: "waits for a vehicle to ride in",
    4: "is on its way to a stop",
}
_MODEL: Final = "striping"


@dataclass(slots=True, kw_only=True)
class _Person:
    """A person that is placed. ``edges``: its way, to ``to_m`` on the last, or a stop there."""

    length_m: float
    pose: Pose
    edges: tuple[str, ...]
    to_m: float
    to_stop: str


class PersonControl:
    """The persons that a policy moves in SUMO.

    Args:
        api: a running SUMO.
        footways: of its network; asked for when the first person is moved.
        note: called with agent, kind and detail of what qualifies the result.
    """

    def __init__(
        self,
        api: SumoApi,
        footways: Callable[[], Footways],
        note: Callable[[AgentId, str, str], None],
    ) -> None:
        self._api, self._footways_of, self._note = api, footways, note
        self._persons: dict[AgentId, _Person] = {}
        self._refused: set[AgentId] = set()
        self._fresh: dict[AgentId, Pose] = {}
        self._released: dict[AgentId, Pose] = {}

    @property
    def _footways(self) -> Footways:
        return self._footways_of()

    def refusal(self, agent: AgentId) -> str:
        """Why SUMO lets nobody move a person that is there; empty if it does."""
        model = str(self._api.simulation.getOption("pedestrian.model"))
        if model != _MODEL:
            return (
                f"SUMO walks its persons by the model {model}, which ignores where a client puts "
                f"them; run it with --pedestrian.model {_MODEL}"
            )
        stage = self._api.person.getStage(_name(agent))
        if int(stage.type) not in {_WAITS, _WALKS}:
            does = _STAGES.get(int(stage.type), "does not walk")
            return f"{agent} {does}; SUMO lets clients move walkers alone"
        if stop := self._comes_into(stage):
            return (
                f"{agent} walks to an access of the stop '{stop}', into which SUMO sends it where"
                " its way changes"
            )
        return ""

    def _comes_into(self, stage: Any) -> str:
        """The stop at whose ``<access>``, on another edge, a walk ends; empty if at none.

        A way that ends there sooner, or becomes another one, ends as if the person had come there:
        then it is in the stop, where no client moves it, and for which SUMO 1.28 crashes if that
        stage is taken away.
        """
        stop, edges = str(stage.destStop), stage.edges
        if not stop or not edges:
            return ""
        try:
            lane = str(self._api.busstop.getLaneID(stop))
        except self._api.TraCIException:  # one of another kind, which has no accesses
            return ""
        return stop if edge_of(lane) != edges[-1] else ""

    def present(self, agent: AgentId) -> bool:
        """Whether a person is on foot in the simulation."""
        person, name = self._api.person, _name(agent)
        return name in person.getIDList() and on_foot(person.getVehicle(name))

    def placed(self) -> dict[AgentId, Pose]:
        """Where those that are moved were put in the last step, also to be walked on from there."""
        return self._released | {agent: one.pose for agent, one in self._persons.items()}

    def place(self, agent: AgentId, pose: Pose, length_m: float) -> None:
        """Put a person that is present exactly at the pose at the end of the coming step."""
        if agent not in self._persons:
            if refusal := self.refusal(agent):
                if agent not in self._refused:
                    self._refused.add(agent)
                    self._note(agent, "not_taken", refusal)
                return
            self._persons[agent] = self._taken(agent, pose, length_m)
        self._persons[agent].pose = pose
        self._put(agent, pose, length_m)

    def _put(
        self, agent: AgentId, pose: Pose, length_m: float, facing_deg: float | None = None
    ) -> None:
        front, angle = frames.to_sumo((pose.x_m, pose.y_m), pose.heading_rad, length_m)
        lane = self._footways.lane_at(front, self._height_m(agent))
        if self._footways.closed(lane) and len(self._api.person.getEdges(_name(agent))) > 1:
            self._hold(_name(agent), self._persons[agent].edges[0])
        x, y = float(front[0]), float(front[1])
        keep, match_m = _EXACT + SEEN_ON_ANY_LANE, MATCH_M if lane else _MATCH_NOTHING_M
        facing = float(angle) if facing_deg is None else facing_deg
        self._api.person.moveToXY(_name(agent), lane, x, y, facing, keep, match_m)

    def _taken(self, agent: AgentId, pose: Pose, length_m: float) -> _Person:
        person, name = self._api.person, _name(agent)
        stage = person.getStage(name)
        edges = tuple(stage.edges) or (str(person.getRoadID(name)),)
        if int(stage.type) == _WAITS:
            self._note(agent, "waiting_ended", "it does not wait on, and returns to where it was")
            self._hold(name, edges[0])
        return _Person(
            length_m=length_m,
            pose=pose,
            edges=edges,
            to_m=float(stage.arrivalPos),
            to_stop=str(stage.destStop),
        )

    def _hold(self, name: str, home: str) -> None:
        """Let a person's way be a single edge, on which people may walk.

        SUMO replaces an edge of the way by the one onto which it moves the person. In a longer way
        that may be the next edge, and SUMO ends where people may not walk on that.
        """
        for stay in self._api.simulation.findIntermodalRoute(home, home)[:1]:
            self._replace_walk(name, stay, home, 0.0)

    def after_step(self) -> None:
        """Forget those that have gone, and those that SUMO has walked on."""
        self._released, self._fresh = self._fresh, {}
        for agent in [one for one in self._persons if not self.present(one)]:
            del self._persons[agent]

    def forget(self) -> None:
        """SUMO has loaded another state, in which it walks all persons."""
        self._persons.clear()

    def drivable(self, agent: AgentId) -> bool:
        """Whether SUMO walks a person on from its pose without a jump: it is on a footway."""
        one = self._persons.get(agent)
        if one is None or not self.present(agent):
            return True  # it is SUMO's already, or gone
        front, _ = frames.to_sumo((one.pose.x_m, one.pose.y_m), one.pose.heading_rad, one.length_m)
        footway = self._footways.walked(front, self._height_m(agent))
        return bool(footway) and footway == str(self._api.person.getLaneID(_name(agent)))

    def walk(self, agent: AgentId, pose: Pose) -> Walk:
        """The way of a person to the nearest footway; it stops where none is near."""
        limits = ROAD_USERS["pedestrian"].motion.planned
        z_m = self._height_m(agent) if self.present(agent) else pose.z_m
        found = self._footways.nearest(_at(pose), _REACH_M, z_m)
        return Walk(pose, limits, None if found is None else found.point_m)

    def _height_m(self, agent: AgentId) -> float:
        """Of the ground under a person, as SUMO has it: poses of plans have none."""
        return float(self._api.person.getPosition3D(_name(agent))[2])

    def hand_back(self, agent: AgentId, *, leaves: bool) -> None:
        """Let SUMO walk a person from the coming step on, see `Takeover.hand_back`."""
        drivable = self.drivable(agent)
        one = self._persons.pop(agent, None)
        if one is None or not self.present(agent):
            return
        if not drivable:
            self._strand(agent, one, leaves=leaves)
            return
        person, name = self._api.person, _name(agent)
        edge = edge_of(str(person.getLaneID(name)))
        detail = self._new_way(agent, one, edge, float(person.getLanePosition(name)))
        self._let_go(agent, one, self._onward(one.pose))
        self._note(agent, "handed_back", detail)

    def _strand(self, agent: AgentId, one: _Person, *, leaves: bool) -> None:
        """What becomes of a person on no footway, where SUMO would let it stand for ever."""
        if leaves:
            self._api.person.remove(_name(agent))
            self._note(agent, "removed", "it stands where SUMO walks no person")
            return
        found = self._footways.nearest(_at(one.pose), _SNAP_M, self._height_m(agent))
        if found is None:
            self._note(agent, "stranded", "no footway is near: SUMO lets it stand where it is")
            return
        detail = self._new_way(agent, one, found.edge, found.along_m)
        x, y = found.point_m.tolist()
        self._let_go(agent, one, replace(one.pose, x_m=x, y_m=y))
        self._note(agent, "handed_back", f"put on the nearest footway; {detail}")

    def _let_go(self, agent: AgentId, one: _Person, pose: Pose) -> None:
        """Put a person at a pose for the last time.

        It faces where its new walk leads: in a walk of one edge SUMO takes a person who faces back
        for one that walks back, and has arrived.
        """
        self._fresh[agent] = pose
        self._put(agent, pose, one.length_m, float(self._api.person.getAngle(_name(agent))))

    def _new_way(self, agent: AgentId, one: _Person, edge: str, along_m: float) -> str:
        """Let a person walk from a place on an edge: on along its way, or by another one.

        Without one it walks to the end of its edge. Returns what to say of it.
        """
        route, to = self._api.simulation.findIntermodalRoute, one.edges[-1]
        found = route(edge, to, departPos=along_m, arrivalPos=one.to_m, destStop=one.to_stop)
        detail = "SUMO walks it on by another way"
        if not found:
            self._note(agent, "route_lost", f"no way on foot to its destination {to}")
            found = route(edge, edge, departPos=along_m)
        elif edge in one.edges:
            found[0].edges = list(one.edges[one.edges.index(edge) :])
            detail = "SUMO walks it on"
        way = list(found[0].edges)
        if len(way) > 1:
            # SUMO chooses the direction where a walk begins, and begins one on the edge of the
            # walk before where that was: so there is one on another edge between the two
            self._hold(_name(agent), way[1])
            along_m = self._footways.end_ahead_m(way[0], way[1])
        self._replace_walk(_name(agent), found[0], edge, along_m)
        return detail

    def _replace_walk(self, name: str, walk: Any, edge: str, along_m: float) -> None:
        """Let a person walk from a place on an edge instead of the walk under way.

        SUMO begins a new stage where the last one of all ends, and chooses the direction of the
        walk for that place: so there is another last one meanwhile.
        """
        person = self._api.person
        last = int(person.getRemainingStages(name))
        person.appendWalkingStage(name, [edge], along_m)
        person.replaceStage(name, 0, walk)
        person.removeStage(name, last)

    def _onward(self, pose: Pose) -> Pose:
        """One step farther, so that it does not stop where SUMO takes it."""
        course = pose.heading_rad if pose.course_rad is None else pose.course_rad
        far_m = pose.speed_mps * float(self._api.simulation.getDeltaT())
        x, y = _at(pose) + far_m * frames.unit(np.array(course))
        return replace(pose, x_m=float(x), y_m=float(y))


def _name(agent: AgentId) -> str:
    name = agent_ids.person_of(agent)
    assert name is not None
    return name


def _at(pose: Pose) -> Floats:
    return np.array([pose.x_m, pose.y_m])
