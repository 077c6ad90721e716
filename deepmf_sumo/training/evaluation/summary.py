"""What of the figures goes onto the cards of the weights."""

from typing import Any, Final

from deepmf_sumo.training.evaluation.displacement import HORIZONS

_OPPONENT: Final = (
    "scenes", "candidates", "positives", "parked", "auroc", "average_precision",
    "top1_positive", "top3_positive", "partner_top1", "partner_top3", "scenes_with_partner", "ece",
)  # fmt: skip
_MARGINAL: Final = (
    "objects", "min_fde", "min_fde_of_horizon", "min_ade", "miss_rate", "log_likelihood", "ece",
    "overlap_free", "on_road",
)  # fmt: skip
_CONDITIONAL: Final = (
    "objects", "min_fde_marginal", "min_fde_given_true", "min_fde_given_shuffled",
    "log_likelihood_gain_true", "log_likelihood_gain_true_standard_error",
    "log_likelihood_gain_shuffled", "log_likelihood_gain_shuffled_standard_error",
    "min_ade", "miss_rate", "negative_log_likelihood", "ece", "overlap_free", "on_road",
)  # fmt: skip


def compact(found: dict[str, Any]) -> dict[str, Any]:
    """The main figures of each network, of the nested ones that `evaluate` gives."""
    marginal, conditional = found["marginal"], found["conditional"]
    return {
        "data": found["data"],
        "opponent": {key: found["opponent"][key] for key in _OPPONENT},
        "marginal": {"targets": marginal["targets"]}
        | {key: {name: marginal[key][name] for name in _MARGINAL} for key in HORIZONS},
        "conditional": {"targets": conditional["targets"]}
        | {key: {name: conditional[key][name] for name in _CONDITIONAL} for key in HORIZONS},
    }
