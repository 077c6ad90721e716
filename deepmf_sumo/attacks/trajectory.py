"""A fixed trajectory, which replays a known attack: the opponent drives given poses."""

import csv
import io
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Final, Self

import numpy as np
from pydantic import Field, model_validator

from deepmf_sumo import files, plugins
from deepmf_sumo.attacks.base import Simulate
from deepmf_sumo.deepmf.opponent import named
from deepmf_sumo.errors import PluginError, RunError
from deepmf_sumo.scene import AgentId, AgentKind, Attack, Budget, Case, Floats, Plan, View
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.road_users import PEOPLE


class Settings(plugins.Settings):
    """The opponent and its trajectory; exactly one of ``poses`` and ``file``.

    Attributes:
        agent: id of the opponent: a vehicle, a cyclist, or a person, whom ``person NAME`` names, or
            as SUMO has it where no vehicle has the name.
        poses: rows of x_m, y_m, heading_rad (box centre, radians), and optionally speed_mps, one
            for each step of 0.1 s. Speeds that are not stated follow from the poses. Where the
            first one is up to 10 m beside the opponent, it goes there from where it is.
        file: a table (.csv, .csv.gz) with columns step, x_m, y_m, heading_rad, and optionally
            speed_mps and id (rows of other agents are ignored), such as a tracks.csv.gz of a
            result; or an .npz with arrays step (K), position_m (K, 2), heading_rad (K), and
            optionally speed_mps (K).
        first_step: step of the first of ``poses``; null: the one after the current step.
    """

    agent: str = Field(min_length=1)
    poses: list[list[float]] | None = None
    file: str | None = None
    first_step: int | None = Field(default=None, ge=0)

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.poses is None) == (self.file is None):
            raise ValueError("give exactly one of poses and file")
        sizes = {len(pose) for pose in self.poses or ()}
        if self.poses is not None and sizes not in ({3}, {4}):
            raise ValueError(
                "poses needs at least one row of three: x_m, y_m, heading_rad; with speed_mps all"
                " rows have four"
            )
        if any(len(pose) == 4 and not pose[3] >= 0 for pose in self.poses or ()):
            raise ValueError("a speed_mps of poses is below 0")
        if any(abs(pose[2]) > frames.TURNED_RAD for pose in self.poses or ()):
            raise ValueError(f"a heading_rad of poses is beyond {frames.TURNED_RAD:g} rad")
        if self.file is not None and self.first_step is not None:
            raise ValueError("first_step goes with poses; a file has its own steps")
        return self


class TrajectoryPolicy:
    """The policy: one plan, made at the first view.

    Raises PluginError if the file is missing or contains something else.
    """

    period_steps: int | None = None

    def __init__(self, settings: Settings) -> None:
        self._agent = settings.agent
        self._first_step = settings.first_step
        if settings.file is None:
            self._poses = np.asarray(settings.poses, dtype=float)
        else:
            self._first_step, self._poses = _read(Path(settings.file), settings.agent)

    def reset(self, view: View, rng: np.random.Generator) -> tuple[AgentId, ...]:
        """The named opponent. Raises RunError if it is not in the view."""
        self._agent = named(view, self._agent, _DRIVABLE)
        return (self._agent,)

    def plan(self, view: View) -> Mapping[AgentId, Plan]:
        """All poses after the view's step. Raises RunError if the next step has none."""
        first = view.step + 1 if self._first_step is None else self._first_step
        skipped = view.step + 1 - first
        if not 0 <= skipped < len(self._poses):
            raise RunError(
                f"the trajectory of '{self._agent}' has steps {first} to "
                f"{first + len(self._poses) - 1}, but the opponent is driven from step "
                f"{view.step + 1}; give poses from there."
            )
        poses = self._poses[skipped:]
        row = view.history.row(self._agent)
        before = view.history.position_m[row, -1]
        placed = _begun(poses[:, :3], view, row)
        led = bool((placed != poses[:, :3]).any())
        moved = np.diff(np.concatenate([before[None], placed[:, :2]]), axis=0)
        stated = None if led or poses.shape[1] < 4 else poses[:, 3]
        plan = Plan(
            agent_id=self._agent,
            first_step=view.step + 1,
            position_m=placed[:, :2],
            heading_rad=frames.wrap(placed[:, 2]),
            speed_mps=np.hypot(*moved.T) / view.dt_s if stated is None else stated,
        )
        return {self._agent: plan}


