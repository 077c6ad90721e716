"""``deepmf-sumo benchmark``: methods x planners x scenes x seeds, and their tables."""

from deepmf_sumo.benchmark.shards import Shard
from deepmf_sumo.benchmark.study.layout import Layout
from deepmf_sumo.benchmark.study.layout import read as read_layout
from deepmf_sumo.benchmark.study.merge import merge
from deepmf_sumo.benchmark.study.plan import Loaded, Plan, load
from deepmf_sumo.benchmark.study.run import expected, run

__all__ = ["Layout", "Loaded", "Plan", "Shard", "expected", "load", "merge", "read_layout", "run"]
