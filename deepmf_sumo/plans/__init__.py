"""What `deepmf-sumo run` runs: specs, and plans of methods x planners x scenes x seeds."""

from deepmf_sumo.plans.layout import Layout, read_layout
from deepmf_sumo.plans.plan import Loaded, Plan, is_plan, load
from deepmf_sumo.plans.run import expected, merge, run, run_specs
from deepmf_sumo.sweep.shards import Shard

__all__ = [
    "Layout",
    "Loaded",
    "Plan",
    "Shard",
    "expected",
    "is_plan",
    "load",
    "merge",
    "read_layout",
    "run",
    "run_specs",
]
