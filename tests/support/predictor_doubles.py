"""Predictors without networks, and small worlds: what policies and adversaries are tested with."""

from dataclasses import dataclass, field

import numpy as np

from deepmf_sumo.scene import (
    DT_S,
    FUTURE_STEPS,
    HISTORY_STEPS,
    Forecast,
    Futures,
    Lane,
    OpponentScores,
    RoadMap,
    Tracks,
    View,
)

STEPS = np.arange(1, FUTURE_STEPS + 1) * DT_S


def straight_tracks(
    agents: dict[str, tuple[float, float, float, float]], steps=HISTORY_STEPS, size=(4.8, 2.0)
):
    """Tracks of agents id -> (x, y, heading, speed) at the last step, driven straight to there."""
    rows = np.array(list(agents.values()), float)
    unit = np.stack([np.cos(rows[:, 2]), np.sin(rows[:, 2])], -1)
    back = (np.arange(steps) - steps + 1) * DT_S
    position = rows[:, None, :2] + rows[:, 3, None, None] * back[None, :, None] * unit[:, None]
    count = len(agents)
    return Tracks(
        ids=tuple(agents),
        kinds=("vehicle",) * count,
        size_m=np.tile([*size, 1.5], (count, 1)),
        position_m=position,
        z_m=np.zeros((count, steps)),
        heading_rad=np.tile(rows[:, 2:3], (1, steps)),
        velocity_mps=np.repeat((rows[:, 3:4] * unit)[:, None], steps, 1),
        valid=np.ones((count, steps), bool),
    )


def straight_road(length=300.0, lanes=2, width=3.5):
    points = np.stack([np.linspace(-100.0, length, 81), np.zeros(81)], -1)
    made = {
        str(row): Lane(
            id=str(row),
            kind="street",
            centre_m=points + np.array([0.0, row * width]),
            z_m=np.zeros(81),
            width_m=width,
        )
        for row in range(lanes)
    }
    return RoadMap(lanes=made)


def view_of(agents, step=10, steps_left=80, road=None):
    return View(
        step=step,
        dt_s=DT_S,
        av_id="av",
        history=straight_tracks(agents),
        road=road or straight_road(),
        signals={},
        steps_left=steps_left,
    )


def fan(view, agent_id, modes):
    """(M, 80, 2), (M, 80), (M): constant turn and acceleration, calm ones likelier."""
    row = view.history.row(agent_id)
    position, heading = view.history.position_m[row, -1], view.history.heading_rad[row, -1]
    speed = view.history.speed_mps[row, -1]
    accel = np.array([0.0, -1.0, 1.0, -2.0, 2.0, -3.0, 0.5, -0.5])
    turn = np.array([0.0, 0.01, -0.01, 0.02, -0.02, 0.04, -0.04])
    grid = [(a, k) for a in accel for k in turn]
    grid = sorted(grid, key=lambda cell: abs(cell[0]) + 100 * abs(cell[1]))[:modes]
    a, k = np.array(grid).T[:, :, None]
    going = np.maximum(speed + a * STEPS, 0.0)
    along = np.cumsum(
        (going + np.concatenate([np.full_like(a, speed), going[:, :-1]], 1)) / 2 * DT_S, 1
    )
    course = heading + k * along
    cell = np.where(np.abs(k) < 1e-9, 1e-9, k)
    x = position[0] + (np.sin(heading + cell * along) - np.sin(heading)) / cell
    y = position[1] - (np.cos(heading + cell * along) - np.cos(heading)) / cell
    cost = np.abs(a[:, 0]) + 50 * np.abs(k[:, 0])
    share = np.exp(-cost)
    return np.stack([x, y], -1), np.pi - np.mod(np.pi - course, 2 * np.pi), share / share.sum()


@dataclass
class FanPrediction:
    """A fan for one agent, without condition or with any."""

    view: View
    agent_id: str
    calls: list = field(default_factory=list)

    def modes(self, count):
        self.calls.append((self.agent_id, count))
        position, heading, probability = fan(self.view, self.agent_id, count)
        return Forecast(
            futures=Futures(agent_id=self.agent_id, position_m=position, heading_rad=heading),
            probability=probability,
        )

    def given(self, futures, modes):
        return [self.modes(modes)] * (1 if futures is None else len(futures.position_m))

    def heat(self):
        return None

    def log_density(self, position_m):
        """A mixture of Gaussians round the fan's positions at 2, 4, 6, 8 s."""
        position, _, probability = fan(self.view, self.agent_id, 32)
        offset = position_m[:, None, 19::20] - position[None, :, 19::20]
        spread = np.array([1.0, 2.0, 3.0, 4.0])[:, None]
        log = -((offset / spread) ** 2).sum((-1, -2)) / 2 - 2 * np.log(spread).sum()
        return np.logaddexp.reduce(log + np.log(probability), axis=1)


@dataclass
class FanPredictor:
    """A fan of constant accelerations and curvatures for any agent; also the conditional one."""

    calls: list = field(default_factory=list)

    def predict(self, view, agent_id, *, planner=False):
        return FanPrediction(view, agent_id, self.calls)


@dataclass
class NearestScores:
    """Nearer vehicles score higher; the partner head prefers the farthest."""

    def score(self, view):
        ids = tuple(other for other in view.history.ids if other != view.av_id)
        here = view.history.position_m[view.history.row(view.av_id), -1]
        away = [np.hypot(*(view.history.position_m[view.history.row(i), -1] - here)) for i in ids]
        return OpponentScores(
            ids=ids, logits=-np.array(away) / 10, partner_logits=np.array(away) / 10
        )


@dataclass
class Doubles:
    opponent: NearestScores = field(default_factory=NearestScores)
    marginal: FanPredictor = field(default_factory=FanPredictor)
    conditional: FanPredictor = field(default_factory=FanPredictor)
