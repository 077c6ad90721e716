"""What flows between the stages: frozen dataclasses of numpy arrays.

Axis letters: A agents, T steps, H history, F future, M modes, P points, L lanes.
Units are SI and stand in the field names; headings are radians counter-clockwise from +x in
(-pi, pi]; a pose is the centre of the box; arrays are read-only.
"""

from deepmf_sumo.datatypes.arrays import Bools, Bytes, Floats, Ints, frozen
from deepmf_sumo.datatypes.attack import Attack, Budget, Trial
from deepmf_sumo.datatypes.case import AvDriver, Case, NetworkSource, Traffic
from deepmf_sumo.datatypes.command import Command, VehicleModel
from deepmf_sumo.datatypes.forecast import Forecast, Futures, OpponentScores
from deepmf_sumo.datatypes.metric import MetricValue
from deepmf_sumo.datatypes.net import ConversionReport, LanePiece, SignalLink, SumoNet
from deepmf_sumo.datatypes.plan import Plan, PlanReason
from deepmf_sumo.datatypes.road import (
    Boundary,
    Lane,
    Neighbour,
    Polygon,
    Polyline,
    RoadMap,
    Signals,
    SignalState,
    StopSign,
)
from deepmf_sumo.datatypes.rollout import Contact, Driver, Event, Rollout
from deepmf_sumo.datatypes.scene import (
    DT_S,
    FUTURE_STEPS,
    HISTORY_STEPS,
    ROLLOUT,
    SIMULATED,
    AgentId,
    AgentKind,
    Scene,
    Source,
    Tracks,
)
from deepmf_sumo.datatypes.turn import Turn, TurnRules
from deepmf_sumo.datatypes.view import View

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
    "Ints",
    "Lane",
    "LanePiece",
    "MetricValue",
    "Neighbour",
    "NetworkSource",
    "OpponentScores",
    "Plan",
    "PlanReason",
    "Polygon",
    "Polyline",
    "RoadMap",
    "Rollout",
    "Scene",
    "SignalLink",
    "SignalState",
    "Signals",
    "Source",
    "StopSign",
    "SumoNet",
    "Tracks",
    "Traffic",
    "Trial",
    "Turn",
    "TurnRules",
    "VehicleModel",
    "View",
    "frozen",
]
