"""A SUMO network and a guideline of traffic engineers -> what is wrong with it, before it is run.

::

    .net.xml, .sumocfg --roads--> Roads --signals, right_of_way, alignment--> cases
                                    with a Guideline                            |
                                 findings, one per rule and junction  <--screen-+
"""

from deepmf_sumo.roadcheck.screening.alignment import overlaps
from deepmf_sumo.roadcheck.screening.findings import (
    COLUMNS,
    SEVERITIES,
    Finding,
    Severity,
    at_least,
)
from deepmf_sumo.roadcheck.screening.guidelines import GUIDELINES, Guideline
from deepmf_sumo.roadcheck.screening.screen import BESIDE, Screened, beside, columns, screen

__all__ = [
    "BESIDE",
    "COLUMNS",
    "GUIDELINES",
    "SEVERITIES",
    "Finding",
    "Guideline",
    "Screened",
    "Severity",
    "at_least",
    "beside",
    "columns",
    "overlaps",
    "screen",
]
