"""A result folder as a gate of continuous integration: thresholds, a baseline, and a verdict.

::

    OUT --frame--> numbers a run --limits--> judgements ---+
                                --comparison--> changes --+--verdict--> exit code, JUnit, Markdown
"""

from deepmf_sumo.gate.same_attacks import SameAttacks, repeated
from deepmf_sumo.gate.thresholds import Thresholds, load
from deepmf_sumo.gate.verdict import Verdict, check
from deepmf_sumo.results.run_sets import read

__all__ = ["SameAttacks", "Thresholds", "Verdict", "check", "load", "read", "repeated"]
