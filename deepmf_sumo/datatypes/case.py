"""What is simulated: who is the AV, from when, for how long, who drives whom."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from deepmf_sumo.datatypes.net import SumoNet
from deepmf_sumo.datatypes.road import RoadMap
from deepmf_sumo.datatypes.scene import AgentId, Scene
from deepmf_sumo.datatypes.turn import TurnRules

Traffic = Literal["log", "sumo"]
AvDriver = Literal["planner", "human"]


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkSource:
    """A SUMO configuration with traffic, run by SUMO up to ``start_s``.

    Attributes:
        net: the network that the configuration names.
        sumo_options: beside the configuration, as on SUMO's command line.
    """

    config: Path
    start_s: float
    net: Path | None = None
    sumo_options: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """One situation to attack.

    Exactly one of ``scene`` (with ``net``) and ``network`` is given.

    Attributes:
        name: stable and unique in a batch; the run id is made of it.
        road: the map that views show: the recording's, or the SUMO network's.
        av_id: track id, or SUMO vehicle id.
        duration_steps: steps after the current one.
        partner_id: the labelled opponent, if the recording names one (``opponent: labelled``).
        av_driver: ``human`` where the AV does what a person did in a recording.
        turns: opponents attack one after another until the duration is over; None: one attacks,
            and its contact with the AV ends the episode.
    """

    name: str
    road: RoadMap
    av_id: AgentId
    duration_steps: int
    traffic: Traffic
    seed: int
    scene: Scene | None = None
    net: SumoNet | None = None
    network: NetworkSource | None = None
    partner_id: AgentId | None = None
    av_driver: AvDriver = "planner"
    turns: TurnRules | None = None

    def __post_init__(self) -> None:
        if (self.scene is None) == (self.network is None):
            raise ValueError("a case has either a scene or a network")
        if (self.scene is None) != (self.net is None):
            raise ValueError("a case with a scene has a converted net, and only such a case")
