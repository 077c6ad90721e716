"""Copies of the careful planner with exactly one fault each.

A fault is made by composition: it changes what the planner is shown (`Seen`), its settings, or what
it commands (`Commanded`). In a spec::

    planner: {name: "studies.planner_faults.faults:Faulty", fault: late_05}
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Final

import numpy as np
from pydantic import field_validator

from deepmf_sumo.errors import nearest
from deepmf_sumo.plugins import Settings as PluginSettings
from deepmf_sumo.scene import (
    AgentId,
    Bools,
    Case,
    Command,
    Floats,
    SignalState,
    Tracks,
    VehicleModel,
    View,
)
from deepmf_sumo.scene.car_following import TREIBER
from deepmf_sumo.scene.geometry import boxes, frames, polylines
from deepmf_sumo.scene.geometry.slow import WAITING_MPS
from studies.planner_faults import careful, unguarded
from studies.planner_faults.unguarded import STOPS, Others, around, lanes_ahead, limit_of, speed_of


class Episode:
    """What a fault remembers of an episode.

    Attributes:
        start: first step. phase: drawn from the seed, within [0, 1).
        hidden: agent -> last step at which it was hidden.
    """

    def __init__(self, phase: float) -> None:
        self.start: int | None = None
        self.phase = phase
        self.hidden: dict[AgentId, int] = {}

    def seconds(self, view: View) -> float:
        """Time since the first view."""
        if self.start is None:
            self.start = view.step
        return (view.step - self.start) * view.dt_s

    def in_turn(self, view: View, every_s: float, for_s: float) -> bool:
        """Whether it is one of the times, ``for_s`` long, that come every ``every_s``."""
        return (self.seconds(view) + self.phase * every_s) % every_s >= every_s - for_s - 1e-9


Seen = Callable[[View, Episode], View]
Commanded = Callable[[Command, View, Episode], Command]


def without(lost: Callable[[Others], Bools]) -> Seen:
    """A fault that does not see some agents."""

    def seen(view: View, _: Episode) -> View:
        gone = np.asarray(lost(around(view)), bool)
        me = view.history.row(view.av_id)
        rows = [row for row in range(view.history.agents) if row == me or not gone[row]]
        return replace(view, history=view.history.select(rows))

    return seen


def with_speeds(factor: Callable[[Others], Floats]) -> Seen:
    """A fault that takes others to be faster or slower by a factor."""

    def seen(view: View, _: Episode) -> View:
        factors = np.asarray(factor(around(view)), float).copy()
        factors[view.history.row(view.av_id)] = 1.0
        velocity = view.history.velocity_mps * factors[:, None, None]
        return replace(view, history=_tracks(view.history, velocity_mps=velocity))

    return seen


_NOISE: Final = 0.03


def _noisy(seed: int) -> Seen:
    """Speeds of others with an error of normal distribution, another in each step."""

    def seen(view: View, episode: Episode) -> View:
        def factor(others: Others) -> Floats:
            drawn = np.random.default_rng((seed, view.step))
            return 1.0 + _NOISE * drawn.standard_normal(len(others.speed_mps))

        return with_speeds(factor)(view, episode)

    return seen


def _tracks(tracks: Tracks, **changed: Any) -> Tracks:
    return replace(tracks, **changed)


def _crossing(seen: Others) -> Bools:
    return (seen.turn_rad > np.pi / 4) & (seen.turn_rad < 3 * np.pi / 4)


def _cutting_in(seen: Others) -> Bools:
    """Vehicles that drive along, partly in the corridor or beside it within a lane."""
    along = (seen.turn_rad < np.pi / 4) & (seen.speed_mps > WAITING_MPS)
    return along & (seen.clearance_m > -seen.width_m) & (seen.clearance_m < 3.5)


def _partly(seen: Others) -> Bools:
    """Whose box reaches into the corridor by less than half its width."""
    return (seen.clearance_m < 0) & (seen.clearance_m > -seen.width_m / 2)


def _in_curves(seen: Others) -> Bools:
    """All, where the path turns by more than 10 degrees within the next 25 m."""
    path = seen.view.av_path_m
    bends = False
    if path is not None and len(path) > 2:
        _, course = polylines.points_at(path, np.array([0.0, 10.0, 25.0]))
        bends = bool(np.abs(frames.difference(course, course[0])).max() > np.radians(10))
    return np.full(len(seen.speed_mps), bends)


def _hidden(view: View, episode: Episode) -> View:
    """Without those behind another box as seen from the AV, and for a second after that."""
    tracks, me = view.history, view.history.row(view.av_id)
    position = tracks.position_m[:, -1]
    for row in range(tracks.agents):
        if row != me and _behind_box(tracks, me, row):
            episode.hidden[tracks.ids[row]] = view.step
    forgotten = {
        name
        for name, step in episode.hidden.items()
        if (view.step - step) * view.dt_s <= 1.0 + 1e-9
    }
    rows = [row for row in range(len(position)) if tracks.ids[row] not in forgotten]
    return replace(view, history=tracks.select(rows))


def _behind_box(tracks: Tracks, me: int, row: int) -> bool:
    """Whether a third vehicle's box lies on the line between two centres."""
    start, end = tracks.position_m[me, -1], tracks.position_m[row, -1]
    way = end - start
    others = [each for each in range(tracks.agents) if each not in (me, row)]
    line = np.array([np.hypot(*way), 0.1])
    hit = boxes.overlap(
        (start + end) / 2, np.arctan2(way[1], way[0]), line,
        tracks.position_m[others, -1], tracks.heading_rad[others, -1], tracks.size_m[others, :2],
    )  # fmt: skip
    return bool(hit.any())


