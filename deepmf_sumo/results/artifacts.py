"""``plans.npz`` of a run; what a run left as a Rollout; and a Rollout as a scene."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo import files
from deepmf_sumo.datatypes import (
    DT_S,
    ROLLOUT,
    Case,
    Contact,
    OpponentScores,
    Plan,
    PlanReason,
    RecordedCase,
    Rollout,
    Scene,
    Signals,
    Source,
    Tracks,
    frozen,
)
from deepmf_sumo.results import stored, tracks
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


def scene_of(rollout: Rollout, case: Case) -> Scene:
    """The rollout as a scene whose labelled pair is the AV and its opponent.

    After a contact the AV is no longer valid, since what it would have done is not known; the
    opponent's last plan continues, since the AV's motion was a reaction to it. Signals of
    recordings are kept; of network cases they are not in a rollout and stay unknown.
    """
    steps = max(rollout.tracks.steps, rollout.now + 1 + case.duration_steps)
    tracks = _with_plan(_padded(rollout.tracks, steps), rollout)
    interest = (rollout.av_id, rollout.opponent_id) if rollout.opponent_id else ()
    if isinstance(case, RecordedCase):
        source = replace(case.scene.source, dataset=ROLLOUT)
        signals = _continued(case.scene.signals, steps)
    else:
        source = Source(dataset=ROLLOUT, file=str(case.config), record=0, sha256="")
        signals = _unknown(steps)
    return Scene(
        name=case.name,
        source=source,
        dt_s=rollout.dt_s,
        now=rollout.now,
        timestamps_s=frozen(np.arange(steps) * rollout.dt_s),
        tracks=tracks,
        road=case.road,
        signals=signals,
        av_id=rollout.av_id,
        interest=interest,
    )


def _padded(tracks: Tracks, steps: int) -> Tracks:
    """The tracks, with steps at the end in which no agent is valid."""
    flat, vector = [(0, 0), (0, steps - tracks.steps)], [(0, 0), (0, steps - tracks.steps), (0, 0)]
    return replace(
        tracks,
        position_m=np.pad(tracks.position_m, vector),
        z_m=np.pad(tracks.z_m, flat),
        heading_rad=np.pad(tracks.heading_rad, flat),
        velocity_mps=np.pad(tracks.velocity_mps, vector),
        valid=np.pad(tracks.valid, flat),
    )


def _with_plan(tracks: Tracks, rollout: Rollout) -> Tracks:
    """The opponent's last plan after the end of the episode."""
    if not rollout.plans or rollout.opponent_id not in tracks.ids:
        return tracks
    plan, row, begin = rollout.plans[-1], tracks.row(str(rollout.opponent_id)), rollout.tracks.steps
    stop = min(tracks.steps, plan.first_step + len(plan.position_m))
    if stop <= begin:
        return tracks
    of_plan = slice(begin - plan.first_step, stop - plan.first_step)
    position, heading = tracks.position_m.copy(), tracks.heading_rad.copy()
    velocity, valid = tracks.velocity_mps.copy(), tracks.valid.copy()
    heading_plan, speed = plan.heading_rad[of_plan], plan.speed_mps[of_plan]
    position[row, begin:stop] = plan.position_m[of_plan]
    heading[row, begin:stop] = heading_plan
    direction = np.stack([np.cos(heading_plan), np.sin(heading_plan)], -1)
    velocity[row, begin:stop] = speed[:, None] * direction
    valid[row, begin:stop] = True
    return replace(
        tracks, position_m=position, heading_rad=heading, velocity_mps=velocity, valid=valid
    )


def _continued(signals: Signals, steps: int) -> Signals:
    pad = [(0, 0), (0, max(0, steps - signals.seen.shape[1]))]
    return replace(
        signals,
        state=np.pad(signals.state, pad)[:, :steps],
        seen=np.pad(signals.seen, pad)[:, :steps],
    )


def _unknown(steps: int) -> Signals:
    return Signals(
        lane_ids=(),
        state=np.zeros((0, steps), np.uint8),
        seen=np.zeros((0, steps), bool),
        stop_m=np.zeros((0, 2)),
    )
