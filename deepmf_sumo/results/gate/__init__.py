"""A result folder as a gate of continuous integration: thresholds, a baseline, and a verdict.

::

    OUT --frame--> numbers a run --thresholds--> judgements, changes --verdict--> exit code, JUnit,
                                                                                  Markdown
"""

from deepmf_sumo.results.gate.own_hits import SameAttacks
from deepmf_sumo.results.gate.thresholds import Thresholds, load
from deepmf_sumo.results.gate.verdict import GateVerdict, check
from deepmf_sumo.results.run_sets import read

__all__ = ["GateVerdict", "SameAttacks", "Thresholds", "check", "load", "read"]
