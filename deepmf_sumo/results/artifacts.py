"""``plans.npz`` of a run; what a run left as a Rollout; and a Rollout as a scene."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo import files
from deepmf_sumo.avoidability.encounter import Expected, likeliest_motion
from deepmf_sumo.datatypes import (
    DT_S,
    Contact,
    OpponentScores,
    Plan,
    PlanReason,
    Rollout,
)
from deepmf_sumo.results import signals, stored, tracks
from deepmf_sumo.results.tracks import read_tracks

PLANS: Final = "plans.npz"


def write_plans(path: Path, rollout: Rollout) -> None:
    """All plans and their reasons, ``<number>/<field>``; see `datatypes.plan` for the shapes."""
    arrays: dict[str, NDArray[Any]] = {"plans": np.array(len(rollout.plans))}
    for number, plan in enumerate(rollout.plans):
        fields = {**_plan(plan), **(_reason(plan.reason) if plan.reason else {})}
        arrays.update({f"{number:02d}/{name}": array for name, array in fields.items()})
    files.write(path, files.npz(arrays))


def read_rollout(folder: Path, contacts: Sequence[Contact], ended: str) -> Rollout:
    """The rollout of a run; velocities lie along the headings, plans are without reasons.

    Raises `stored.DAMAGE`.
    """
    found = read_tracks(folder / tracks.FILE)
    steps = found.tracks.steps
    return Rollout(
        tracks=found.tracks,
        driver=found.driver,
        now=found.now,
        dt_s=DT_S,
        av_id=found.av_id,
        opponent_id=found.opponent_id,
        contacts=tuple(contacts),
        events=(),
        plans=_read_plans(folder / PLANS),
        ended=ended,
        signals=signals.read_signals(folder / signals.FILE, found.now, steps),
    )


def read_scores(folder: Path) -> OpponentScores | None:
    """The scores that the first plan rests on; None where the opponent was given."""
    with stored.arrays(folder / PLANS) as arrays:
        if "00/score_ids" not in arrays:
            return None
        return OpponentScores(
            ids=tuple(arrays["00/score_ids"].tolist()),
            logits=arrays["00/score_logits"],
            partner_logits=arrays["00/score_partner_logits"],
        )


def read_likeliest(folder: Path) -> Expected | None:
    """Where the opponent would have been by the first plan; None where it has no candidates."""
    with stored.arrays(folder / PLANS) as arrays:
        if "00/candidate_position_m" not in arrays:
            return None
        position = arrays["00/candidate_position_m"].astype(float)
        origin = (
            arrays["00/candidate_origin"].tolist()
            if "00/candidate_origin" in arrays
            else ["mode"] * len(position)
        )
        return likeliest_motion(int(arrays["00/first_step"]), position, origin)


def _plan(plan: Plan) -> dict[str, NDArray[Any]]:
    return {
        "agent_id": np.array(plan.agent_id),
        "first_step": np.array(plan.first_step),
        "position_m": plan.position_m,
        "heading_rad": plan.heading_rad,
        "speed_mps": plan.speed_mps,
    }


def _reason(reason: PlanReason) -> dict[str, NDArray[Any]]:
    """Positions in single precision: a tenth of a millimetre is enough to draw them."""
    reactions = reason.reactions
    arrays = {
        "rule": np.array(reason.rule),
        "chosen": np.array(reason.chosen),
        "candidate_position_m": reason.candidates.futures.position_m.astype("float32"),
        "candidate_heading_rad": reason.candidates.futures.heading_rad.astype("float32"),
        "candidate_probability": reason.candidates.probability,
        "collides": reason.collides,
        "collision_step": reason.collision_step,
        "value": reason.value,
        "product": reason.product,
        "bent_m": reason.bent_m,
    }
    if reason.origin:
        arrays["candidate_origin"] = np.array(reason.origin)
    if reason.wanted_sector is not None and reason.sector is not None:
        arrays["wanted_sector"] = np.array(reason.wanted_sector)
        arrays["sector"] = reason.sector
    for name, allowed in reason.allowed.items():
        if allowed.ndim == 1:
            arrays[f"candidate_{name}"] = allowed
    if reason.unmet:
        arrays["unmet"] = np.array(reason.unmet)
    if reactions:
        positions = np.stack([one.futures.position_m for one in reactions])
        arrays["reaction_position_m"] = positions.astype("float32")
        arrays["reaction_probability"] = np.stack([one.probability for one in reactions])
    if reason.heat:
        arrays["heat_position_m"] = reason.heat.position_m.astype("float32")
        arrays["heat_probability"] = reason.heat.probability.astype("float32")
    if reason.scores:
        arrays["score_ids"] = np.array(reason.scores.ids, dtype=str)
        arrays["score_logits"] = reason.scores.logits
        arrays["score_partner_logits"] = reason.scores.partner_logits
    return arrays


def _read_plans(file: Path) -> tuple[Plan, ...]:
    with stored.arrays(file) as arrays:
        return tuple(
            Plan(
                agent_id=str(arrays[f"{number:02d}/agent_id"]),
                first_step=int(arrays[f"{number:02d}/first_step"]),
                position_m=arrays[f"{number:02d}/position_m"],
                heading_rad=arrays[f"{number:02d}/heading_rad"],
                speed_mps=arrays[f"{number:02d}/speed_mps"],
            )
            for number in range(int(arrays["plans"]))
        )
