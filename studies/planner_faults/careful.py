"""A competent planner: the packaged IDM, and a careful and competent driver's answer to conflicts.

It drives as `idm` with corridor perception: speed limits, signals, right of way and leaders. Others
are predicted at constant velocity (`prediction`). It brakes besides for

- what is in its corridor or cuts in, as the fuzzy safety model of UN Regulation 157 and the proper
  response of RSS ask for, and fully where the regulation's careful and competent driver would. A
  vehicle cuts in as soon as it has come 0.375 m towards the corridor (the regulation's wandering);
- what will be in its corridor at the same time as the AV, with a margin (crossing, merging and
  oncoming vehicles, pedestrians): the least deceleration that lets it pass. A vehicle that can
  still stop comfortably before the corridor is trusted to do so.

It never swerves and changes no lanes by itself (SUMO changes lanes for it as for `idm`).
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from pydantic import Field

from deepmf_sumo.judge.avoidability import reference_drivers as drivers
from deepmf_sumo.judge.avoidability.av_path import AvPath
from deepmf_sumo.planners import idm
from deepmf_sumo.planners.perception import entries
from deepmf_sumo.plugins import Settings as PluginSettings
from deepmf_sumo.scene import (
    AgentId,
    Bools,
    Case,
    Command,
    Floats,
    RoadMap,
    Tracks,
    VehicleModel,
    View,
)
from deepmf_sumo.scene.car_following import TREIBER, desired_gap_m
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.ground import off_level
from deepmf_sumo.scene.geometry.slow import WAITING_MPS
from studies.planner_faults import prediction
from studies.planner_faults.prediction import TIMES_S, Occupancy

_BRAKING: Final = np.array([0.0, 1.0, 2.0, 3.0, 4.5, 6.0, 8.0])
"""Decelerations that are tried."""
_MILD_MPS2: Final = 2.5
"""Less is left to SUMO's IDM behind a leader that would cause it, so that SUMO's reasons count."""
_FORGOTTEN_S: Final = 1.0
"""A risk that has been gone for so long is new when it comes back."""
_SLOWEST_ASIDE_MPS: Final = 0.5
_TOWARDS_MPS: Final = 0.15
_BESIDE_M: Final = 12.0
_RSS_CLOSING_MPS: Final = 0.5
_PARALLEL: Final = np.cos(np.pi / 4)


class Settings(PluginSettings):
    """Lengths are in metres, times in seconds.

    Attributes:
        margin_m: the corridor is wider than the AV by this on both sides.
        reaction_s: from the first sight of a risk to the answer.
        hardest_mps2: it never brakes harder.
        headway_s, gap_m: of the IDM.
        before_s, after_s: of the conflict area, between another vehicle and the AV.
        trusted_mps2: a crossing vehicle that can stop with this before the corridor is trusted.
        wandering_m: sideways motion that is no cut-in yet.
        distance: the part of the safe distances that is kept.
        desired_mps: of the IDM; None is the speed limit.
    """

    margin_m: float = Field(default=0.2, ge=0.0, le=2.0)
    reaction_s: float = Field(default=0.2, ge=0.0, le=5.0)
    hardest_mps2: float = Field(default=8.0, gt=0.0, le=8.0)
    headway_s: float = Field(default=1.5, gt=0.0)
    gap_m: float = Field(default=2.0, ge=0.0)
    before_s: float = Field(default=0.6, ge=-2.0)
    after_s: float = Field(default=0.6, ge=-2.0)
    trusted_mps2: float = Field(default=3.5, gt=0.0)
    wandering_m: float = Field(default=0.375, ge=0.0)
    distance: float = Field(default=1.0, ge=0.0)
    desired_mps: float | None = Field(default=None, gt=0.0)


class Risk(NamedTuple):
    """The answer to each of N agents: a deceleration, 0 for no risk."""

    ids: tuple[AgentId, ...]
    braking_mps2: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Sight:
    """The AV, and the N others that it may meet within the next seconds.

    Attributes:
        followed: what the packaged IDM with corridor perception commands; None is SUMO's own.
        gap_m, direction_rad: (N) as of `perception.entries`.
    """

    followed: Command | None
    gap_m: Floats
    direction_rad: Floats
    ids: tuple[AgentId, ...]
    now: Tracks
    road: RoadMap
    path: AvPath
    speed_mps: float
    accel_mps2: float
    size_m: Floats
    dt_s: float

    @property
    def others_m(self) -> Floats:
        """(N, 2) lengths and widths."""
        return self.now.size_m[:, :2]


class Careful:
    """See the module."""

    Settings: type[Settings] = Settings

    @classmethod
    def build(cls, settings: Settings) -> "Careful":
        """The planner."""
        return cls(settings)

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._model: VehicleModel = idm.build(
            idm.Settings(
                emergency_mps2=settings.hardest_mps2,
                decel_mps2=min(TREIBER.decel_mps2, settings.hardest_mps2),
                headway_s=settings.headway_s,
                gap_m=settings.gap_m,
                desired_mps=settings.desired_mps,
            )
        ).model
        self._since: dict[AgentId, float] = {}
        self._last: dict[AgentId, float] = {}
        self._unanswered = False

    @property
    def model(self) -> VehicleModel:
        """Parameters of the AV's IDM."""
        return self._model

    @property
    def unanswered(self) -> bool:
        """Whether some risk has been seen for less than the reaction time, and none for longer."""
        return self._unanswered

    def reset(self, case: Case, rng: np.random.Generator) -> None:  # noqa: ARG002
        """Start of an episode."""
        self._since, self._last = {}, {}

    def act(self, view: View) -> Command:
        """The IDM's command, or the braking that the worst risk asks for."""
        sight = _sight(view, self._settings.margin_m)
        base = sight.followed or Command(kind="sumo")
        risk = self.risk(sight) if sight.ids else Risk((), np.zeros(0))
        worst = self._perceived(risk, view.step * view.dt_s)
        if worst is None:
            return base
        return self._braked(base, sight, risk.ids[worst], float(risk.braking_mps2[worst]))

    def risk(self, sight: _Sight) -> Risk:
        """The deceleration that each of the others asks for."""
        ahead = _Ahead.of(sight, self._settings)
        braking = np.maximum(self._following(sight, ahead), self._yielding(sight, ahead))
        return Risk(sight.ids, np.minimum(braking, self._settings.hardest_mps2))

    def _following(self, sight: _Sight, ahead: "_Ahead") -> Floats:
        """Of the reference drivers, for those in the corridor and those that cut in."""
        share = max(self._settings.distance, 1e-3)
        gap = np.where(ahead.there, np.maximum(ahead.gap_m, 0.0) / share, 1e6)
        own = np.full(len(gap), sight.speed_mps)
        leader = ahead.along_mps
        model = drivers.FuzzySafety
        critical = drivers.critical_safety(gap, own, leader, np.full(len(gap), sight.accel_mps2))
        proactive = drivers.proactive_safety(gap, own, leader)
        more = model.HARDEST_MPS2 - model.COMFORTABLE_MPS2
        fuzzy = np.where(
            critical > 0, model.COMFORTABLE_MPS2 + more * critical,
            model.COMFORTABLE_MPS2 * proactive,
        )  # fmt: skip
        closing = own - leader
        unsafe = (gap < drivers.safe_distance(own, leader)) & (closing > _RSS_CLOSING_MPS)
        proper = np.where(unsafe, drivers.ResponsibilitySensitive.BRAKING_MPS2, 0.0)
        careful = drivers.CompetentCareful
        soon = (closing > 0) & (gap < closing * careful.HORIZON_S * share)
        full = np.where(soon, careful.HARDEST_MPS2, 0.0)
        answer = np.maximum(np.maximum(fuzzy, proper), full)
        return np.where(ahead.there & (sight.speed_mps > WAITING_MPS), answer, 0.0)

    def _yielding(self, sight: _Sight, ahead: "_Ahead") -> Floats:
        """The least deceleration that avoids all in conflict areas; mild for trusted vehicles."""
        met = _meetings(sight, ahead, self._settings)  # (B, M) first time, inf: never
        free = np.isinf(met)
        first = free.argmax(axis=0)
        # nothing helps: what meets latest, of equals the hardest
        latest = len(_BRAKING) - 1 - met[::-1].argmax(axis=0)
        needed = _BRAKING[np.where(free.any(axis=0), first, latest)]
        needed = np.where(ahead.trusted, np.minimum(needed, _TRUSTING_MPS2), needed)
        answer = np.zeros(len(sight.ids))
        np.maximum.at(answer, ahead.occupancy.agent, needed)
        return answer

    def _perceived(self, risk: Risk, now_s: float) -> int | None:
        """The row of the worst risk that has been seen for the reaction time."""
        asked = np.flatnonzero(risk.braking_mps2 > 0)
        seen = []
        for row in asked.tolist():
            name = risk.ids[row]
            if now_s - self._last.get(name, -np.inf) > _FORGOTTEN_S:
                self._since[name] = now_s
            self._last[name] = now_s
            if now_s - self._since[name] >= self._settings.reaction_s - 1e-6:
                seen.append(row)
        self._unanswered = bool(len(asked)) and not seen
        return max(seen, key=lambda row: risk.braking_mps2[row]) if seen else None

    def _braked(self, base: Command, sight: _Sight, agent: AgentId, braking: float) -> Command:
        """At least this braking: hard by speed, mild as behind a leader, which SUMO may exceed."""
        speed = sight.speed_mps
        model = self._model
        asked = -braking
        if base.kind == "leader":
            asked = min(asked, idm_accel(model, speed, base.gap_m, base.leader_mps))
        if -asked >= _MILD_MPS2:
            slower = max(0.0, speed + max(asked, -self._settings.hardest_mps2) * sight.dt_s)
            return Command(kind="speed", speed_mps=slower, leader_id=agent)
        if asked < -braking:
            return base
        wanted = model.gap_m + speed * model.headway_s
        gap = wanted / np.sqrt(1.0 + braking / model.accel_mps2)
        return Command(kind="leader", gap_m=float(gap), leader_mps=speed, leader_id=agent)


