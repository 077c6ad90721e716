"""AVs and moments of a SUMO scenario to attack, chosen by ourselves: no spec needed."""

from deepmf_sumo.moments.moment import Found, Moment, Wish
from deepmf_sumo.moments.search import Request, attack, find, prepare, read

__all__ = ["Found", "Moment", "Request", "Wish", "attack", "find", "prepare", "read"]
