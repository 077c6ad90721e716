"""What the commands that do many runs share: their options, and how they end.

`run`, `attack`, `benchmark` and `reproduce` do the same with a list of runs, wherever it is from.
"""

from deepmf_sumo.cli.sweep.ending import end, end_of_runs
from deepmf_sumo.cli.sweep.mapping import map_risk
from deepmf_sumo.cli.sweep.options import Sweep, options
from deepmf_sumo.cli.sweep.plan import execute, plan_options

__all__ = ["Sweep", "end", "end_of_runs", "execute", "map_risk", "options", "plan_options"]
