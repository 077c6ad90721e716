"""The conflicts of a SUMO configuration's own traffic. SUMO has a process of its own: it may crash.

It names road users, lanes and times; `roadcheck.conflict_places` has the places of the network.
"""

import json
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepmf_sumo import files, tables
from deepmf_sumo.errors import DeepmfError, OutputError, SimulationError, UsageError
from deepmf_sumo.exporters import ssam
from deepmf_sumo.judge.metrics.traffic_conflicts import (
    ConflictLimits,
    SsamType,
    TrafficConflict,
    find,
)
from deepmf_sumo.roadcheck.motion_survey import Survey, Surveyed, survey
from deepmf_sumo.study.sweep import streams, workers
from deepmf_sumo.sumo.simulation.sumo_config import read_configuration

TRAJECTORIES: Final = "traffic.trj"
"""Time 0 is the begin of the observation, in steps of 0.1 s."""
ROAD_USERS: Final = "road_users.csv"
"""Which road user each number of the trajectories is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """One of the two road users of a conflict.

    Attributes:
        lane: on which it passed the common place. lanes: of the conflict up to there.
        speed_mps, pose: at the least time to collision; x and y of the centre (m), heading (rad),
            length, width (m).
        delta_v_mps: see `TrafficConflict`.
    """

    id: str
    type: str
    lane: str
    lanes: tuple[str, ...]
    speed_mps: float
    pose: tuple[float, float, float, float, float]
    delta_v_mps: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Observed:
    """One conflict; see `TrafficConflict`. ``place_m``: centre of the first at the common place."""

    first: Side
    second: Side
    begin_s: float
    end_s: float
    ttc_s: float
    ttc_at_s: float
    pet_s: float
    type: SsamType
    angle_deg: float
    max_s_mps: float
    delta_s_mps: float
    max_d_mps2: float
    place_m: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """The conflicts from ``begin_s`` to ``until_s``.

    Attributes:
        complete: the configuration's traffic ends there.
        users: number of road users. user_steps: of their steps of 0.1 s.
        left_out: encounters that are not conflicts, by reason.
        driven: for each lane, the road users (by number) that were on it.
        warnings: SUMO's, see `sumo.simulation.sumo_words`.
    """

    begin_s: float
    until_s: float
    complete: bool
    users: int
    user_steps: int
    conflicts: tuple[Observed, ...]
    left_out: Mapping[str, int]
    driven: Mapping[str, tuple[int, ...]]
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Task:
    wanted: Survey
    limits: ConflictLimits
    answer: Path
    trajectories: Path | None


def check(wanted: Survey) -> None:
    """Raise UsageError for times that are not in the traffic, SimulationError for the files."""
    configuration = read_configuration(wanted.config, wanted.sumo_options)
    begin = max(wanted.from_s or 0.0, configuration.begin_s)
    if wanted.until_s is not None and wanted.until_s <= begin:
        raise UsageError(
            f"--until {wanted.until_s:.12g}: must be later than the beginning at {begin:.12g} s"
            " (--from, or the configuration's begin)."
        )
    if configuration.end_s is not None and begin >= configuration.end_s:
        raise UsageError(
            f"--from {begin:.12g}: {wanted.config.name} ends at {configuration.end_s:.12g} s;"
            " choose an earlier time."
        )


def observe(
    wanted: Survey, limits: ConflictLimits, trajectories: Path | None = None
) -> Observation:
    """Simulate the configuration once, and find its conflicts.

    ``trajectories``: a folder for `TRAJECTORIES` and `ROAD_USERS`.

    Raises SimulationError, with SUMO's own message, where it cannot be run, or without traffic,
    UsageError for times that are not in it, and OutputError where the folder cannot be written.
    """
    check(wanted)
    with tempfile.TemporaryDirectory(prefix="deepmf-sumo-") as folder:
        task = _Task(
            wanted=wanted,
            limits=limits,
            answer=Path(folder) / "found.json",
            trajectories=trajectories,
        )
        (ending,) = workers.run(_observe, [task], jobs=1, timeout_s=None)
        if ending.status != "done":
            raise SimulationError(f"SUMO cannot run '{wanted.config}': {ending.reason}.")
        answer = json.loads(task.answer.read_text("utf-8"))
    if "cannot_write" in answer:
        raise OutputError(answer["cannot_write"])
    if "error" in answer:
        raise SimulationError(answer["error"])
    return _read(answer)


def _observe(task: _Task) -> None:
    """The worker's part."""
    streams.silence()  # what SUMO prints is in its errors, too
    try:
        seen = survey(task.wanted)
        if task.trajectories is not None:
            write_trajectories(seen, task.trajectories)
        answer: dict[str, Any] = asdict(observation(seen, task.limits))
    except OutputError as error:
        answer = {"cannot_write": str(error)}
    except DeepmfError as error:
        answer = {"error": str(error)}
    files.write_json(task.answer, answer)