def _late(view: View, _: Episode) -> View:
    """Others as they were three steps ago; the AV itself as it is."""
    tracks, me = view.history, view.history.row(view.av_id)
    column = np.maximum(np.arange(tracks.steps) - 3, 0)
    valid = tracks.valid[:, column]
    then = {
        name: getattr(tracks, name)[:, column].copy()
        for name in ("position_m", "z_m", "heading_rad", "velocity_mps")
    }
    for name, values in then.items():
        values[me] = getattr(tracks, name)[me]
    valid = valid.copy()
    valid[me] = tracks.valid[me]
    shown = _tracks(tracks, valid=valid, **then)
    return replace(view, history=shown.select(np.flatnonzero(valid[:, -1]).tolist()))


def _narrow(view: View, _: Episode) -> View:
    """The AV 0.5 m narrower than it is."""
    size = view.history.size_m.copy()
    size[view.history.row(view.av_id), 1] -= 0.5
    return replace(view, history=_tracks(view.history, size_m=size))


def _frozen(command: Command, view: View, episode: Episode) -> Command:
    """The present speed for 0.5 s, every 4 s."""
    if episode.in_turn(view, 4.0, 0.5):
        return Command(kind="speed", speed_mps=speed_of(view))
    return command


def _phantom(command: Command, view: View, episode: Episode) -> Command:
    """5 m/s2 of braking for 0.8 s, every 5 s."""
    if not episode.in_turn(view, 5.0, 0.8):
        return command
    slower = max(0.0, speed_of(view) - 5.0 * view.dt_s)
    asked = command.speed_mps if command.kind == "speed" else slower
    return Command(kind="speed", speed_mps=min(slower, asked))


def _speeding(command: Command, view: View, _: Episode) -> Command:
    """Where nothing is ahead and it drives at the limit, on to 1.15 times the limit."""
    limit, speed = limit_of(view), speed_of(view)
    if command.kind != "sumo" or limit is None or speed < 0.95 * limit or _stops(view):
        return command
    faster = speed + TREIBER.accel_mps2 * view.dt_s
    return Command(kind="speed", speed_mps=min(faster, 1.15 * limit))


_YELLOW: Final = {SignalState.CAUTION, SignalState.ARROW_CAUTION}


