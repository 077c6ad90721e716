"""What a result folder says of its plan: all that tables need, without specs and scenes."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

import deepmf_sumo
from deepmf_sumo import files
from deepmf_sumo.errors import UsageError
from deepmf_sumo.results import stored
from deepmf_sumo.spec import SearchBudget
from deepmf_sumo.spec.model import Version
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.study.plans.entries import Entry, count
from deepmf_sumo.study.plans.plan import StudyPlan, Subset

FILE: Final = "study.json"
FORMAT_VERSION: Final = 2

Budgets = dict[str, list[SearchBudget]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Budgeted:
    """Runs with other budgets than the methods' own.

    Attributes:
        budgets: by method, ``{simulations, seconds}`` each.
        planners, scenes: on which.
    """

    budgets: Mapping[str, list[dict[str, Any]]]
    planners: list[str]
    scenes: list[str]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanLayout:
    """A plan as its result folder keeps it.

    Attributes:
        name: of the plan. version: of the program.
        methods, planners, scenes: labels and names, in the plan's order; without methods that are
            run for figures alone.
        baseline, versions, compared: see `plan.Tables`.
        equal_seconds, curves: None where the plan has none.
        runs: run id -> key, in the plan's order; all of them, whatever shard this is.
        plan: as written, with all paths absolute.
    """

    name: str
    version: str
    methods: list[str]
    planners: list[str]
    scenes: list[str]
    baseline: str
    versions: list[str]
    compared: list[str]
    equal_seconds: Budgeted | None
    curves: Budgeted | None
    runs: dict[str, str]
    plan: dict[str, Any]

    def planned(self, method: str, planner: str, most_scenes: int | None = None) -> int:
        """Runs of a method on a planner, with its own budget, on the first scenes of the plan."""
        wanted = self.plan["methods"][method]
        if wanted["planners"] and planner not in wanted["planners"]:
            return 0
        scenes = wanted["scenes"]
        some = len(self.scenes) if scenes == "all" else min(scenes["first"], len(self.scenes))
        some = some if most_scenes is None else min(some, most_scenes)
        return some * len(self.plan["seeds"])

    def write(self, folder: Path) -> None:
        """Write it into a result folder."""
        values = asdict(self)
        values["runs"] = [list(pair) for pair in self.runs.items()]  # JSON objects are sorted here
        files.write_json(folder / FILE, {"format_version": FORMAT_VERSION, **values})


def layout_of(plan: StudyPlan, entries: Sequence[Entry], planned: Sequence[Task]) -> PlanLayout:
    """What the folder of the plan keeps of it; ``planned`` are all its tasks."""
    deepmf = {entry.label.base for entry in entries if entry.specs[0].adversary.name == "deepmf"}
    methods = [label for label, method in plan.methods.items() if not method.figures_only]
    baseline = plan.tables.baseline or methods[0]
    versions, compared = plan.tables.versions, plan.tables.compared
    if versions is None:
        versions = tuple(method for method in methods if method in deepmf)
    if compared is None:
        compared = tuple(one for one in methods if one == baseline or one not in deepmf)
    scenes = list(dict.fromkeys(place.scene for entry in entries for place in entry.situations))
    equal, curves = plan.equal_seconds, plan.curves
    seconds: Budgets = {}
    points: Budgets = {}
    if equal:
        seconds = {method: [SearchBudget(seconds=equal.seconds)] for method in equal.methods}
    if curves:
        points = {method: list(each.budgets) for method, each in curves.methods.items()}
    return PlanLayout(
        name=plan.name,
        version=deepmf_sumo.__version__,
        methods=methods,
        planners=list(plan.planners),
        scenes=scenes,
        baseline=baseline,
        versions=list(versions),
        compared=list(compared),
        equal_seconds=_part(plan, equal, seconds, scenes) if equal else None,
        curves=_part(plan, curves, points, scenes) if curves else None,
        runs={task.run_id: task.key for task in planned},
        plan=plan.model_dump(mode="json"),
    )


class _First(BaseModel):
    first: int


class _Budget(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)
    simulations: int | None
    seconds: float | None


class _Method(BaseModel):
    planners: list[str]
    scenes: Literal["all"] | _First
    budget: _Budget


class _Planned(BaseModel):
    """What `PlanLayout.planned` and the tables need of the plan as written."""

    version: Version
    methods: dict[str, _Method]
    seeds: list[int]


def read_layout(folder: Path) -> PlanLayout:
    """The layout of a plan's folder. Raises UsageError where it is not one of this version."""
    file = folder / FILE
    if not file.exists():
        raise UsageError(f"{folder} is not the folder of a plan: it has no {FILE}.")
    values = stored.mapping(file, again="run the plan again")
    found = values.get("version")
    if found != deepmf_sumo.__version__ or values.pop("format_version", None) != FORMAT_VERSION:
        raise UsageError(
            f"{folder} was made by version {found} of deepmf-sumo, and this is"
            f" {deepmf_sumo.__version__}: results of two versions do not go into one table; "
            "choose another folder, or run that version."
        )
    try:
        layout = TypeAdapter(PlanLayout).validate_python({**values, "runs": dict(values["runs"])})
        _check(layout)
    except ValidationError as error:
        wrong = stored.first_wrong(error)
        raise UsageError(f"{file} is damaged ({wrong}); run the plan again.") from None
    except (LookupError, TypeError, ValueError) as error:
        raise UsageError(f"{file} is damaged ({error}); run the plan again.") from None
    for run_id in layout.runs:
        stored.run_folder(folder, run_id, FILE)
    return layout


def _check(layout: PlanLayout) -> None:
    """Raise ValueError where it is not a plan, or names methods that it does not have."""
    plan = _Planned.model_validate(layout.plan)
    parts = [part for part in (layout.equal_seconds, layout.curves) if part]
    for part in parts:
        TypeAdapter(dict[str, list[_Budget]]).validate_python(part.budgets)
    named = [*layout.methods, layout.baseline]
    named += [method for part in parts for method in part.budgets]
    lost = [method for method in named if method not in plan.methods]
    if lost:
        raise ValueError(f"the plan has no method {lost[0][:80]!r}")


def _part(plan: StudyPlan, subset: Subset, budgets: Budgets, scenes: list[str]) -> Budgeted:
    return Budgeted(
        budgets={
            method: [budget.model_dump() for budget in each] for method, each in budgets.items()
        },
        planners=list(subset.planners or plan.planners),
        scenes=scenes[: count(subset, scenes)],
    )
