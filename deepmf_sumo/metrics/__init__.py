"""Rollout -> MetricValue. One subject a file, named as the metric.

Each module exposes ``UNIT``, ``BETTER`` (for the attacker), ``DEFINITION`` (one sentence, printed
with results) and ``measure(rollout, case)``.
"""