def _begun(poses: Floats, view: View, row: int) -> Floats:
    """The poses (K, 3), from where the vehicle is: a first pose elsewhere is led to smoothly."""
    tracks, dt_s = view.history, view.dt_s
    heading = float(tracks.heading_rad[row, -1])
    ahead = tracks.speed_mps[row, -1] * dt_s * frames.unit(heading)
    offset = poses[0, :2] - (tracks.position_m[row, -1] + ahead)
    turned = float(frames.wrap(poses[0, 2] - heading))
    away_m = float(np.hypot(*offset))
    if away_m > _FAR_M or (away_m <= _NEAR_M and abs(turned) <= _TURNED_RAD):
        return poses
    seconds = max(_FADES_S, away_m / _FADES_MPS)
    part = np.clip((1.0 + np.arange(len(poses))) * dt_s / seconds, 0.0, 1.0)[:, None]
    left = 1.0 - part**2 * (3.0 - 2.0 * part)
    return poses - left * np.array([*offset, turned])


def _read(path: Path, agent: AgentId) -> tuple[int, Floats]:
    """First step and (K, 3) poses of a file, or (K, 4) with speeds."""
    try:
        content = files.content(path)
        rows = _from_npz(content) if path.suffix == ".npz" else _from_csv(path, content, agent)
    except _DAMAGED as error:
        raise PluginError(
            f"trajectory file '{path}' cannot be used: {error}; it needs {', '.join(_COLUMNS)}."
        ) from None
    steps = rows[:, 0]
    if len(rows) == 0 or not np.array_equal(steps, steps[:1] + np.arange(len(steps))):
        raise PluginError(
            f"trajectory file '{path}' needs one row a step without gaps for agent '{agent}', "
            f"but has steps {steps[:5].tolist()} ..."
        )
    if not np.isfinite(rows).all():
        raise PluginError(f"trajectory file '{path}' contains numbers that are not finite.")
    if (np.abs(rows[:, 3]) > frames.TURNED_RAD).any():
        raise PluginError(
            f"trajectory file '{path}' has a heading_rad beyond {frames.TURNED_RAD:g} rad."
        )
    return int(steps[0]), rows[:, 1:]


def _from_csv(path: Path, content: bytes, agent: AgentId) -> Floats:
    if path.suffix == ".gz":
        with files.unpacked(path) as stream:
            content = stream.read()
    table = csv.DictReader(io.StringIO(content.decode("utf-8")))
    missing = [name for name in _COLUMNS if name not in (table.fieldnames or ())]
    if missing:
        raise ValueError(f"column {missing[0]} is missing")
    names = [*_COLUMNS, *({_SPEED} & set(table.fieldnames or ()))]
    rows = [[float(row[name]) for name in names] for row in table if row.get("id", agent) == agent]
    return np.asarray(rows, dtype=float).reshape(-1, len(names))


def _from_npz(content: bytes) -> Floats:
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        columns = [arrays["step"][:, None], arrays["position_m"], arrays["heading_rad"][:, None]]
        columns += [arrays[_SPEED][:, None]] if _SPEED in arrays else []
        rows: Floats = np.concatenate(columns, axis=1).astype(float)
    return rows


_COLUMNS = ("step", "x_m", "y_m", "heading_rad")
_SPEED = "speed_mps"
_DRIVABLE: Final[tuple[AgentKind, ...]] = ("vehicle", *PEOPLE)
_NEAR_M = 0.35
"""A first pose farther from where the vehicle drives on to is away from it."""
_FAR_M = 10.0
"""One that begins farther away means another place: it is driven as given."""
_TURNED_RAD = 0.15
_FADES_S = 1.5
_FADES_MPS = 3.0
"""The way to a trajectory that begins elsewhere takes this time, and more if it is far."""
_DAMAGED = (
    OSError,
    EOFError,
    KeyError,
    IndexError,
    TypeError,
    ValueError,
    zipfile.BadZipFile,
    zlib.error,
)
"""Errors of reading a damaged file."""


class TrajectoryAttack:
    """One episode under the fixed trajectory."""

    def __init__(self, settings: Settings) -> None:
        self._policy = TrajectoryPolicy(settings)

    def attack(
        self,
        case: Case,
        simulate: Simulate,
        budget: Budget,
        rng: np.random.Generator,
    ) -> Attack:
        """The episode."""
        return Attack(rollout=simulate(self._policy), simulations=1, generation_s=0.0)


def build(settings: Settings, weights: str) -> TrajectoryAttack:
    """The adversary. Raises PluginError if the trajectory's file cannot be used."""
    return TrajectoryAttack(settings)
