"""``deepmf-sumo benchmark``: methods x planners x scenes x seeds, and their tables."""

from deepmf_sumo.plans.layout import Layout, read_layout
from deepmf_sumo.plans.plan import Loaded, Plan, load
from deepmf_sumo.plans.run import expected, merge, run
from deepmf_sumo.sweep.shards import Shard

__all__ = ["Layout", "Loaded", "Plan", "Shard", "expected", "load", "merge", "read_layout", "run"]
