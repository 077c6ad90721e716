"""Where on a SUMO network the AV is in danger, and what changes from one result to another.

::

    OUT/runs --attacks--> attacks, each with its place --table--> one row per place, the worst first
                            places: lanes, edges, junctions, movements
"""

from deepmf_sumo.results.risk.attacks import (
    ATTACKED,
    Attacked,
    Network,
    PlacePair,
    attack_rows,
    conflicts,
    read,
)
from deepmf_sumo.results.risk.coverage import EvidenceCell, coverage
from deepmf_sumo.results.risk.kinds import by_type
from deepmf_sumo.results.risk.table import PlaceRow, columns, rows, worst

__all__ = [
    "ATTACKED",
    "Attacked",
    "EvidenceCell",
    "Network",
    "PlacePair",
    "PlaceRow",
    "attack_rows",
    "by_type",
    "columns",
    "conflicts",
    "coverage",
    "read",
    "rows",
    "worst",
]
