"""Rollout -> MetricValue. One subject a file; each module exposes `NAME` and `measure`."""
