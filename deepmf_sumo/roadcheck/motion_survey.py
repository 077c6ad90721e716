"""How all road users of a SUMO configuration move at each step, without attacks."""

from array import array
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.judge.metrics.traffic_conflicts import RoadUserMotions
from deepmf_sumo.scene import DT_S, AgentId, agent_ids
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.slow import STANDING_MPS
from deepmf_sumo.sumo.network.sumo_net import edge_of
from deepmf_sumo.sumo.simulation.long_vehicles import State
from deepmf_sumo.sumo.simulation.road_users import TrafficReader
from deepmf_sumo.sumo.simulation.sumo_api import SumoApi
from deepmf_sumo.sumo.simulation.sumo_config import Traffic, begun, read_configuration

MOST_VEHICLE_STEPS: Final = 10_000_000
"""A minute or two of SUMO, and 0.7 GB; a count, so that every machine ends at the same time."""
_PARKED: Final = 2
"""Bit of SUMO's stop states."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Survey:
    """What to survey.

    Attributes:
        sumo_options: beside the configuration, as on SUMO's command line.
        from_s: up to then SUMO drives unseen; None: from its begin on.
        until_s: end of the survey, at most that of the configuration; None: that end, or the time
            at which `MOST_VEHICLE_STEPS` are reached.
    """

    config: Path
    sumo_options: tuple[str, ...] = ()
    seed: int
    from_s: float | None = None
    until_s: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Surveyed:
    """All road users at steps of 0.1 s; step 0 is at ``begin_s``.

    Parked vehicles, persons in vehicles, and vehicles that SUMO is moving elsewhere (teleports)
    are not on the road and so not in it.

    Attributes:
        until_s: time of the last step. complete: the configuration ends there, or all have left.
        names, types: of the V road users; persons have their own types. A vehicle that bends is
            several, one after the other.
        lanes: names of the L lanes. warnings: SUMO's, see `sumo_words`.
    """

    begin_s: float
    until_s: float
    complete: bool
    names: tuple[str, ...]
    types: tuple[str, ...]
    lanes: tuple[str, ...]
    motions: RoadUserMotions
    warnings: tuple[str, ...] = ()


def survey(wanted: Survey) -> Surveyed:
    """Run the configuration once.

    Raises SimulationError, with SUMO's own message, if it cannot be run, or no vehicle drove.
    """
    configuration = read_configuration(wanted.config, wanted.sumo_options)
    ends = [one for one in (configuration.end_s, wanted.until_s) if one is not None]
    until = min(ends, default=np.inf)
    warned: list[str] = []
    with begun(Traffic(configuration=configuration, seed=wanted.seed), warned=warned) as api:
        if wanted.from_s is not None and wanted.from_s > api.simulation.getTime() + DT_S / 2:
            api.simulationStep(wanted.from_s)
        notes = _Sighted(api)
        begin = now = float(api.simulation.getTime())
        complete, step = False, 0
        while now + DT_S <= until + DT_S / 2 and not complete:
            notes.look(step)
            if wanted.until_s is None and len(notes.rows) > 3 * MOST_VEHICLE_STEPS:
                break
            api.simulationStep()
            step, now = step + 1, float(api.simulation.getTime())
            complete = api.simulation.getMinExpectedNumber() == 0
        notes.look(step)
        ends_s = np.inf if configuration.end_s is None else configuration.end_s
        complete = complete or now + DT_S > ends_s
    if not notes.rows:
        raise SimulationError(
            f"no vehicle drove in '{wanted.config}' from {begin:.12g} to {now:.12g} s, so there are"
            " no conflicts to look for; choose other times, or give it traffic."
        )
    return replace(notes.surveyed(begin, now, complete=complete), warnings=tuple(warned))


@dataclass
class _Sighted:
    """Columns that grow; constants are asked for once."""

    api: SumoApi
    bodies: dict[AgentId, int] = field(default_factory=dict)
    types: list[str] = field(default_factory=list)
    lanes: dict[str, int] = field(default_factory=dict)
    numbers: "array[float]" = field(default_factory=lambda: array("d"))
    rows: "array[int]" = field(default_factory=lambda: array("q"))
    reader: TrafficReader = field(init=False)

    def __post_init__(self) -> None:
        self.reader = TrafficReader(self.api)

    def look(self, step: int) -> None:
        """Note all that are on the road."""
        seen: list[tuple[int, int, State]] = []
        for agent, state in self.reader.states().items():
            lane = self._lane(agent, state[3])
            if lane:
                number = self.lanes.setdefault(lane, len(self.lanes))
                seen.append((self._body(agent), number, state))
        for body, number, state in sorted(seen):
            self.rows.extend((step, body, number))
            self.numbers.extend(state)

    def _lane(self, agent: AgentId, speed_mps: float) -> str:
        """Empty for those beside the road: parked, or in a teleport."""
        person, vehicle = agent_ids.person_of(agent), self.api.vehicle
        if person is not None:
            return str(self.api.person.getLaneID(person))
        whole = agent_ids.whole_of(agent)
        if speed_mps < STANDING_MPS and vehicle.getStopState(whole) & _PARKED:
            return ""
        lane = str(vehicle.getLaneID(whole))
        return lane and self.reader.bodies.long.lane.get(agent, lane)

    def _body(self, agent: AgentId) -> int:
        if agent not in self.bodies:
            person = agent_ids.person_of(agent)
            domain = self.api.vehicle if person is None else self.api.person
            self.bodies[agent] = len(self.types)
            kind = domain.getTypeID(agent_ids.whole_of(agent) if person is None else person)
            self.types.append(str(kind).partition("@")[0])
        return self.bodies[agent]

    def surveyed(self, begin: float, until: float, *, complete: bool) -> Surveyed:
        names = tuple(self.bodies)
        rows = np.array(self.rows).reshape(-1, 3)
        numbers = np.array(self.numbers).reshape(-1, 5)
        size_m = self.reader.bodies.sizes_m(names)
        centre, heading = frames.from_sumo(numbers[:, :2], numbers[:, 2], size_m[rows[:, 1], 0])
        edges: dict[str, int] = {}
        return Surveyed(
            begin_s=begin,
            until_s=until,
            complete=complete,
            names=names,
            types=tuple(self.types),
            lanes=tuple(self.lanes),
            motions=RoadUserMotions(
                dt_s=DT_S,
                size_m=size_m,
                step=rows[:, 0],
                body=rows[:, 1],
                position_m=centre,
                heading_rad=heading,
                speed_mps=numbers[:, 3],
                z_m=numbers[:, 4],
                lane=rows[:, 2],
                edge_of_lane=np.array(
                    [edges.setdefault(edge_of(lane), len(edges)) for lane in self.lanes]
                ),
                parts=np.array([self.bodies[agent_ids.whole_of(one)] for one in names], int),
                on_foot=np.array([agent_ids.person_of(one) is not None for one in names], bool),
            ),
        )
