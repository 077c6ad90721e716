"""Why the attack drove as it did: the candidates of each plan, and how the AV was to react."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo.benchmark import stored
from deepmf_sumo.datatypes import Floats
from deepmf_sumo.report.page.packing import steady

EVERY_STEPS: Final = 4
UNIT_M: Final = 0.1
MOST_A_RUN: Final = 160
"""Candidates of all plans of a run that are kept: so the page stays small."""
FEWEST_A_PLAN, MOST_A_PLAN = 6, 64
_Arrays = Mapping[str, NDArray[Any]]


def reasons(file: Path, origin: Floats) -> list[dict[str, Any]]:
    """The plans in a ``plans.npz``, positions relative to ``origin`` (2,).

    Of each plan the chosen candidate and those of highest value are kept, at most `MOST_A_PLAN`
    (fewer where there are many plans); ``of`` says how many there were. Of the reactions all modes
    to the chosen candidate are kept, and the likeliest one to each other.
    """
    with stored.arrays(file) as arrays:
        plans = int(arrays["plans"])
        most = int(np.clip(MOST_A_RUN // max(plans, 1), FEWEST_A_PLAN, MOST_A_PLAN))
        return [_plan(_of(arrays, number), most, origin) for number in range(plans)]


def _of(arrays: Any, number: int) -> _Arrays:
    head = f"{number:02d}/"
    return {name.removeprefix(head): arrays[name] for name in arrays if name.startswith(head)}


def _plan(arrays: _Arrays, most: int, origin: Floats) -> dict[str, Any]:
    plan: dict[str, Any] = {
        "agent": str(arrays["agent_id"]),
        "step": int(arrays["first_step"]),
        "path": _path(arrays["position_m"], origin),
    }
    if "rule" not in arrays:
        return plan
    kept = _best(arrays, most)
    plan |= {
        "rule": str(arrays["rule"]),
        "of": len(arrays["candidate_probability"]),
        "chosen": int(np.flatnonzero(kept == int(arrays["chosen"]))[0]),
        "unmet": arrays["unmet"].tolist() if "unmet" in arrays else [],
        "candidates": [_candidate(arrays, int(number), origin) for number in kept],
    }
    if "score_ids" in arrays:
        chance = 1.0 / (1.0 + np.exp(-arrays["score_logits"]))
        ids = arrays["score_ids"].tolist()
        plan["scores"] = dict(zip(ids, np.round(chance, 3).tolist(), strict=True))
    return plan


def _best(arrays: _Arrays, most: int) -> NDArray[Any]:
    """Numbers of the candidates that are kept, in their order: the chosen one, the best others."""
    value, chosen = arrays["value"], int(arrays["chosen"])
    order = np.lexsort((-arrays["candidate_probability"], -value))
    order = order[order != chosen][: most - 1]
    return np.sort(np.append(order, chosen))


def _candidate(arrays: _Arrays, number: int, origin: Floats) -> dict[str, Any]:
    candidate: dict[str, Any] = {
        "number": number,
        "path": _path(arrays["candidate_position_m"][number], origin),
        "p": _digits(arrays["candidate_probability"][number]),
        "value": _digits(arrays["value"][number]),
        "reactions": [],
    }
    if "candidate_origin" in arrays:
        candidate["origin"] = str(arrays["candidate_origin"][number])
    if "reaction_position_m" in arrays:
        chance = arrays["reaction_probability"][number]
        hits = arrays["collides"][number]
        candidate["hit"] = round(float((chance * hits).sum()), 4)
        modes = range(len(chance)) if number == int(arrays["chosen"]) else [int(chance.argmax())]
        candidate["reactions"] = [
            {
                "path": _path(arrays["reaction_position_m"][number, mode], origin),
                "p": round(float(chance[mode]), 3),
                "hits": bool(hits[mode]),
            }
            for mode in modes
        ]
    return candidate


def _digits(value: Any) -> float:
    """Three digits: products of probabilities are small."""
    return float(f"{float(value):.3g}")


def _path(position_m: NDArray[Any], origin: Floats) -> list[list[int]]:
    """Coordinates x and y every `EVERY_STEPS` steps, from the first one."""
    x, y = (np.asarray(position_m[::EVERY_STEPS], float) - origin).T
    return [steady(x, UNIT_M), steady(y, UNIT_M)]
