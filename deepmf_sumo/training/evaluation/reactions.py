"""AVs that were attacked in simulation: reactive prediction against blind."""

from typing import Any, Final

from deepmf_sumo.training.evaluation.conditions import MARGINAL, NOTHING, TRUE, Observed
from deepmf_sumo.training.evaluation.estimates import difference, mean, standard_error
from deepmf_sumo.training.evaluation.forecast_modes import FEW

SECONDS: Final = ("1.0", "2.0", "3.0")
_SHOWN: Final = {"most_probable": 1, f"best_of_{FEW}": FEW}


def summary(attacked: Observed) -> dict[str, Any]:
    """Error of the AV's most probable mode and of the best of six, at 1, 2, 3 s.

    Given the opponent's true future (reactive), given nothing (blind), and by the marginal network;
    the gain is blind minus reactive.
    """
    found: dict[str, Any] = {}
    for key in SECONDS:
        found[key] = {"objects": len(attacked.fde[TRUE, FEW, key])}
        for label, modes in _SHOWN.items():
            reactive, blind = attacked.fde[TRUE, modes, key], attacked.fde[NOTHING, modes, key]
            gain, gain_error = difference(blind, reactive)
            found[key][label] = {
                "reactive": mean(reactive),
                "reactive_standard_error": standard_error(reactive),
                "blind": mean(blind),
                "blind_standard_error": standard_error(blind),
                "marginal": mean(attacked.fde[MARGINAL, modes, key]),
                "gain": gain,
                "gain_standard_error": gain_error,
            }
    return found
