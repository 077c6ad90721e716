"""A world without SUMO: the opponent drives its plan, the AV what it is told, contacts count."""

import numpy as np

from deepmf_sumo.scene.geometry import boxes

from tests.support.one_attacker import plan_of
from tests.support.predictor_doubles import view_of
from tests.support.rollout_doubles import contact_of, rollout_of, straight

NOW = 10
SIZE = np.array([4.8, 2.0])
OPPONENT = (-8.0, 3.5, 0.0, 12.0)


class World:
    """One straight road; ``av_y_m`` is where the AV drives in each episode, the last one on.

    Attributes:
        policies: those of all episodes so far.
    """

    def __init__(self, av_y_m=(0.0,), opponent=OPPONENT, av_steps=91, others=True):
        x, y, heading, speed = opponent
        self._av_y_m = list(av_y_m)
        self._av_steps = av_steps
        self._own = straight(x, y, speed, heading=heading)
        agents = {"av": (0.0, av_y_m[0], 0.0, 10.0)}
        self.view = view_of({**agents, "b": opponent} if others else agents)
        self.policies = []

    def __call__(self, policy):
        av_y = self._av_y_m[min(len(self.policies), len(self._av_y_m) - 1)]
        self.policies.append(policy)
        av = straight(0.0, av_y, 10.0)
        chosen = policy.reset(self.view, np.random.default_rng(0)) if policy else ()
        own, plans = self._own.copy(), []
        if chosen:
            plans = [plan_of(policy, self.view)]
            stop = min(NOW + 1 + len(plans[0].position_m), len(own))
            own[NOW + 1 : stop, :2] = plans[0].position_m[: stop - NOW - 1]
            own[NOW + 1 : stop, 2] = plans[0].heading_rad[: stop - NOW - 1]
        return self._rollout(av, own, next(iter(chosen), None), plans)

    def _rollout(self, av, own, opponent_id, plans):
        end, contacts = self._av_steps, []
        if opponent_id is not None:
            hit = boxes.overlap(av[:, :2], av[:, 2], SIZE, own[:, :2], own[:, 2], SIZE)
            steps = np.flatnonzero(hit[NOW + 1 :])
            if len(steps):
                end = NOW + 2 + int(steps[0])
                contacts = [contact_of(step=end - 1)]
        paths = {"av": av[:end], "b": own[:end]}
        return rollout_of(paths, contacts, opponent_id, plans)


def driven_limits(rollout, dt_s=0.1):
    """Largest acceleration, braking and lateral acceleration of the opponent's last plan."""
    plan = rollout.plans[-1]
    accel = np.diff(plan.speed_mps) / dt_s
    moved = np.diff(plan.position_m, axis=0)
    course = np.unwrap(np.arctan2(moved[:, 1], moved[:, 0]))
    speed = np.hypot(*moved.T) / dt_s
    lateral = np.abs(np.diff(course)) / dt_s * speed[1:]
    return accel.max(), -accel.min(), lateral.max()
