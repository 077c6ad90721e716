"""``tracks.csv.gz`` and ``plans.npz`` of a run: written from a Rollout, and read."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from deepmf_sumo import files
from deepmf_sumo.datatypes import (
    DT_S,
    Contact,
    Driver,
    OpponentScores,
    Plan,
    PlanReason,
    Rollout,
    Tracks,
)
from deepmf_sumo.geometry import frames
from deepmf_sumo.results import stored

TRACK_COLUMNS: Final = (
    "step,time_s,id,kind,role,driver,x_m,y_m,heading_rad,speed_mps,length_m,width_m,z_m"
)


def write_tracks(path: Path, rollout: Rollout) -> None:
    """One row an agent and step present; time 0 is the step at which the simulation took over."""
    tracks = rollout.tracks
    roles = {rollout.opponent_id: "opponent", rollout.av_id: "av"}
    drivers = {int(driver): driver.name.lower() for driver in Driver}
    who = [
        f"{_quoted(agent_id)},{kind},{roles.get(agent_id, 'other')}"
        for agent_id, kind in zip(tracks.ids, tracks.kinds, strict=True)
    ]
    size = [f"{length:.3f},{width:.3f}" for length, width, _ in tracks.size_m]
    step, row = np.nonzero(tracks.valid.T)
    # Lists, for formatting numbers of numpy takes several times as long.
    cells = (
        step,
        np.array([f"{(at - rollout.now) * rollout.dt_s:.1f}" for at in range(tracks.steps)])[step],
        row,
        rollout.driver[row, step],
        *tracks.position_m[row, step].T,
        tracks.heading_rad[row, step],
        tracks.speed_mps[row, step],
        tracks.z_m[row, step],
    )
    lines = [
        f"{at},{time},{who[agent]},{drivers[driver]},{x:.4f},{y:.4f},{heading:.5f},{speed:.4f},"
        f"{size[agent]},{z:.2f}"
        for at, time, agent, driver, x, y, heading, speed, z in zip(
            *(cell.tolist() for cell in cells), strict=True
        )
    ]
    lines.insert(0, TRACK_COLUMNS)
    files.write(path, files.gzipped("\n".join(lines) + "\n"))


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
    with stored.tracks(folder / "tracks.csv.gz") as text:
        table = pd.read_csv(text, dtype={"id": str}, keep_default_na=False)
    roles = {role: str(rows["id"].iloc[0]) for role, rows in table.groupby("role")}
    ids = tuple(table["id"].unique())
    place = pd.Series(np.arange(len(ids)), index=ids)
    row, step = place[table["id"]].to_numpy(), table["step"].to_numpy()
    if not (len(step) and step.min() >= 0 and step.max() < stored.MOST_STEPS):
        raise ValueError(f"a step is not within 0 and {stored.MOST_STEPS}")
    shape = (len(ids), int(step.max()) + 1)

    def dense(name: str) -> Any:
        array = np.zeros(shape)
        array[row, step] = table[name]
        return array

    valid, driver = np.zeros(shape, bool), np.zeros(shape, np.uint8)
    valid[row, step] = True
    driver[row, step] = table["driver"].str.upper().map(Driver.__members__)
    first = table.drop_duplicates("id")
    heading, speed = dense("heading_rad"), dense("speed_mps")
    return Rollout(
        tracks=Tracks(
            ids=ids,
            kinds=tuple(first["kind"]),
            size_m=np.column_stack([first["length_m"], first["width_m"], np.zeros(len(ids))]),
            position_m=np.stack([dense("x_m"), dense("y_m")], axis=-1),
            z_m=dense("z_m") if "z_m" in table else np.zeros(shape),  # older results have none
            heading_rad=heading,
            velocity_mps=speed[..., None] * frames.unit(heading),
            valid=valid,
        ),
        driver=driver,
        now=int(step[np.abs(table["time_s"].to_numpy()).argmin()]),
        dt_s=DT_S,
        av_id=roles["av"],
        opponent_id=roles.get("opponent"),
        contacts=tuple(contacts),
        events=(),
        plans=_read_plans(folder / "plans.npz"),
        ended=ended,
    )


def read_scores(folder: Path) -> OpponentScores | None:
    """The scores that the first plan rests on; None where the opponent was given."""
    with stored.arrays(folder / "plans.npz") as arrays:
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


def _quoted(text: str) -> str:
    plain = not any(mark in text for mark in ',"\n\r')
    return text if plain else '"' + text.replace('"', '""') + '"'


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
