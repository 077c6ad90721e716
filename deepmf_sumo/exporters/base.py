"""What an exporter is: a finished run in a format that other programs read, and what that is."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Protocol, Self

import numpy as np

from deepmf_sumo.scene import (
    ROLLOUT,
    AgentId,
    Case,
    Floats,
    RecordedCase,
    RoadMap,
    Rollout,
    Signals,
    Source,
    Tracks,
)
from deepmf_sumo.scene.road_users import usual_size_m

AXLE: Final = 0.28
"""Distance of a vehicle's axles from the centre of its box, in lengths, for formats that ask."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunRoad:
    """The road of a run, and what is known of it.

    Attributes:
        source: of the recording, with the data set `ROLLOUT`; of networks the configuration.
        signals: from the run's first step on; of a network those near AV and opponent, from the
            current step on. None where they are not known.
        lost: why the road is not the one that was attacked on; empty where it is.
    """

    road: RoadMap
    source: Source
    signals: Signals | None
    lost: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class NetFiles:
    """The SUMO network of a run, and the polygons to draw with it, or None."""

    net: Path
    additional: Path | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Exportable:
    """A finished run: what a format is made of. Road and network are looked up when asked for.

    Attributes:
        name: stable and unique in a batch: the run id.
        duration_steps: steps after the current one that the run could have had.
        made: ids of the people who are not in the demand: they were put there.
        look: gives `around`; it may raise UsageError or ReaderError.
        find_net: gives `net`; it may raise UsageError, ReaderError or ConversionError.
    """

    name: str
    rollout: Rollout
    duration_steps: int
    look: Callable[[], RunRoad]
    find_net: Callable[[], NetFiles]
    made: tuple[AgentId, ...] = ()

    @classmethod
    def of(cls, rollout: Rollout, case: Case) -> Self:
        """A run that has just been simulated."""
        if isinstance(case, RecordedCase):
            net = NetFiles(net=case.net.file, additional=case.net.additional)
        else:
            net = NetFiles(net=case.net_file)
        return cls(
            name=case.name,
            rollout=rollout,
            duration_steps=case.duration_steps,
            look=lambda: _around(rollout, case),
            find_net=lambda: net,
            made=tuple(one.id for one in case.made),
        )

    @cached_property
    def around(self) -> RunRoad:
        """The road and its signals."""
        return self.look()

    @cached_property
    def net(self) -> NetFiles:
        """The SUMO network."""
        return self.find_net()


def _around(rollout: Rollout, case: Case) -> RunRoad:
    if isinstance(case, RecordedCase):
        source = replace(case.scene.source, dataset=ROLLOUT)
        return RunRoad(road=case.road, source=source, signals=case.scene.signals)
    source = Source(dataset=ROLLOUT, file=str(case.config), record=0, sha256="")
    return RunRoad(road=case.road, source=source, signals=signals_of(rollout, case.road))


_NEAR_M: Final = 200.0
"""From what AV and opponent drive to the begin of the lane behind a light."""


def lights_near(rollout: Rollout, road: RoadMap) -> list[str]:
    """The lanes behind lights near AV and opponent, in the order in which the rollout has them."""
    names = dict.fromkeys(name for lights in rollout.signals for name in lights)
    known = [name for name in names if name in road.lanes]
    tracks = rollout.tracks
    main = [row for row, one in enumerate(tracks.ids) if one in (rollout.av_id, *rollout.attackers)]
    driven = np.concatenate([tracks.position_m[row, tracks.valid[row]] for row in main])
    if not known or not len(driven):
        return []
    stops = np.array([road.lanes[name].centre_m[0] for name in known])
    low, high = driven.min(axis=0) - _NEAR_M, driven.max(axis=0) + _NEAR_M
    inside = ((stops >= low) & (stops <= high)).all(axis=1)
    return [name for name, near in zip(known, inside, strict=True) if near]


def signals_of(rollout: Rollout, road: RoadMap) -> Signals | None:
    """The lights near AV and opponent, on a network: a lane begins at its stop line."""
    lanes = lights_near(rollout, road)
    if not lanes:
        return None
    state = np.zeros((len(lanes), rollout.tracks.steps), np.uint8)
    seen = np.zeros(state.shape, bool)
    for number, lights in enumerate(rollout.signals, rollout.now):
        for row, lane in enumerate(lanes):
            if lane in lights:
                state[row, number], seen[row, number] = lights[lane], True
    starts = [road.lanes[lane] for lane in lanes]
    return Signals(
        lane_ids=tuple(lanes),
        state=state,
        seen=seen,
        stop_m=np.array([lane.centre_m[0] for lane in starts]),
        stop_z_m=np.array([lane.z_m[0] for lane in starts]),
    )


_CAR_M: Final = 1.5
"""Height of a vehicle where a run does not know it, as of earlier versions."""


def known_heights(tracks: Tracks) -> Floats:
    """(A) heights of the boxes; a usual one where a run does not know it, for a box has one."""
    usual = [_CAR_M if kind == "vehicle" else usual_size_m(kind)[2] for kind in tracks.kinds]
    return np.where(tracks.size_m[:, 2] > 0, tracks.size_m[:, 2], usual)


class Exporter(Protocol):
    """One format, usually a module.

    Attributes:
        FILE: name of what is written in a run's folder; ends with ``/`` for a folder.
        Settings: a `plugins.Settings`; every setting has a default.
    """

    FILE: str
    Settings: type[Any]

    def write(self, run: Exportable, path: Path, settings: Any) -> None:
        """Write a run to ``path``; the same run gives the same bytes.

        ``path`` appears whole, and replaces what was there: `files.write` and `files.whole_folder`
        do both. Raises OutputError where it cannot be written, RunError where the format cannot
        hold the run, and what `Exportable.around` and `Exportable.net` raise.
        """
        ...
