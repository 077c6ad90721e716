"""Case + planner + policy -> Rollout: the loop over SUMO."""

from deepmf_sumo.simulation.cases import network_case
from deepmf_sumo.simulation.loop import simulate

__all__ = ["network_case", "simulate"]
