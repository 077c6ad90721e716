"""What is simulated, what a planner or a policy sees of it, and what a planner commands."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from deepmf_sumo.scene._arrays import Floats, Frozen
from deepmf_sumo.scene.plan import TurnRules
from deepmf_sumo.scene.road_users import RoadUserClass
from deepmf_sumo.scene.scene import AgentId, RoadMap, Scene, SignalState, Tracks


@dataclass(frozen=True, slots=True, kw_only=True)
class LanePiece:
    """Part of a scene's lane in SUMO: the SUMO lane, and its start on the scene's lane."""

    sumo_lane: str
    start_m: float
    length_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalLink:
    """A link of a SUMO traffic light."""

    light: str
    index: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ConversionReport:
    """Losses and errors of a conversion.

    Attributes:
        lanes, connections: numbers in the scene.
        lost_lanes, lost_connections: those missing in the net, with the reason.
        error_mean_m, error_p99_m, error_max_m: distances between the lanes of the scene and of
            SUMO, in both directions.
        seconds: wall time; 0 if the net was read from files.
        bridged_connections: connections of lanes that do not touch, which got an edge of their
            own, with the distance.
        lost_signals: lanes whose signal controls no link, with the reason.
    """

    lanes: int
    connections: int
    lost_lanes: tuple[tuple[str, str], ...] = ()
    lost_connections: tuple[tuple[str, str, str], ...] = ()
    error_mean_m: float = 0.0
    error_p99_m: float = 0.0
    error_max_m: float = 0.0
    seconds: float = 0.0
    bridged_connections: tuple[tuple[str, str, str], ...] = ()
    lost_signals: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class SumoNet:
    """A SUMO network and its mapping to the scene.

    Attributes:
        file: the .net.xml.
        additional: polygons to draw (crosswalks), or None.
        pieces: scene lane id -> its pieces in driving order.
        lane_of: SUMO lane id -> scene lane ids on it, in driving order (extensions map to none).
        signals: scene lane id -> links with its signal.
        ghost_edge: isolated SUMO edge along the AV's recorded path, if that path leaves the lanes;
            else None.
    """

    file: Path
    additional: Path | None = None
    pieces: dict[str, tuple[LanePiece, ...]] = field(default_factory=dict)
    lane_of: dict[str, tuple[str, ...]] = field(default_factory=dict)
    signals: dict[str, tuple[SignalLink, ...]] = field(default_factory=dict)
    report: ConversionReport | None = None
    ghost_edge: str | None = None


PersonPlace = Literal["kerb", "crossing", "stop", "behind_vehicle", "queue", "cyclist"]
MadePlace = Literal[PersonPlace, "given"]
"""Where a made road user is: beside the road; at a pedestrian crossing or a stop line; at a bus
stop; behind a vehicle that stands; beside the gap between two vehicles of a queue; riding beside
the lane; where a spec puts it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MadeRoadUser(Frozen):
    """A person or cyclist who is not in the demand: somebody put it where people could be.

    Without an attack it stands, or goes along its way and stops at the end of it.

    Attributes:
        id: its SUMO id and agent id.
        road_user: its class, which gives its size and the limits of its motion.
        position_m: (2,) centre of its box at the case's start, on its way.
        z_m: height of the ground there.
        heading_rad: at the start.
        speed_mps: along its way, until it brakes for the end of it; 0: it stands.
        place: where it is, in a word.
        way_m: (P, 2) line along which it moves, through ``position_m``, begun at least
            ``-since_s`` before it; None where it stands.
        since_s: from when on it is there, in s after the start.
    """

    id: AgentId
    road_user: RoadUserClass
    position_m: Floats
    heading_rad: float
    speed_mps: float = 0.0
    place: MadePlace = "given"
    way_m: Floats | None = None
    z_m: float = 0.0
    since_s: float = -1.0


