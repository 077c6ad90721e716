"""``deepmf-sumo ablate``: variants of networks and attack, each with its quality and its cost."""

from deepmf_sumo.benchmark.ablation.figures import Row
from deepmf_sumo.benchmark.ablation.notes import notes
from deepmf_sumo.benchmark.ablation.plan import Plan, Variant, load
from deepmf_sumo.benchmark.ablation.study import Options, run
from deepmf_sumo.benchmark.ablation.table import cells, headings, write

__all__ = [
    "Options",
    "Plan",
    "Row",
    "Variant",
    "cells",
    "headings",
    "load",
    "notes",
    "run",
    "write",
]
