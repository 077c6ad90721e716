"""KING: the opponent's controls, changed along the gradient through kinematics and the AV's answer.

Source: Hanselmann et al., KING: Generating Safety-Critical Driving Scenarios for Robust Imitation
via Kinematics Gradients, ECCV 2022. There a bicycle model moves up to four vehicles, an objective
is their distance to the AV with terms for the road and, of several attackers, for each other, and
Adam (rate 0.005, 150 iterations) changes their acceleration and steering at each step; it stops at
a collision.

From the source: the bicycle, Adam and its rate, the number of iterations, controls that are free at
each time step, and the stop at the first collision. Ours: the AV that the gradient runs through is
a differentiable IDM on the path of the AV's earlier rollout (the source has networks and a rule of
its own in CARLA), controls are changes of the opponent's unattacked ones at 5 Hz (4 Hz there), the
objective is the least distance of three circles a vehicle (the mean one of the boxes' edges there)
with weights of our own, a term keeps the opponent off all other vehicles, the road is that of the
lanes (a picture there), and one vehicle attacks, since the loop drives one.

Budget: gradient steps; and two simulations, one unattacked and the attack. With more, every further
round aims at the AV's rollout of the round before, until it is hit.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from pydantic import Field

from deepmf_sumo.attacks._episodes import (
    AgentMotion,
    OpponentChoice,
    Scouted,
    deadline,
    limited,
    motion_of,
    plan_of,
)
from deepmf_sumo.attacks.base import Simulate
from deepmf_sumo.baselines import _open_loop as open_loop
from deepmf_sumo.baselines._open_loop import Aimed, AimedSettings, attack_in_rounds
from deepmf_sumo.deepmf.situation import footprint
from deepmf_sumo.deepmf.tracking import Start, track
from deepmf_sumo.scene import DT_S, Attack, Budget, Case, Floats, Ints, RoadMap
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.road import lanes_for_cars

if TYPE_CHECKING:
    from deepmf_sumo.baselines._king_descent import Around, KingOpponent

FORESIGHT = "the un-attacked motion of all road users, where it begins"
_ROAD_M: Final = 120.0
_GONE_M: Final = 1e4
_FAR_M: Final = 60.0
"""Other road users that are never as near to the opponent's unattacked path have no cost."""


class Settings(AimedSettings):
    """The descent.

    Attributes:
        rate, iterations: of Adam, as published.
        accel_change_mps2, curvature_change_per_m: changes of the unattacked controls that a
            control of 1 stands for; controls are kept within [-1, 1].
        off_road, others: metres of distance to the AV that a metre beyond the road, and a metre
            too near to another road user, are worth.
        seconds: time limit if the budget has none; null: no limit. With a limit the result depends
            on the machine.
    """

    rate: float = Field(default=0.005, gt=0.0)
    iterations: int = Field(default=150, ge=1)
    accel_change_mps2: float = Field(default=8.0, gt=0.0)
    curvature_change_per_m: float = Field(default=0.1, gt=0.0)
    off_road: float = Field(default=1.0, ge=0.0)
    others: float = Field(default=1.0, ge=0.0)
    seconds: float | None = Field(default=None, gt=0.0)


class KING:
    """Attacks by gradients through kinematics."""

    several = True

    def __init__(self, settings: Settings, weights: str) -> None:
        self._settings = settings
        self._opponent = OpponentChoice(settings.opponent, weights)

    def load(self) -> None:
        """Load torch and the network that chooses opponents."""
        from deepmf_sumo.deepmf.networks.weights import need

        need("torch", "The adversary king, which follows gradients,")
        from deepmf_sumo.baselines import _king_descent  # noqa: F401

        self._opponent.load()

    def attack(
        self,
        case: Case,
        simulate: Simulate,
        budget: Budget,
        rng: np.random.Generator,
    ) -> Attack:
        """The attack; trials are the rounds."""
        chosen = self._settings
        self.load()  # before the time counts
        budget = limited(budget, 1 + chosen.rounds, chosen.seconds)
        until = deadline(budget)

        def aim(scouted: Scouted, rollouts: Sequence[AgentMotion]) -> Aimed:
            return self._aim(scouted, rollouts[-1], until)

        return attack_in_rounds(case, simulate, self._opponent.of(case), aim, chosen.rounds, budget)

    def _aim(self, scouted: Scouted, av: AgentMotion, until: float) -> Aimed:
        """The descent, tracked within the limits."""
        from deepmf_sumo.baselines import _king_descent as king

        chosen, view = self._settings, scouted.view
        start = Start.of(view, scouted.opponent_id)
        bounds = king.OpponentBounds(
            accel_change_mps2=chosen.accel_change_mps2,
            curvature_change_per_m=chosen.curvature_change_per_m,
            accel_mps2=chosen.accel_mps2,
            brake_mps2=chosen.brake_mps2,
            lateral_mps2=chosen.lateral_mps2,
        )
        terms = king.CostTerms(off_road=chosen.off_road, others=chosen.others)
        found = king.descend(
            _opponent(scouted, start), _around(scouted, av, start), bounds, terms, chosen.rate,
            chosen.iterations, until,
        )  # fmt: skip
        reference = _every_step(start, found.position_m, len(av.valid))
        tracked = track(reference[None], start, chosen.limits.rows(1))
        gap = open_loop.gaps(scouted, av, tracked.position_m, tracked.heading_rad).min()
        return Aimed(
            plan=plan_of(view, scouted.opponent_id, tracked, 0),
            parameters={
                "iterations": float(found.iterations),
                "stand_in_gap_m": float(found.gap_m),
                "predicted_gap_m": float(gap),
            },
        )