def _states(view: View) -> set[SignalState]:
    """The signals of the lanes within the next 60 m."""
    lit = {lane.id for lane in lanes_ahead(view, 60.0)} if view.signals else set()
    return {view.signals[name] for name in lit if name in view.signals}


def _stops(view: View) -> bool:
    return bool(_states(view) & STOPS)


def _yellow(command: Command, view: View, _: Episode) -> Command:
    """On at the present speed where its signal is yellow, unless it brakes for a risk."""
    if command.kind == "sumo" and _states(view) & _YELLOW:
        return Command(kind="speed", speed_mps=speed_of(view))
    return command


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One thing that is wrong.

    Attributes:
        about: one line. settings: of `careful` that differ, by name.
        seen, commanded: what changes views and commands; None leaves them.
        unguarded: SUMO would keep what the settings give up, so it does not drive where it may
            react to others.
    """

    about: str
    settings: Mapping[str, float] = field(default_factory=dict)
    seen: Seen | None = None
    commanded: Commanded | None = None
    unguarded: bool = False


_REACTION_S: Final = careful.Settings().reaction_s

FAULTS: Final[dict[str, Fault]] = {
    "late_05": Fault(about="reacts 0.5 s later", settings={"reaction_s": _REACTION_S + 0.5}),
    "late_10": Fault(about="reacts 1 s later", settings={"reaction_s": _REACTION_S + 1.0}),
    "weak_brakes": Fault(about="brakes with 2 m/s2 at most", settings={"hardest_mps2": 2.0}),
    "no_standing": Fault(
        about="does not see what stands", seen=without(lambda one: one.speed_mps < WAITING_MPS)
    ),
    "blind_left": Fault(
        about="sees nothing to its left, from 20 degrees on",
        seen=without(lambda one: _bearing(one) > np.radians(20)),
    ),
    "blind_right": Fault(
        about="sees nothing to its right, from 20 degrees on",
        seen=without(lambda one: _bearing(one) < -np.radians(20)),
    ),
    "near_sighted": Fault(
        about="sees nothing whose centre is beyond 20 m",
        seen=without(lambda one: np.hypot(*one.local_m.T) > 20),
    ),
    "blind_front_corner": Fault(
        about="does not see what is within 8 m ahead and not in its corridor",
        seen=without(
            lambda one: (
                (one.local_m[:, 0] > 0) & (np.hypot(*one.local_m.T) < 8) & (one.clearance_m > -0.3)
            )
        ),
    ),
    "crossing_stops": Fault(
        about="takes crossing traffic to stop at once",
        seen=with_speeds(lambda one: np.where(_crossing(one), 0.0, 1.0)),
    ),
    "oncoming_slow": Fault(
        about="takes oncoming traffic to drive at half its speed",
        seen=with_speeds(lambda one: np.where(one.turn_rad >= 3 * np.pi / 4, 0.5, 1.0)),
    ),
    "late_cut_in": Fault(
        about="ignores a vehicle that cuts in until it is wholly in the corridor",
        seen=without(_cutting_in),
    ),
    "speed_minus_30": Fault(
        about="takes the speed of others to be 30 % less",
        seen=with_speeds(lambda one: np.full(len(one.speed_mps), 0.7)),
    ),
    "speed_plus_30": Fault(
        about="takes the speed of others to be 30 % more",
        seen=with_speeds(lambda one: np.full(len(one.speed_mps), 1.3)),
    ),
    "forgets_hidden": Fault(
        about="does not see who is behind another vehicle, nor for 1 s after that", seen=_hidden
    ),
    "narrow": Fault(about="takes itself to be 0.5 m narrower", seen=_narrow),
    "bold_gaps": Fault(
        about="goes before crossing traffic without a margin, and trusts it to brake hard",
        settings={"before_s": 0.0, "after_s": 0.0, "trusted_mps2": 8.0},
        unguarded=True,
    ),
    "latency_03": Fault(about="sees others as they were 0.3 s ago", seen=_late),
    "freezes": Fault(about="keeps its speed for 0.5 s every 4 s", commanded=_frozen),
    "speeding": Fault(about="drives 15 % over the limit", commanded=_speeding),
    "no_trucks": Fault(
        about="does not see what is longer than 7 m", seen=without(lambda one: one.length_m > 7)
    ),
    "ignores_yellow": Fault(about="drives on at yellow", commanded=_yellow),
    "tailgates": Fault(
        about="keeps a third of the distance",
        settings={"headway_s": 0.5, "gap_m": 0.7, "distance": 0.33},
    ),
    "phantom": Fault(about="brakes for nothing, 0.8 s every 5 s", commanded=_phantom),
    "no_partly": Fault(
        about="ignores what reaches into its corridor by less than half", seen=without(_partly)
    ),
    "lost_in_curves": Fault(
        about="sees nobody where its path turns within 25 m", seen=without(_in_curves)
    ),
    "no_small": Fault(
        about="does not see pedestrians, cyclists and motorcycles",
        seen=without(lambda one: one.length_m < 2.8),
    ),
    "wide_wandering": Fault(
        about="takes no sideways motion for a cut-in",
        settings={"wandering_m": 10.0},
        unguarded=True,
    ),
}
"""All faults by name. What a name means never changes: a different fault gets a new one."""


def _bearing(seen: Others) -> Floats:
    return np.arctan2(seen.local_m[:, 1], seen.local_m[:, 0])


class Settings(PluginSettings):
    """``fault``: a name of `faults`, or ``none`` for the careful planner itself.

    ``unguarded``: by its own IDM wherever SUMO may react to others, as copies with a fault of what
    they see are there: the control, which has no fault. ``noise``: a seed; the speeds of others are
    known to a few per cent. Planners with other seeds do not drive alike, and none is the better.
    """

    faults: ClassVar[Mapping[str, Fault]] = FAULTS
    fault: str = "none"
    unguarded: bool = False
    noise: int | None = None

    @field_validator("fault")
    @classmethod
    def _known(cls, name: str) -> str:
        if name != "none" and name not in cls.faults:
            raise ValueError(f"there is no fault '{name}'.{nearest(name, cls.faults)}")
        return name


class Faulty:
    """The careful planner with one fault."""

    Settings: type[Settings] = Settings
    planner: ClassVar[type[careful.Careful]] = careful.Careful

    @classmethod
    def build(cls, settings: Settings) -> "Faulty":
        """The planner."""
        return cls(settings)

    def __init__(self, settings: Settings) -> None:
        noise = None if settings.noise is None else _noisy(settings.noise)
        control = Fault(about="", seen=noise, unguarded=settings.unguarded)
        self._fault = settings.faults.get(settings.fault, control)
        self._planner = self.planner(self.planner.Settings(**self._fault.settings))
        self._episode = Episode(0.0)

    @property
    def model(self) -> VehicleModel | None:
        """That of the careful planner with the fault's settings."""
        return self._planner.model

    def reset(self, case: Case, rng: np.random.Generator) -> None:
        """Start of an episode; the phase of what comes now and then is the case's seed's."""
        self._planner.reset(case, rng)
        self._episode = Episode(float(np.random.default_rng(case.seed).random()))

    def act(self, view: View) -> Command:
        """The careful planner's command for what the fault shows, changed by the fault."""
        fault, episode = self._fault, self._episode
        shown = fault.seen(view, episode) if fault.seen else view
        command = self._planner.act(shown)
        if "reaction_s" in fault.settings and self._planner.unanswered:
            command = Command(kind="speed", speed_mps=speed_of(view))
        misled = fault.seen is not None and unguarded.misled(view, shown)
        if misled or (fault.unguarded and unguarded.met(view)):
            command = unguarded.driven(command, shown, self._planner.model)
        return fault.commanded(command, view, episode) if fault.commanded else command
