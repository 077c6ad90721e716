"""``deepmf-sumo ablate``: variants of networks and attack, each with its quality and its cost."""

from deepmf_sumo.ablation.plan import Plan, Variant, load
from deepmf_sumo.ablation.study import Options, run
from deepmf_sumo.ablation.table import Row, cells, headings, notes, write

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