def _every_step(start: Start, position_m: Floats, steps: int) -> Floats:
    """(K, 2) positions at all steps of positions (N, 2) at every second one."""
    from deepmf_sumo.baselines._king_descent import EVERY

    known = np.arange(len(position_m) + 1) * EVERY
    points = np.concatenate([start.position_m[None], position_m])
    wanted = np.arange(1, steps + 1)
    return np.stack([np.interp(wanted, known, points[:, axis]) for axis in (0, 1)], -1)


def _opponent(scouted: Scouted, start: Start) -> "KingOpponent":
    """The opponent and the controls of its unattacked motion."""
    from deepmf_sumo.baselines._king_descent import EVERY, KingOpponent

    path = open_loop.continued(scouted.reference, start)
    heading = np.unwrap(np.concatenate([[start.heading_rad], open_loop.headings(path, start)]))
    at = np.arange(0, len(path) + 1, EVERY)
    points = np.concatenate([start.position_m[None], path])[at]
    way = np.hypot(*np.diff(points, axis=0).T)
    mean = way / (EVERY * DT_S)
    speed = np.concatenate([[start.speed_mps], (mean[:-1] + mean[1:]) / 2, mean[-1:]])
    turned = np.diff(heading[at])
    return KingOpponent(
        position_m=start.position_m,
        heading_rad=start.heading_rad,
        speed_mps=start.speed_mps,
        size_m=footprint(scouted.view, scouted.opponent_id),
        accel_mps2=np.diff(speed) / (EVERY * DT_S),
        curvature_per_m=np.where(way > 0.1, turned / np.maximum(way, 0.1), 0.0),
    )


def _around(scouted: Scouted, av: AgentMotion, start: Start) -> "Around":
    """The AV, other road users and the road, at the times that are compared."""
    from deepmf_sumo.baselines._king_descent import EVERY, Around

    view = scouted.view
    at = np.arange(EVERY - 1, len(av.valid), EVERY)
    av_start = Start.of(view, view.av_id)
    others, reach = _others(scouted, at, open_loop.continued(scouted.reference, start))
    road, road_reach = _road(view.road, start)
    return Around(
        av_start_m=av_start.position_m,
        av_start_mps=av_start.speed_mps,
        av_m=av.position_m[at],
        av_mps=av.speed_mps[at],
        av_there=av.valid[at],
        av_size_m=footprint(view, view.av_id),
        others_m=others,
        others_reach_m=reach,
        road_m=road,
        road_reach_m=road_reach,
    )


def _others(scouted: Scouted, at: Ints, own_m: Floats) -> tuple[Floats, Floats]:
    """(B, N, 2) and (B) half widths of other road users, as they drove without the attack."""
    rollout, found, reach = scouted.rollout, [], []
    for row, name in enumerate(rollout.tracks.ids):
        if name in {scouted.opponent_id, rollout.av_id}:
            continue
        motion = motion_of(rollout, name, len(own_m))
        place = np.where(motion.valid[:, None], motion.position_m, _GONE_M)
        if np.hypot(*(place - own_m).T).min() < _FAR_M:
            found.append(place[at])
            reach.append(rollout.tracks.size_m[row, 1] / 2)
    return np.array(found).reshape(len(found), len(at), 2), np.array(reach)


def _road(road: RoadMap, start: Start) -> tuple[Floats, Floats]:
    """(M, 2) points along the lanes around the opponent, (M) half widths; none off every lane."""
    lanes = lanes_for_cars(road)
    ahead = start.position_m + _ROAD_M / 2 * frames.unit(start.heading_rad)
    rows = lanes.around(ahead, _ROAD_M)
    length = np.hypot(*lanes.vector_m[rows].T)
    parts = np.maximum(np.ceil(length / 2.0).astype(int), 1)
    segment = np.repeat(rows, parts)
    first = np.cumsum(parts) - parts
    share = (np.arange(len(segment)) - np.repeat(first, parts) + 0.5) / np.repeat(parts, parts)
    points = lanes.start_m[segment] + share[:, None] * lanes.vector_m[segment]
    return points, lanes.reach_m[lanes.lane[segment]]


def build(settings: Settings, weights: str) -> KING:
    """The adversary; ``weights`` hold the network that chooses the opponent."""
    return KING(settings, weights)
