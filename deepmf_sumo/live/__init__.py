"""Attacks in a simulation that somebody else runs, step by step, and leaves as it was."""