_TRUSTING_MPS2: Final = 0.5
"""For a vehicle that is trusted to give way: the foot off the accelerator."""
_ROOM_M: Final = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ahead:
    """The N others on the AV's path, and M predictions of them.

    Attributes:
        there: (N) in the corridor as a leader, or cutting in.
        gap_m, along_mps: (N) to its rear from the AV's bumper, and its speed along the path.
        occupancy: of the predictions. inside: (M, T) whether it reaches into the corridor.
        trusted: (M) whether it can still stop comfortably before the corridor.
        counts: (M) whether the AV has to avoid it: it is no leader and comes not from behind.
    """

    there: Bools
    gap_m: Floats
    along_mps: Floats
    occupancy: Occupancy
    inside: Bools
    trusted: Bools
    counts: Bools

    @classmethod
    def of(cls, sight: _Sight, settings: Settings) -> "_Ahead":
        """What is seen now."""
        now, gap, direction = sight.now, sight.gap_m, sight.direction_rad
        position, heading = now.position_m[:, -1], now.heading_rad[:, -1]
        velocity, speed = now.velocity_mps[:, -1], now.speed_mps[:, -1]
        along = np.cos(frames.difference(heading, direction)) > _PARALLEL
        leads = np.isfinite(gap) & (along | (speed < WAITING_MPS))
        vehicle = np.array([kind in ("vehicle", "cyclist") for kind in now.kinds], bool)
        futures = prediction.predicted(
            sight.road, position, heading, velocity, vehicle & (speed > WAITING_MPS)
        )
        occupancy = Occupancy.of(sight.path, futures, sight.others_m, float(sight.size_m[1]))
        cuts, course = _cutting_in(sight, occupancy, settings)
        cuts &= ~leads
        occupancy = _with_cut_ins(occupancy, sight, cuts)
        gap = np.where(cuts, occupancy.rear_m[: len(gap), 0] - sight.size_m[0] / 2, gap)
        direction = np.where(cuts, course, direction)
        inside, counts = _relevant(occupancy, sight, leads, settings)
        return cls(
            there=leads | cuts,
            gap_m=gap,
            along_mps=(velocity * frames.unit(direction)).sum(-1),
            occupancy=occupancy,
            inside=inside,
            trusted=_trusted(occupancy, inside, speed, cuts, settings),
            counts=counts,
        )


