"""Rollout -> MetricValue. One subject a file, named as the metric.

Each module exposes ``UNIT``, ``BETTER`` (for the attacker) and ``measure(rollout, case)``.
"""
