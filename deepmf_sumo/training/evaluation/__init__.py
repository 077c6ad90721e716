"""``deepmf-sumo evaluate``: how good a set of weights is on recordings it was not trained on."""

from deepmf_sumo.training.evaluation.recordings import MODES, evaluate, run
from deepmf_sumo.training.evaluation.table import Evaluation, Figure

__all__ = ["MODES", "Evaluation", "Figure", "evaluate", "run"]
