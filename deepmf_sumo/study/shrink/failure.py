"""A run of a result folder whose opponent hit the AV, as what a reproducer is made from."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from deepmf_sumo import spec as spec_module
from deepmf_sumo.errors import SpecError, UsageError, nearest
from deepmf_sumo.files import cache_folder
from deepmf_sumo.results import stored
from deepmf_sumo.results.reader import Results, Run
from deepmf_sumo.results.result import Result
from deepmf_sumo.scene import AgentId, Contact, Floats, Plan, Rollout, agent_ids
from deepmf_sumo.spec import FromNetwork, Spec, WantedPeople, tasks
from deepmf_sumo.spec.tasks import Task

_LISTED: Final = 5
"""Ids of runs in a message."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedHit:
    """A hit, with steps counted from the start of its run (step 0).

    Attributes:
        run_id, planner: for people.
        task: the run as it was; candidates differ from it in their spec.
        opponent: the vehicle that hit the AV. others: beside it and the AV, nearest first.
        driven: (C + 1, 3) x, y, heading of the opponent from the start to the contact.
        plans: of the opponent, in order; their ``first_step`` counts from the start.
        begin: step at which the opponent was chosen; above 0 where opponents took turns.
        contact: step C at which AV and opponent touch.
    """

    run_id: str
    planner: str
    task: Task
    opponent: AgentId
    others: tuple[AgentId, ...]
    driven: Floats
    plans: tuple[Plan, ...]
    begin: int
    contact: int

    @property
    def spec(self) -> Spec:
        """The spec of the run."""
        return self.task.spec

    def path(self, plans: int) -> Floats:
        """(K, 3) the opponent from the start on, had it made only the first ``plans`` plans.

        As driven where it was not driven by a plan. The last plan counts up to its end, beyond the
        contact.
        """
        poses = self.driven.copy()
        for number, plan in enumerate(self.plans[:plans], start=1):
            table = np.column_stack([plan.position_m, plan.heading_rad])
            first, last = plan.first_step, plan.first_step + len(table)
            if number == plans:
                beyond = plans < len(self.plans) or last > len(poses)
                poses = np.concatenate([poses[:first], table]) if beyond else poses
            poses[first:last] = table[: len(poses) - first]
        return poses


def run_of(folder: Path, run_id: str | None = None) -> Path:
    """The run's folder: ``folder`` itself, or that of a run of a result folder.

    Raises UsageError where there is no such run; it names hits of the result folder.
    """
    if run_id is None and (folder / stored.RESULT).is_file():
        return folder
    results = Results.of(folder)
    hits = [run.run_id for run in results.runs if run.hit]
    if run_id is None:
        some = ", ".join(hits[:_LISTED]) + (", ..." if len(hits) > _LISTED else "")
        raise UsageError(
            f"{folder} is a result folder of {len(results.runs)} runs: name one of them after it;"
            f" {f'its hits are {some}' if hits else 'none of them is a hit'}."
        )
    found = next((run.folder for run in results.runs if run.run_id == run_id), None)
    if found is None:
        hint = nearest(run_id, [run.run_id for run in results.runs])
        raise UsageError(f"{folder} has no run '{run_id}'.{hint}")
    return found


def read(folder: Path) -> RecordedHit:
    """The failure of a run's folder.

    Raises UsageError where the run failed, its opponent did not hit the AV, or a file is missing or
    damaged; SpecError where its planner, its network or its recording is not there any more.
    """
    result = stored.result_of(folder / stored.RESULT)
    if result["status"] != "ok":
        raise UsageError(
            f"{folder}: the run ended with '{result['status']}' ({result['error']}): there is no"
            " motion to shrink; give a run whose opponent hit the AV."
        )
    if result["outcome"] != "av_opponent":
        raise UsageError(
            f"{folder}: the opponent did not hit the AV (outcome: {result['outcome']}); give a run"
            " with the outcome av_opponent."
        )
    task = _with_the_same_people(_task(folder, result["run_id"]), result)
    row = {key: str(value or "") for key, value in result.items()} | {"seed": str(result["seed"])}
    run = replace(Run.of_row(Path(), row), folder=folder)
    try:
        rollout = run.rollout
    except stored.DAMAGE as error:
        raise UsageError(f"{folder} is damaged ({error}); run it again.") from None
    hit = rollout.first("av_opponent")
    if hit is None or rollout.opponent_id is None:
        raise UsageError(f"{folder} is damaged: its tracks name no opponent; run it again.")
    turns = result.get("turns") or []
    chosen = next((turn["begin_s"] for turn in turns if turn["ended"] == "contact"), 0.0)
    now, row_of = rollout.now, rollout.tracks.row(rollout.opponent_id)
    shown = slice(now, hit.step + 1)
    tracks = rollout.tracks
    return RecordedHit(
        run_id=result["run_id"],
        planner=f"{result['planner']} {result['perception'] or ''}".strip(),
        task=task,
        opponent=rollout.opponent_id,
        others=_others(rollout, hit),
        driven=np.column_stack(
            [tracks.position_m[row_of, shown], tracks.heading_rad[row_of, shown]]
        ),
        plans=tuple(
            replace(plan, first_step=plan.first_step - now)
            for plan in rollout.plans_of(rollout.opponent_id)
            if plan.first_step <= hit.step
        ),
        begin=round(chosen / rollout.dt_s),
        contact=hit.step - now,
    )


def _task(folder: Path, run_id: str) -> Task:
    """The run as a task. Raises UsageError for a live attack, SpecError for what is missing."""
    file = folder / stored.SPEC
    if not file.is_file():
        raise UsageError(
            f"{folder} has no spec.yaml: an attack on a simulation of another program cannot be"
            " repeated; give a run of `run` or `attack`."
        )
    spec = spec_module.load(file)
    found = tasks.plan([spec], cache_folder())
    if len(found) != 1:
        raise SpecError(f"{file} describes {len(found)} runs, not one; run it again.")
    return replace(found[0], run_id=run_id)


def _with_the_same_people(task: Task, result: Result) -> Task:
    """The run with the people who were made, as given: a later start would draw others."""
    source, made = task.spec.source, result.get("made", [])
    if not made or not isinstance(source, FromNetwork):
        return task
    given = [{key: value for key, value in one.items() if key != "id"} for one in made]
    people = WantedPeople.model_validate({"who": source.people.who, "given": given})
    source = source.model_copy(update={"people": people})
    return replace(task, spec=task.spec.model_copy(update={"source": source}))


def _others(rollout: Rollout, hit: Contact) -> tuple[AgentId, ...]:
    """All road users that were there, by their least distance to AV or opponent."""
    tracks, shown = rollout.tracks, slice(rollout.now, hit.step + 1)
    pair = [tracks.row(rollout.av_id), tracks.row(str(rollout.opponent_id))]
    there = tracks.valid[:, shown]
    apart = tracks.position_m[:, None, shown] - tracks.position_m[pair][:, shown]
    away = np.where(
        there[:, None] & there[pair], np.hypot(apart[..., 0], apart[..., 1]), np.inf
    ).min(axis=(1, 2))
    rows = [row for row in np.argsort(away, kind="stable") if there[row].any() and row not in pair]
    return agent_ids.wholes(tracks.ids[row] for row in rows)
