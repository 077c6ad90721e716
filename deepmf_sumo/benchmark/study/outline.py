"""Plan -> the layout that its folder keeps."""

from collections.abc import Sequence

import deepmf_sumo
from deepmf_sumo.benchmark.study.entries import Entry, count
from deepmf_sumo.benchmark.study.layout import Budgeted, Layout
from deepmf_sumo.benchmark.study.plan import Plan, Subset
from deepmf_sumo.benchmark.tasks import Task
from deepmf_sumo.spec import SearchBudget

Budgets = dict[str, list[SearchBudget]]


def layout_of(plan: Plan, entries: Sequence[Entry], planned: Sequence[Task]) -> Layout:
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
    return Layout(
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


def _part(plan: Plan, subset: Subset, budgets: Budgets, scenes: list[str]) -> Budgeted:
    return Budgeted(
        budgets={
            method: [budget.model_dump() for budget in each] for method, each in budgets.items()
        },
        planners=list(subset.planners or plan.planners),
        scenes=scenes[: count(subset, scenes)],
    )
