"""Attacks in a running simulation of another program: as a client of its port, or in its script."""

from deepmf_sumo.live.attacker import Attached, Attacker, Wish, attach, prepare
from deepmf_sumo.live.server import Server

__all__ = ["Attached", "Attacker", "Server", "Wish", "attach", "prepare"]
