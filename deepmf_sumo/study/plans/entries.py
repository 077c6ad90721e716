"""Plan -> entries (a method on a planner with a budget) -> tasks of a batch."""

import copy
import shlex
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deepmf_sumo import plugins, spec
from deepmf_sumo.attacks.base import Checkable
from deepmf_sumo.deepmf.opponent import SCORED
from deepmf_sumo.errors import PluginError, SpecError, WeightsError
from deepmf_sumo.scene.readers import RecordRef
from deepmf_sumo.spec import First, FromMoments, FromNetwork, SearchBudget, Spec
from deepmf_sumo.spec import tasks as tasks_module
from deepmf_sumo.spec.document import Document
from deepmf_sumo.spec.tasks import Label, Task
from deepmf_sumo.study import moments
from deepmf_sumo.study.moments import Moment
from deepmf_sumo.study.plans.plan import Loaded, StudyPlan, Subset


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedScene:
    """A scene of the plan.

    Attributes:
        source: number of its source. record: as of `Task`.
        moment: where the source's moments are chosen.
    """

    source: int
    scene: str
    record: RecordRef | None = None
    moment: Moment | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One row of a table.

    Attributes:
        specs: one a source, of the plan's first seed.
        situations: that it is run on.
    """

    label: Label
    specs: tuple[Spec, ...]
    situations: tuple[PlannedScene, ...]

    def tasks(self, seeds: Sequence[int]) -> Iterator[Task]:
        """A task for every situation and seed."""
        for place in self.situations:
            for seed in seeds:
                one = self.specs[place.source].model_copy(update={"seed": seed})
                if place.moment:
                    one = moments.at(one, place.moment)
                yield Task(
                    run_id=tasks_module.run_id_of(one, place.scene),
                    spec=one,
                    scene=place.scene,
                    label=self.label,
                    record=place.record,
                )


def _none(_: Spec) -> Sequence[Moment]:
    return ()


def entries_of(
    loaded: Loaded, cache: Path, look: Callable[[Spec], Sequence[Moment]] = _none
) -> list[Entry]:
    """All rows: methods with their own budgets first, then with others; planner by planner.

    ``look`` finds the moments of a spec whose source is `FromMoments`.

    Raises SpecError for settings that an adversary or a planner refuses, with file and line, and
    for a method that is not installed, with how to install it.
    """
    plan = loaded.plan
    specs = {
        (method, planner): _specs(loaded, method, planner)
        for method in plan.methods
        for planner in plan.planners
    }
    for method in plan.methods:
        _check_installed(method, specs[method, next(iter(plan.planners))][0])
    situations = _situations(next(iter(specs.values())), cache, look)
    main = [
        Entry(
            label=Label(
                method=label,
                planner=planner,
                part="figures" if method.figures_only else "main",
                base=label,
            ),
            specs=specs[label, planner],
            situations=situations[: count(method, situations)],
        )
        for label, method in plan.methods.items()
        for planner in method.planners or plan.planners
    ]
    return main + _budgeted(plan, specs, situations)


def tasks_of(entries: Sequence[Entry], seeds: Sequence[int]) -> list[Task]:
    """All tasks in the order of the tables; a budget that two tables ask for is run once.

    Raises SpecError where two different runs would have one id.
    """
    found: dict[str, Task] = {}
    for entry in entries:
        for task in entry.tasks(seeds):
            same = found.setdefault(task.run_id, task)
            if same.spec != task.spec:
                raise SpecError(
                    f"key 'methods': '{entry.label.method}' is also what a method with another"
                    " budget is called; give it another name."
                )
    return list(found.values())


def _budgeted(
    plan: StudyPlan,
    specs: dict[tuple[str, str], tuple[Spec, ...]],
    situations: tuple[PlannedScene, ...],
) -> list[Entry]:
    """Methods with other budgets than their own."""
    wanted: list[tuple[Subset, str, SearchBudget]] = []
    if plan.equal_seconds:
        equal = plan.equal_seconds
        wanted += [(equal, one, SearchBudget(seconds=equal.seconds)) for one in equal.methods]
    if plan.curves:
        for method, points in plan.curves.methods.items():
            wanted += [(plan.curves, method, budget) for budget in points.budgets]
    return [
        Entry(
            label=Label(method=told, planner=planner, part="budgets", base=method),
            specs=tuple(
                one.model_copy(update={"budget": budget, "name": _name(told, planner)})
                for one in specs[method, planner]
            ),
            situations=situations[: count(subset, situations)],
        )
        for subset, method, budget in wanted
        if budget != plan.methods[method].budget
        for told in [f"{method} ({_told(budget)})"]
        for planner in subset.planners or plan.planners
    ]


def count(subset: Subset, scenes: Sequence[Any]) -> int:
    """How many of the plan's scenes a part of it takes."""
    return subset.scenes.first if isinstance(subset.scenes, First) else len(scenes)