Traffic = Literal["log", "sumo"]
AvDriver = Literal["planner", "human"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Situation:
    """One situation to attack.

    Attributes:
        name: stable and unique in a batch: the run id.
        road: the map in views: the recording's, or the SUMO network's.
        av_id: track id, or SUMO vehicle id.
        duration_steps: steps after the current one.
        partner_id: the labelled opponent, if the recording names one (``opponent: labelled``).
        av_driver: ``human`` if the AV replays a recorded human driver.
        turns: opponents attack in sequence until the duration is over; None: one attacks, and its
            contact with the AV ends the episode.
        only: road users beside the AV; None: all. Others are not there from the start on, nor in
            the history.
        unattacked: (A, T) the same episode without attack, at the steps of its rollouts, where SUMO
            drives the traffic; None before it is simulated, and where it cannot be. What a vehicle
            would have done says `avoidability.counterfactual`, not this alone.
        made: people who were put there, see `MadeRoadUser`; the same in every episode of the case.
        in_sight: whether the planner's views lack road users whom the AV cannot see past vehicles
            and buildings (`geometry.sight`); policies see all.
    """

    name: str
    road: RoadMap
    av_id: AgentId
    duration_steps: int
    seed: int
    partner_id: AgentId | None = None
    av_driver: AvDriver = "planner"
    turns: TurnRules | None = None
    only: tuple[AgentId, ...] | None = None
    unattacked: Tracks | None = None
    made: tuple[MadeRoadUser, ...] = ()
    in_sight: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedCase(_Situation):
    """A situation of a recorded scene.

    Attributes:
        traffic: what drives the other agents: the log, or SUMO from now on.
        scene: the recording, without the agents that ``only`` leaves out. net: the SUMO network
            made of its road.
    """

    traffic: Traffic
    scene: Scene
    net: SumoNet


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrafficCase(_Situation):
    """A situation in the traffic of a SUMO configuration, which SUMO runs up to ``start_s``.

    Attributes:
        net_file: the network that the configuration names.
        sumo_options: beside the configuration, as on SUMO's command line.
        own_people: whether pedestrians and cyclists of the demand are there; if not, the made ones
            are the only people.
    """

    config: Path
    start_s: float
    net_file: Path
    sumo_options: tuple[str, ...] = ()
    own_people: bool = True


Case = RecordedCase | TrafficCase


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View(Frozen):
    """The world at one step: the present and the last second, never the future.

    Attributes:
        step: index on the scene's time axis; the last row of ``history`` is this step.
        history: (A, H) tracks with H = 11, as simulated; only agents that are valid at the
            current step.
        signals: lane id -> current state.
        steps_left: steps until the case ends.
        av_path_m: (P, 2) centre line ahead of the AV, for planners only: policies get None.
        av_recorded_steps: number of the last 10 steps in which the AV moved as recorded: a planner
            that has just taken over continues differently from its history.
    """

    step: int
    dt_s: float
    av_id: AgentId
    history: Tracks
    road: RoadMap
    signals: dict[str, SignalState]
    steps_left: int
    av_path_m: Floats | None = None
    av_recorded_steps: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """One step of the AV.

    Attributes:
        kind: ``pose`` places the AV; ``sumo`` lets SUMO's own model drive; ``leader`` asks SUMO's
            model for the speed behind the given leader and drives at it; ``speed`` drives along the
            route at ``speed_mps``.
        x_m, y_m, heading_rad, speed_mps: the pose after the step (``pose``); of ``speed`` only the
            last.
        gap_m: bumper to leader, metres (``leader``).
        leader_mps: the leader's speed along the AV's path, signed (``leader``).
        leader_id: the vehicle that the planner reacts to, if it knows; only recorded.
    """

    kind: Literal["pose", "sumo", "leader", "speed"]
    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0
    speed_mps: float = 0.0
    gap_m: float = 0.0
    leader_mps: float = 0.0
    leader_id: AgentId | None = None
