"""Attacks in a running simulation of another program: as a client of its port, or in its script."""

from deepmf_sumo.live.attacker import Attached, Attacker, Wish, attach

__all__ = ["Attached", "Attacker", "Wish", "attach"]
