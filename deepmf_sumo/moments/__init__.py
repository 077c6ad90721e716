"""AVs and moments of a SUMO scenario to attack, chosen by ourselves: no spec needed."""

from deepmf_sumo.moments.moment import Found, Moment, Wish
from deepmf_sumo.moments.search import attack, base_spec, check, find, names_of, read

__all__ = ["Found", "Moment", "Wish", "attack", "base_spec", "check", "find", "names_of", "read"]