def _cutting_in(sight: _Sight, occupancy: Occupancy, settings: Settings) -> tuple[Bools, Floats]:
    """(N) True beside the corridor, ahead, and moving into it; (N) the path's direction there."""
    now, agents = sight.now, len(sight.ids)
    beside = (occupancy.clearance_m[:agents, 0] > 0) & (
        occupancy.clearance_m[:agents, 0] < _BESIDE_M
    )
    ahead = occupancy.rear_m[:agents, 0] + occupancy.front_m[:agents, 0] > -sight.size_m[0]
    rows = np.flatnonzero(beside & ahead & occupancy.parallel[:agents, 0])
    cuts, course = np.zeros(agents, bool), np.zeros(agents)
    if len(rows):
        foot = sight.path.project(now.position_m[rows])
        far = np.where(now.valid[rows], np.abs(foot.left_m), -np.inf)
        sideways = far.max(axis=1) - far[:, -1]
        normal = frames.unit(foot.heading_rad[:, -1] + np.pi / 2)
        left_mps = (now.velocity_mps[rows, -1] * normal).sum(-1)
        towards = -np.sign(foot.left_m[:, -1]) * left_mps
        cuts[rows] = (sideways >= settings.wandering_m) & (towards > _TOWARDS_MPS)
        course[rows] = foot.heading_rad[:, -1]
    return cuts, course


