"""Variants of networks and attack, each with its quality and its cost."""

from studies.ablation.plan import Plan, Variant, load
from studies.ablation.study import Options, run
from studies.ablation.table import READABLE, Row, notes, write

__all__ = [
    "READABLE",
    "Options",
    "Plan",
    "Row",
    "Variant",
    "load",
    "notes",
    "run",
    "write",
]
