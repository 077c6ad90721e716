"""Where tasks are done: in processes of this machine, or on the machines of a Ray cluster."""

from deepmf_sumo.benchmark.executors.base import Executor, Limits, Work
from deepmf_sumo.benchmark.executors.choice import chosen

__all__ = ["Executor", "Limits", "Work", "chosen"]
