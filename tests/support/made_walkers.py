"""Made people put by hand, and policies that walk them onto the road."""

import numpy as np

from deepmf_sumo.scene import MadeRoadUser, Plan


def standing(place_m, name="made_pedestrian_1", heading_rad=np.pi / 2, **more):
    """Somebody who stands at the kerb."""
    return MadeRoadUser(
        id=name,
        road_user="pedestrian",
        position_m=np.array(place_m, float),
        heading_rad=heading_rad,
        place="kerb",
        **more,
    )


class StepsOut:
    """A person walks ``far_m`` in a direction at 1.4 m/s, and stands there until the plan ends.

    It gets to that speed as its model allows, 1.6 m/s2. ``for_s``: length of the plan; None: it
    ends where the walk ends.
    """

    period_steps = None

    def __init__(self, name="made_pedestrian_1", heading_rad=np.pi / 2, far_m=3.5, for_s=None):
        self.name, self.heading_rad = name, heading_rad
        self.far_m, self.for_s = far_m, for_s

    def reset(self, view, rng):
        """The person alone attacks."""
        return (self.name,)

    def plan(self, view):
        """Its walk."""
        at = view.history.position_m[view.history.row(self.name), -1]
        seconds = np.arange(1, 120) * 0.1
        speed = np.minimum(1.6 * seconds, 1.4)
        gone = np.cumsum((np.concatenate([[0.0], speed[:-1]]) + speed) / 2 * 0.1)
        kept = gone <= self.far_m if self.for_s is None else seconds <= self.for_s + 1e-9
        speed = np.where(gone <= self.far_m, speed, 0.0)
        gone = np.minimum(gone, self.far_m)
        ahead = np.array([np.cos(self.heading_rad), np.sin(self.heading_rad)])
        return {
            self.name: Plan(
                agent_id=self.name,
                first_step=view.step + 1,
                position_m=at + gone[kept, None] * ahead,
                heading_rad=np.full(kept.sum(), self.heading_rad),
                speed_mps=speed[kept],
            )
        }