def _with_cut_ins(occupancy: Occupancy, sight: _Sight, cuts: Bools) -> Occupancy:
    """The occupancy with a row more for each that cuts in: it comes into the corridor and stays."""
    rows = np.flatnonzero(cuts)
    if not len(rows):
        return occupancy
    foot = sight.path.project(sight.now.position_m[rows, -1])
    velocity = sight.now.velocity_mps[rows, -1]
    left_mps = (velocity * frames.unit(foot.heading_rad + np.pi / 2)).sum(-1)
    along_mps = (velocity * frames.unit(foot.heading_rad)).sum(-1)
    aside = np.maximum(np.abs(left_mps), _SLOWEST_ASIDE_MPS)
    ways = along_mps[:, None] * TIMES_S
    added = Occupancy(
        agent=rows,
        clearance_m=occupancy.clearance_m[rows, :1] - aside[:, None] * TIMES_S,
        rear_m=occupancy.rear_m[rows, :1] + ways,
        front_m=occupancy.front_m[rows, :1] + ways,
        parallel=np.ones((len(rows), len(TIMES_S)), bool),
    )
    return occupancy.joined(added)


def _relevant(
    occupancy: Occupancy, sight: _Sight, leads: Bools, settings: Settings
) -> tuple[Bools, Bools]:
    """(M, T) which are inside the corridor, (M) which of them the AV avoids by yielding."""
    half = sight.size_m[0] / 2
    beside = (occupancy.rear_m[:, 0] < half) & (occupancy.front_m[:, 0] > -half)
    # one that is beside already needs no margin: nothing that the AV does would give it one
    margin = np.where(beside, 0.0, settings.margin_m)[:, None]
    inside = occupancy.clearance_m < margin
    first = inside.argmax(axis=1)
    rows = np.arange(len(first))
    reached = _driven(sight)[0, first]
    behind = occupancy.parallel[rows, first] & (occupancy.front_m[rows, first] < reached - half)
    gone = occupancy.front_m[rows, first] < -half
    return inside, inside.any(axis=1) & ~leads[occupancy.agent] & ~behind & ~gone


def _trusted(
    occupancy: Occupancy, inside: Bools, speed_mps: Floats, cuts: Bools, settings: Settings
) -> Bools:
    """(M) whether a vehicle can stop comfortably before the corridor."""
    speed = speed_mps[occupancy.agent]
    room = speed * TIMES_S[inside.argmax(axis=1)] - _ROOM_M
    return (room > speed**2 / (2 * settings.trusted_mps2)) & ~cuts[occupancy.agent]


def _driven(sight: _Sight) -> Floats:
    """(B, T) where the AV's centre is, going on as it does or braking with `_BRAKING`."""
    speed, accel = sight.speed_mps, min(max(sight.accel_mps2, 0.0), TREIBER.accel_mps2)
    if speed < WAITING_MPS:  # it is going to start
        accel = TREIBER.accel_mps2
    braking = _BRAKING[1:, None]
    moving = np.minimum(TIMES_S, speed / braking)
    braked = speed * moving - braking * moving**2 / 2
    return np.concatenate([(speed * TIMES_S + accel * TIMES_S**2 / 2)[None], braked])