def write_trajectories(seen: Surveyed, folder: Path) -> None:
    """Write the traffic for FHWA's SSAM, and which road user each number is. Raises OutputError."""
    motions = seen.motions
    origin = ssam.origin_of(motions)
    rows = [
        {
            "number": number,
            "id": name,
            "type": kind,
            "length_m": float(length),
            "width_m": float(width),
        }
        for number, (name, kind, (length, width)) in enumerate(
            zip(seen.names, seen.types, motions.size_m, strict=True), 1
        )
    ]
    with files.writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        files.write(folder / TRAJECTORIES, ssam.trajectories(motions, origin))
        files.write(folder / ROAD_USERS, tables.to_csv(rows))


def observation(seen: Surveyed, limits: ConflictLimits) -> Observation:
    """The conflicts of what was surveyed."""
    motions = seen.motions
    found = find(motions, limits)
    whole = motions.whole[motions.body]
    users = np.unique(np.stack([motions.lane, whole]), axis=1)
    driven = {
        name: tuple(users[1, users[0] == lane].tolist()) for lane, name in enumerate(seen.lanes)
    }
    return Observation(
        begin_s=seen.begin_s,
        until_s=seen.until_s,
        complete=seen.complete,
        users=len(np.unique(motions.whole)),
        user_steps=int((whole == motions.body).sum()),
        conflicts=tuple(_observed(seen, one) for one in found.conflicts),
        left_out=found.left_out,
        driven=driven,
        warnings=seen.warnings,
    )


def _observed(seen: Surveyed, one: TrafficConflict) -> Observed:
    motions = seen.motions
    begin_s, end_s, ttc_at_s = (
        round(seen.begin_s + step * motions.dt_s, 3) for step in (one.begin, one.end, one.ttc_step)
    )
    x, y = motions.position_m[one.pet_rows[0]].tolist()
    return Observed(
        first=_side(seen, one, 0),
        second=_side(seen, one, 1),
        begin_s=begin_s,
        end_s=end_s,
        ttc_s=one.ttc_s,
        ttc_at_s=ttc_at_s,
        pet_s=round(one.pet_s, 3),
        type=one.type,
        angle_deg=one.angle_deg,
        max_s_mps=one.max_s_mps,
        delta_s_mps=one.delta_s_mps,
        max_d_mps2=one.max_d_mps2,
        place_m=(x, y),
    )


def _side(seen: Surveyed, one: TrafficConflict, which: int) -> Side:
    motions, row = seen.motions, one.ttc_rows[which]
    body = (one.first, one.second)[which]
    x, y = motions.position_m[row].tolist()
    length, width = motions.size_m[body].tolist()
    return Side(
        id=seen.names[motions.whole[body]],
        type=seen.types[body],
        lane=seen.lanes[motions.lane[one.pet_rows[which]]],
        lanes=tuple(seen.lanes[lane] for lane in one.lanes[which]),
        speed_mps=float(motions.speed_mps[row]),
        pose=(x, y, float(motions.heading_rad[row]), length, width),
        delta_v_mps=one.delta_v_mps[which],
    )


def _read(answer: dict[str, Any]) -> Observation:
    conflicts = tuple(
        Observed(**one | {name: _read_side(one[name]) for name in ("first", "second")})
        for one in answer.pop("conflicts")
    )
    return Observation(conflicts=conflicts, **answer)


def _read_side(values: dict[str, Any]) -> Side:
    return Side(**values | {name: tuple(values[name]) for name in ("lanes", "pose")})
