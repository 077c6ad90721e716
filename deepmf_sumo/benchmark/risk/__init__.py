"""Where on a SUMO network the AV is in danger, and what changes from one result to another.

::

    OUT/runs --attacks--> attacks, each with its place --table--> a row a place, the worst first
                            places: lanes, edges, junctions, movements     shrinkage: thin data
"""

from deepmf_sumo.benchmark.risk.attacks import Attacked, Network, read
from deepmf_sumo.benchmark.risk.conflicts import Conflict, conflicts
from deepmf_sumo.benchmark.risk.table import Row, columns, rows, worst

__all__ = [
    "Attacked",
    "Conflict",
    "Network",
    "Row",
    "columns",
    "conflicts",
    "read",
    "rows",
    "worst",
]
