"""Rollout -> other people's formats."""
