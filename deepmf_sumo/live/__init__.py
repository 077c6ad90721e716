"""Attacks in a running simulation of another program: as a client of its port, or in its script."""

from deepmf_sumo.live.attacker import Attached, Attacker, Wish, attach, prepare
from deepmf_sumo.live.server import Server
from deepmf_sumo.live.status import StatusServer

__all__ = ["Attached", "Attacker", "Server", "StatusServer", "Wish", "attach", "prepare"]
