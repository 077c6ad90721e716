"""Attacks in MetaDrive's simulator beside the same attacks in SUMO."""
