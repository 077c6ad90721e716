"""A recorded scene: who was where, on which road, under which signals."""

from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np

from deepmf_sumo.datatypes.arrays import Bools, Floats, frozen
from deepmf_sumo.datatypes.road import RoadMap, Signals

DT_S: Final = 0.1
HISTORY_STEPS: Final = 11
"""1 s of history and the current step."""
FUTURE_STEPS: Final = 80
"""8 s to come."""

AgentId = str
AgentKind = Literal["vehicle", "pedestrian", "cyclist", "other"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tracks:
    """Motion of A agents over T steps.

    Attributes:
        ids: (A) unique.
        kinds: (A).
        size_m: (A, 3) length, width, height. One size per agent: that of the current step, else of
            the valid step nearest to it.
        position_m: (A, T, 2) box centre in the scene's frame.
        z_m: (A, T).
        heading_rad: (A, T).
        velocity_mps: (A, T, 2) in the scene's frame.
        valid: (A, T) False where the other rows mean nothing (they are zero there).
    """

    ids: tuple[AgentId, ...]
    kinds: tuple[AgentKind, ...]
    size_m: Floats
    position_m: Floats
    z_m: Floats
    heading_rad: Floats
    velocity_mps: Floats
    valid: Bools

    def __post_init__(self) -> None:
        agents, steps = len(self.ids), np.shape(self.valid)[1]
        shapes = {
            "size_m": (agents, 3),
            "position_m": (agents, steps, 2),
            "z_m": (agents, steps),
            "heading_rad": (agents, steps),
            "velocity_mps": (agents, steps, 2),
        }
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                raise ValueError(f"{name} has shape {np.shape(getattr(self, name))}, not {shape}")
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "valid", frozen(self.valid, bool))

    @property
    def agents(self) -> int:
        """Number of agents, A."""
        return len(self.ids)

    @property
    def steps(self) -> int:
        """Number of steps, T."""
        return int(self.valid.shape[1])

    @property
    def speed_mps(self) -> Floats:
        """(A, T) length of the velocity."""
        speed: Floats = np.hypot(self.velocity_mps[..., 0], self.velocity_mps[..., 1])
        return speed

    def row(self, agent_id: AgentId) -> int:
        """Row of an agent. Raises KeyError if there is none of that id."""
        try:
            return self.ids.index(agent_id)
        except ValueError:
            raise KeyError(agent_id) from None

    def window(self, start: int, stop: int) -> "Tracks":
        """Steps start..stop-1 of all agents."""
        return Tracks(
            ids=self.ids,
            kinds=self.kinds,
            size_m=self.size_m,
            position_m=self.position_m[:, start:stop],
            z_m=self.z_m[:, start:stop],
            heading_rad=self.heading_rad[:, start:stop],
            velocity_mps=self.velocity_mps[:, start:stop],
            valid=self.valid[:, start:stop],
        )

    def select(self, rows: list[int]) -> "Tracks":
        """The given rows, in the given order."""
        return Tracks(
            ids=tuple(self.ids[row] for row in rows),
            kinds=tuple(self.kinds[row] for row in rows),
            size_m=self.size_m[rows],
            position_m=self.position_m[rows],
            z_m=self.z_m[rows],
            heading_rad=self.heading_rad[rows],
            velocity_mps=self.velocity_mps[rows],
            valid=self.valid[rows],
        )


SIMULATED: Final = "sumo"
"""Data set of scenes of SUMO's own traffic."""
ROLLOUT: Final = "rollout"
"""Data set of attacks that were written as scenes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """Where a scene came from.

    Attributes:
        dataset: name of the reader, e.g. ``womd``; else `SIMULATED` or `ROLLOUT`.
        file: path as given by the user.
        record: index of the record in the file.
        sha256: hex digest of the record's bytes (of the whole file where it holds one scene);
            empty for a `ROLLOUT` in a network's own traffic.
    """

    dataset: str
    file: str
    record: int
    sha256: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """One recorded scene.

    Attributes:
        name: the recording's scenario id.
        dt_s: seconds a step.
        now: index of the current step; steps up to it are history.
        timestamps_s: (T) as recorded.
        interest: ids of the labelled interacting agents (0 or 2).
        to_predict: ids that the data set asks to predict.
        repairs: what the reader had to mend, a sentence each.
    """

    name: str
    source: Source
    dt_s: float
    now: int
    timestamps_s: Floats
    tracks: Tracks
    road: RoadMap
    signals: Signals
    av_id: AgentId
    interest: tuple[AgentId, ...] = ()
    to_predict: tuple[AgentId, ...] = ()
    repairs: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        object.__setattr__(self, "timestamps_s", frozen(self.timestamps_s))
        self.tracks.row(self.av_id)

    @property
    def partner_id(self) -> AgentId | None:
        """The labelled agent that interacts with the AV, if the label names the AV."""
        others = [agent for agent in self.interest if agent != self.av_id]
        return others[0] if len(others) == 1 and self.av_id in self.interest else None
