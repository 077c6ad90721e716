"""Case + planner + policy -> Rollout: the loop over SUMO."""

from deepmf_sumo.sumo.simulation.episode import plain, simulate
from deepmf_sumo.sumo.simulation.sumo_config import hold, network_case, release

__all__ = ["hold", "network_case", "plain", "release", "simulate"]
