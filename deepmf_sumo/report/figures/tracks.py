"""``tracks.csv.gz`` and ``plans.npz`` of a run -> Rollout, and the scores of its first plan."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from deepmf_sumo.benchmark import stored
from deepmf_sumo.datatypes import DT_S, Contact, Driver, OpponentScores, Plan, Rollout, Tracks
from deepmf_sumo.geometry import angles


def read_rollout(folder: Path, contacts: Sequence[Contact], ended: str) -> Rollout:
    """The rollout of a run; velocities lie along the headings, plans are without reasons."""
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
            velocity_mps=speed[..., None] * angles.unit(heading),
            valid=valid,
        ),
        driver=driver,
        now=int(step[np.abs(table["time_s"].to_numpy()).argmin()]),
        dt_s=DT_S,
        av_id=roles["av"],
        opponent_id=roles.get("opponent"),
        contacts=tuple(contacts),
        events=(),
        plans=_plans(folder / "plans.npz"),
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


def _plans(file: Path) -> tuple[Plan, ...]:
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
