"""Input of a plan: the present, the opponent, and the future of the unattacked AV."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from deepmf_sumo.deepmf.tracking import Start
from deepmf_sumo.scene import (
    FUTURE_STEPS,
    AgentId,
    AgentKind,
    Bools,
    Floats,
    Forecast,
    Ints,
    Plan,
    Rollout,
    View,
)
from deepmf_sumo.scene.geometry.ground import Ground, clear, ground_of
from deepmf_sumo.scene.road_users import PEOPLE, MotionLimits


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Situation:
    """An opponent and an AV at the moment of a plan.

    Attributes:
        view: the present and the last second.
        opponent_id: the road user that attacks.
        kind: what it is. person: whether that is a pedestrian or a cyclist.
        start: its state now.
        size_m, av_size_m: (2) length and width of the opponent and of the AV.
        limits: on the opponent's accelerations.
        horizon: number of steps of the futures that count: at most those left in the episode.
        levels: heights of the two, if the road passes over itself; else None.
        unattacked: the AV's futures without an attack; None if nothing needs them.
        last: the previous plan, if there is one.
        seen: an earlier episode from the same moment, if there is one.
    """

    view: View
    opponent_id: AgentId
    kind: AgentKind
    person: bool
    start: Start
    size_m: Floats
    av_size_m: Floats
    limits: MotionLimits
    horizon: int
    levels: "Levels | None"
    unattacked: Forecast | None
    last: Plan | None
    seen: Rollout | None = None

    @classmethod
    def of(
        cls,
        view: View,
        opponent_id: AgentId,
        limits: MotionLimits,
        unattacked: Forecast | None = None,
        last: Plan | None = None,
        seen: Rollout | None = None,
    ) -> Self:
        """The situation in a view. Raises KeyError if the opponent or the AV is not in it."""
        kind = view.history.kinds[view.history.row(opponent_id)]
        return cls(
            view=view,
            opponent_id=opponent_id,
            kind=kind,
            person=kind in PEOPLE,
            size_m=footprint(view, opponent_id),
            av_size_m=footprint(view, view.av_id),
            start=Start.of(view, opponent_id),
            limits=limits,
            horizon=min(FUTURE_STEPS, view.steps_left),
            levels=Levels.of(view, opponent_id),
            unattacked=unattacked,
            last=last,
            seen=seen,
        )

    @property
    def on_foot(self) -> bool:
        """Whether the opponent is a pedestrian, who needs no lane."""
        return self.start.motion.body == "point"

    def others(self) -> "OtherAgents":
        """All agents but the two: as in the earlier episode, else at their present velocity."""
        return OtherAgents.of(self.view, {self.view.av_id, self.opponent_id}, self.seen)


def footprint(view: View, agent_id: AgentId) -> Floats:
    """(2) length and width of an agent."""
    return view.history.size_m[view.history.row(agent_id), :2]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OtherAgents:
    """B agents in the F steps from the next one on.

    Attributes:
        position_m: (B, F, 2). heading_rad, valid: (B, F). size_m: (B, 2). z_m: (B) now.
    """

    position_m: Floats
    heading_rad: Floats
    valid: Bools
    size_m: Floats
    z_m: Floats

    @classmethod
    def of(cls, view: View, without: set[AgentId], seen: Rollout | None) -> "OtherAgents":
        """Those in a view; ``seen``: an episode that tells where they drive."""
        now = view.history
        rows = np.array([row for row, name in enumerate(now.ids) if name not in without], int)
        after = view.dt_s * np.arange(1, FUTURE_STEPS + 1)[:, None]
        position = now.position_m[rows, -1, None] + now.velocity_mps[rows, -1, None] * after
        heading = np.repeat(now.heading_rad[rows, -1, None], FUTURE_STEPS, axis=1)
        valid = np.ones(heading.shape, bool)
        if seen is not None:
            tracks = seen.tracks
            steps = slice(view.step + 1, view.step + 1 + FUTURE_STEPS)
            known = max(min(steps.stop, tracks.steps) - steps.start, 0)
            for mine, row in enumerate(rows):
                if now.ids[row] in tracks.ids:
                    theirs = tracks.row(now.ids[row])
                    position[mine, :known] = tracks.position_m[theirs, steps]
                    heading[mine, :known] = tracks.heading_rad[theirs, steps]
                    valid[mine, :known] = tracks.valid[theirs, steps]
        return cls(
            position_m=position,
            heading_rad=heading,
            valid=valid,
            size_m=now.size_m[rows, :2],
            z_m=now.z_m[rows, -1],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Levels:
    """Positions (3) x, y, z of opponent and AV now, on a road that passes over itself."""

    ground: Ground
    opponent: Floats
    av: Floats

    @classmethod
    def of(cls, view: View, opponent_id: AgentId) -> "Levels | None":
        """None if the road never passes over itself: heights are then irrelevant."""
        ground, tracks = ground_of(view.road), view.history
        if not ground.has_levels:
            return None
        rows = [tracks.row(opponent_id), tracks.row(view.av_id)]
        now = np.column_stack([tracks.position_m[rows, -1], tracks.z_m[rows, -1]])
        return cls(ground=ground, opponent=now[0], av=now[1])

    def opponent_z_m(self, futures_m: Floats) -> Floats:
        """(N, F) heights of futures (N, F, 2) of the opponent, which follow the road."""
        return self._along(futures_m, self.opponent)

    def av_z_m(self, futures_m: Floats) -> Floats:
        """(N, F) heights of futures (N, F, 2) of the AV."""
        return self._along(futures_m, self.av)

    def clear(self, own_m: Floats, av_m: Floats, at: tuple[Ints, Ints, Ints]) -> Bools:
        """(K) whether candidates (N, F, 2) and reactions (N, M, F, 2) pass over each other.

        ``at``: K rows, modes and steps.
        """
        row, mode, step = at
        mine, own = np.unique(row, return_inverse=True)
        theirs, other = np.unique(row * av_m.shape[1] + mode, return_inverse=True)
        reactions = av_m[np.divmod(theirs, av_m.shape[1])]
        own_z, other_z = self.opponent_z_m(own_m[mine]), self.av_z_m(reactions)
        return clear(own_z[own, step], other_z[other, step])

    def _along(self, futures_m: Floats, now: Floats) -> Floats:
        start = np.broadcast_to(now[:2], (len(futures_m), 1, 2))
        paths = np.concatenate([start, futures_m], axis=1)
        return self.ground.follow(paths, np.full(len(paths), now[2]))[:, 1:]
