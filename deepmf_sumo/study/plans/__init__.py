"""What `deepmf-sumo run` runs: specs, and plans of methods x planners x scenes x seeds."""

from deepmf_sumo.study.plans.layout import PlanLayout, read_layout
from deepmf_sumo.study.plans.plan import Loaded, StudyPlan, is_plan, load
from deepmf_sumo.study.plans.run import expected, merge, run, run_specs
from deepmf_sumo.study.sweep.shards import Shard

__all__ = [
    "Loaded",
    "PlanLayout",
    "Shard",
    "StudyPlan",
    "expected",
    "is_plan",
    "load",
    "merge",
    "read_layout",
    "run",
    "run_specs",
]
