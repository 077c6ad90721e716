"""Case + planner + policy -> Rollout, over SUMO. SUMO's own conventions exist here alone."""