def _meetings(sight: _Sight, ahead: _Ahead, settings: Settings) -> Floats:
    """(B, M) seconds until the AV, braking so, meets a prediction in its corridor; inf: never.

    Each is taken to be there for a while before it comes and after it has gone.
    """
    occupancy, inside = ahead.occupancy, ahead.inside & ahead.counts[:, None]
    rear = np.where(inside, occupancy.rear_m, np.inf)
    front = np.where(inside, occupancy.front_m, -np.inf)
    step = TIMES_S[1]
    earlier, later = round(settings.before_s / step), round(settings.after_s / step)
    rear = _least(rear, earlier, later)
    front = -_least(-front, earlier, later)
    centre, half = _driven(sight)[:, None], sight.size_m[0] / 2
    meet = (centre + half > rear) & (centre - half < front)
    first = TIMES_S[meet.argmax(axis=-1)]
    return np.where(meet.any(axis=-1), first, np.inf)


def _least(values: Floats, earlier: int, later: int) -> Floats:
    """(M, T) least value of the columns from ``later`` before to ``earlier`` after each."""
    padded = np.pad(values, ((0, 0), (later, earlier)), constant_values=np.inf)
    windows = np.lib.stride_tricks.sliding_window_view(padded, earlier + later + 1, axis=1)
    least: Floats = windows.min(axis=-1)
    return least


def idm_accel(model: VehicleModel, speed: float, gap_m: float, leader_mps: float) -> float:
    """Of the IDM behind a leader, without its part for the desired speed."""
    wanted = desired_gap_m(model, speed, leader_mps, lambda keep: max(0.0, keep))
    return float(model.accel_mps2 * (1 - (wanted / max(gap_m, 0.1)) ** 2))


def _sight(view: View, margin_m: float) -> _Sight:
    tracks, me = view.history, view.history.row(view.av_id)
    positions, headings = tracks.position_m[:, -1], tracks.heading_rad[:, -1]
    position, heading = positions[me], float(headings[me])
    size = tracks.size_m[me, :2]
    corridor = view.av_path_m
    if corridor is None:
        front = position + size[0] / 2 * frames.unit(heading)
        corridor = front + np.array([[0.0], [120.0]]) * frames.unit(heading)
    half = float(size[1]) / 2 + margin_m
    gap, direction = entries(corridor, half, positions, headings, tracks.size_m[:, :2])
    other = ~off_level(view.road, position, float(tracks.z_m[me, -1]), positions, tracks.z_m[:, -1])
    other[me] = False
    speed = tracks.speed_mps[me]
    known = tracks.valid[me, -4:]
    reach = (tracks.speed_mps[:, -1] + speed[-1]) * TIMES_S[-1] + tracks.size_m[:, 0] + 5.0
    rows = np.flatnonzero(other & (np.hypot(*(positions - position).T) < reach)).tolist()
    return _Sight(
        followed=_followed(view, np.where(other, gap, np.inf), direction),
        gap_m=gap[rows],
        direction_rad=direction[rows],
        ids=tuple(tracks.ids[row] for row in rows),
        now=tracks.select(rows),
        road=view.road,
        path=AvPath.through(position[None], np.array([heading]), corridor),
        speed_mps=float(speed[-1]),
        accel_mps2=float(speed[-1] - speed[-4]) / (3 * view.dt_s) if known.all() else 0.0,
        size_m=size,
        dt_s=view.dt_s,
    )


def _followed(view: View, gap_m: Floats, direction_rad: Floats) -> Command | None:
    """As `idm.IdmPlanner` with corridor perception, whose look along the path is used twice."""
    row = int(gap_m.argmin())
    if view.av_path_m is None or not np.isfinite(gap_m[row]):
        return None
    along = frames.unit(float(direction_rad[row]))
    return Command(
        kind="leader",
        gap_m=float(gap_m[row]),
        leader_mps=float(view.history.velocity_mps[row, -1] @ along),
        leader_id=view.history.ids[row],
    )
