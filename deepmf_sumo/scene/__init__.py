"""What flows between the rooms, and where it comes from: scenes, road, views, plans, rollouts.

Everything that crosses a border of rooms is a frozen dataclass of numpy arrays of this package.
Axis letters: A agents, T steps, H history, F future, M modes, P points, L lanes. Units are SI and
part of the field names; headings are radians counter-clockwise from +x in (-pi, pi]; a pose is the
centre of the box; arrays are read-only.

Why so: what a policy sees of an episode is a `View`, and a type without a future cannot leak one. A
reader, a predictor or a metric is tested with arrays, without SUMO and without files.

- The road is one set of lanes with pieces of centre lines (`geometry.road`), for metrics and for
  the judgement of avoidability alike. `geometry.lane_map` is the one spatial index of lanes; what
  is prepared for a road is kept while the road lives (``per_road``), and no longer.
- A light belongs to the lane that begins at it (`signals`).
- Vehicles on the road and persons on foot are road users (`road_users`). A person's id begins with
  ``person `` always, not only where a vehicle has its id: which vehicles will come is not known
  before (`agent_ids`).
- A vehicle that bends is a row of agents, its boxes, so that contacts, views, metrics and exports
  need to know nothing of trains; what counts vehicles asks `agent_ids.whole_of`.
- `readers` read recordings; `geometry` has angles, frames, boxes, polylines as pure functions.
"""

from deepmf_sumo.scene._arrays import Bools, Bytes, Floats, Ints, dtype_of, frozen
from deepmf_sumo.scene.car_following import VehicleModel
from deepmf_sumo.scene.interface import (
    AvDriver,
    Case,
    Command,
    ConversionReport,
    LanePiece,
    MadePlace,
    MadeRoadUser,
    PersonPlace,
    RecordedCase,
    SignalLink,
    SumoNet,
    Traffic,
    TrafficCase,
    View,
)
from deepmf_sumo.scene.plan import (
    Forecast,
    Futures,
    Heat,
    OpponentScores,
    Plan,
    PlanReason,
    Support,
    Turn,
    TurnRules,
    Way,
)
from deepmf_sumo.scene.rollout import (
    Attack,
    Budget,
    Contact,
    Driver,
    Event,
    MetricValue,
    Rollout,
    Trial,
)
from deepmf_sumo.scene.scene import (
    DT_S,
    FUTURE_STEPS,
    HISTORY_STEPS,
    ROLLOUT,
    SIMULATED,
    AgentId,
    AgentKind,
    Boundary,
    Lane,
    Neighbour,
    Polygon,
    Polyline,
    RoadMap,
    Scene,
    Signals,
    SignalState,
    Source,
    StopSign,
    Tracks,
)

__all__ = [
    "DT_S",
    "FUTURE_STEPS",
    "HISTORY_STEPS",
    "ROLLOUT",
    "SIMULATED",
    "AgentId",
    "AgentKind",
    "Attack",
    "AvDriver",
    "Bools",
    "Boundary",
    "Budget",
    "Bytes",
    "Case",
    "Command",
    "Contact",
    "ConversionReport",
    "Driver",
    "Event",
    "Floats",
    "Forecast",
    "Futures",
    "Heat",
    "Ints",
    "Lane",
    "LanePiece",
    "MadePlace",
    "MadeRoadUser",
    "MetricValue",
    "Neighbour",
    "OpponentScores",
    "PersonPlace",
    "Plan",
    "PlanReason",
    "Polygon",
    "Polyline",
    "RecordedCase",
    "RoadMap",
    "Rollout",
    "Scene",
    "SignalLink",
    "SignalState",
    "Signals",
    "Source",
    "StopSign",
    "SumoNet",
    "Support",
    "Tracks",
    "Traffic",
    "TrafficCase",
    "Trial",
    "Turn",
    "TurnRules",
    "VehicleModel",
    "View",
    "Way",
    "dtype_of",
    "frozen",
]
