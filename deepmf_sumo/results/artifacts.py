"""``plans.npz`` and ``unattacked.npz`` of a run, and what a run left as a Rollout."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, cast, get_args

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo import files
from deepmf_sumo.judge.avoidability.counterfactual import By, Counterfactual, likeliest, predicted
from deepmf_sumo.results import signals, stored, tracks
from deepmf_sumo.results.tracks import read_tracks
from deepmf_sumo.results.turns import counterfactual_of
from deepmf_sumo.scene import (
    DT_S,
    Case,
    Contact,
    OpponentScores,
    Plan,
    PlanReason,
    Rollout,
)

PLANS: Final = "plans.npz"
UNATTACKED: Final = "unattacked.npz"


def write_plans(path: Path, rollout: Rollout) -> None:
    """All plans and their reasons, ``<number>/<field>``; see `scene.plan` for the shapes."""
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
        attackers=found.attackers,
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


def write_unattacked(folder: Path, rollout: Rollout, case: Case) -> None:
    """Where the opponent would have been without the attack, to the bit, as it was judged.

    No file where no vehicle attacked.
    """
    alone = counterfactual_of(rollout, case)
    if alone is None:
        return
    arrays: dict[str, NDArray[Any]] = {
        "agent_id": np.array(rollout.opponent_id),
        "by": np.array(alone.by),
        "position_m": alone.position_m,
        "known": alone.known,
    }
    files.write(folder / UNATTACKED, files.npz(arrays))


def read_unattacked(folder: Path) -> Counterfactual | None:
    """What `write_unattacked` wrote; None in folders of earlier versions, which lack it."""
    if not (folder / UNATTACKED).is_file():
        return None
    with stored.arrays(folder / UNATTACKED) as arrays:
        by, position, known = str(arrays["by"]), arrays["position_m"], arrays["known"]
        if by not in get_args(By) or position.shape != (len(known), 2):
            raise ValueError(f"{UNATTACKED} of {folder} is damaged")
        return Counterfactual(by=cast(By, by), position_m=position, known=known)


def read_predicted(folder: Path) -> Counterfactual | None:
    """The likeliest prediction of the first plan, with which earlier versions judged attacks.

    None where it has no candidates.
    """
    with stored.arrays(folder / PLANS) as arrays:
        if "00/candidate_position_m" not in arrays:
            return None
        position = arrays["00/candidate_position_m"].astype(float)
        origin = (
            arrays["00/candidate_origin"].tolist()
            if "00/candidate_origin" in arrays
            else ["mode"] * len(position)
        )
        first = int(arrays["00/first_step"])
        if not 0 <= first < stored.MOST_STEPS:
            raise ValueError(f"the first step of a plan is not within 0 and {stored.MOST_STEPS}")
        return predicted(first, likeliest(position, origin))


def _plan(plan: Plan) -> dict[str, NDArray[Any]]:
    arrays = {
        "agent_id": np.array(plan.agent_id),
        "first_step": np.array(plan.first_step),
        "position_m": plan.position_m,
        "heading_rad": plan.heading_rad,
        "speed_mps": plan.speed_mps,
    }
    if plan.supports is not None:
        arrays["supports"] = np.array(plan.supports)
    return arrays


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
        supports = {name for name in arrays if name.endswith("/supports")}
        return tuple(
            Plan(
                agent_id=str(arrays[f"{number:02d}/agent_id"]),
                first_step=int(arrays[f"{number:02d}/first_step"]),
                position_m=arrays[f"{number:02d}/position_m"],
                heading_rad=arrays[f"{number:02d}/heading_rad"],
                speed_mps=arrays[f"{number:02d}/speed_mps"],
                supports=str(arrays[name])
                if (name := f"{number:02d}/supports") in supports
                else None,
            )
            for number in range(int(arrays["plans"]))
        )