def _told(budget: SearchBudget) -> str:
    if budget.seconds is not None:
        return f"{budget.seconds:g} s"
    return f"{budget.simulations} simulations"


def _name(method: str, planner: str) -> str:
    return f"{method} on {planner}"


def _situations(
    specs: Sequence[Spec], cache: Path, look: Callable[[Spec], Sequence[Moment]]
) -> tuple[PlannedScene, ...]:
    """All scenes of all sources; networks of one name differ by time and AV."""
    stems = Counter(one.source.network.stem for one in specs if isinstance(one.source, FromNetwork))
    found: list[PlannedScene] = []
    for number, one in enumerate(specs):
        source = one.source
        if isinstance(source, FromMoments):
            found += [
                PlannedScene(
                    source=number, scene=_scene(source.at(each.start_s, each.av)), moment=each
                )
                for each in look(one)
            ]
            continue
        for scene, record in tasks_module.scenes(one, cache):
            alike = isinstance(source, FromNetwork) and stems[scene] > 1
            name = _scene(source) if alike and isinstance(source, FromNetwork) else scene
            found.append(PlannedScene(source=number, scene=name, record=record))
    names = Counter(place.scene for place in found)
    twice = [name for name, number in names.items() if number > 1]
    if twice:
        raise SpecError(
            f"key 'source': the scene '{twice[0]}' is given twice; leave one of them out."
        )
    if not found:
        raise SpecError("key 'source': no moment of the networks can be attacked.")
    return tuple(found)


def _scene(source: FromNetwork) -> str:
    return f"{source.network.stem} {source.start_s:.12g} s {source.av.vehicle}"


def _specs(loaded: Loaded, method: str, planner: str) -> tuple[Spec, ...]:
    """A spec a source; only one of each kind of source is checked key by key."""
    checked: dict[type, Spec] = {}
    specs = []
    for number, source in enumerate(loaded.plan.source):
        if type(source) not in checked:
            checked[type(source)] = _checked(loaded, method, planner, number)
        specs.append(checked[type(source)].model_copy(update={"source": source}))
    return tuple(specs)


def _checked(loaded: Loaded, method: str, planner: str, source: int) -> Spec:
    """The spec that a method and a planner make. Raises SpecError, with the plan's lines."""
    plan, values = loaded.plan, loaded.document.values
    listed = isinstance(values["source"], list)
    own = values["methods"][method]
    short = isinstance(own, str)
    places: dict[str, tuple[str | int, ...]] = {
        "source": ("source", source) if listed else ("source",),
        "planner": ("planners", planner),
        "adversary": ("methods", method) if short else ("methods", method, "adversary"),
        "budget": ("methods", method, "budget"),
        "weights": ("methods", method, "weights"),
        "profile": ("methods", method, "profile"),
        "opponents": ("opponents",),
        "turns": ("turns",),
    }
    for key in ("weights", "profile"):
        if getattr(plan.methods[method], key) is None:
            places[key] = (key,)
    spelled: dict[str, Any] = {
        "version": plan.version,
        "name": _name(method, planner),
        "duration_s": plan.duration_s,
        "seed": plan.seeds[0],
        "source": values["source"][source] if listed else values["source"],
        "planner": values["planners"][planner],
        "adversary": own if short else own["adversary"],
        "budget": {} if short else own.get("budget", {}),
        "weights": plan.methods[method].weights or plan.weights,
    }
    stated = {
        "traffic": plan.traffic,
        "profile": plan.methods[method].profile or plan.profile,
        "opponents": plan.opponents,
        "turns": values.get("turns"),
    }
    spelled |= {key: value for key, value in stated.items() if value is not None}
    document = Document(file=loaded.document.file, values=copy.deepcopy(spelled))
    for key, at in places.items():
        for path, place in loaded.document.places.items():
            if path[: len(at)] == at:
                document.places[key, *path[len(at) :]] = place
    try:
        return spec.of_document(document)
    except SpecError as error:
        raise SpecError(f"{error} (method '{method}' on planner '{planner}')") from None


def _check_installed(method: str, one: Spec) -> None:
    """Make the adversary and find its weights: what is missing shows before hours of work."""
    choice = one.adversary
    settings = plugins.settings("adversaries", choice.name, choice.settings)
    try:
        adversary = plugins.load("adversaries", choice.name).build(settings, one.weights)
        if isinstance(adversary, Checkable):
            adversary.check()
        if getattr(settings, "opponent", None) in SCORED:
            from deepmf_sumo.deepmf.networks import weights

            weights.find(one.weights)
    except (PluginError, WeightsError) as error:
        raise SpecError(
            f"method '{method}': {error} Or leave it out: --without {shlex.quote(method)}."
        ) from None
