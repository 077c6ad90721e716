"""AVs and moments of a SUMO scenario to attack, chosen by ourselves: no spec needed."""

from deepmf_sumo.benchmark.moments.asked import check, names_of, read
from deepmf_sumo.benchmark.moments.finding import find
from deepmf_sumo.benchmark.moments.moment import Found, Moment, Wish
from deepmf_sumo.benchmark.moments.plan import attack, base_spec

__all__ = ["Found", "Moment", "Wish", "attack", "base_spec", "check", "find", "names_of", "read"]
