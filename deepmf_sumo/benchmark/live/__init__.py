"""Attacks in somebody else's running simulation: as a client of its port, or in its script."""

from deepmf_sumo.benchmark.live.assembly import Wish
from deepmf_sumo.benchmark.live.attaching import Attached, attach
from deepmf_sumo.benchmark.live.attacker import Attacker

__all__ = ["Attached", "Attacker", "Wish", "attach"]
