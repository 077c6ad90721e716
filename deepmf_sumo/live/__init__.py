"""Attacks in somebody else's running simulation: as a client of its port, or in its script."""

from deepmf_sumo.live.attacker import Attached, Attacker, Wish, attach

__all__ = ["Attached", "Attacker", "Wish", "attach"]
