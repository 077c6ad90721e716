"""What drives an opponent once its plan is over, for tests without a world."""

from dataclasses import dataclass


@dataclass
class Owner:
    """Takes every agent, or none; see `sumo.simulation.ownership.NextOwner`."""

    taking: bool = True
    creep: float = 0.0
    free: bool = True

    def creep_mps(self, agent):
        return self.creep

    def takes(self, agent, step, pose):
        return self.taking

    def clear(self, agent, poses):
        return self.free

    def lane_cost(self, agent, lane_id):
        return 0.0

    def walk(self, agent, pose):
        return None

    def refusals(self, agents):
        return {}
