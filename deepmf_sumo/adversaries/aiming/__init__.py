"""Trajectories aimed at where the AV was in its last rollouts, and driven open loop."""
