"""``deepmf-sumo evaluate``: how good a set of weights is on recordings it was not trained on."""

from deepmf_sumo.training.evaluation.recordings import MODES, evaluate, run

__all__ = ["MODES", "evaluate", "run"]
