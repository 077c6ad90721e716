"""What several metrics read from a rollout: who drove when, motion, conflicts, the road."""
