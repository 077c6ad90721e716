"""Specs -> a result folder; a plan -> one with the tables of its methods.

Moments of runs may be drawn by what earlier runs found: then they are run batch after batch.
"""

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Final, get_args

from deepmf_sumo import files
from deepmf_sumo.errors import UsageError
from deepmf_sumo.files import cache_folder
from deepmf_sumo.results import findings, folder, stored
from deepmf_sumo.results.folder import opened
from deepmf_sumo.results.quantities import SPARE, criticality
from deepmf_sumo.results.result import Result, attacked
from deepmf_sumo.spec import FromMoments, Spec, tasks
from deepmf_sumo.spec.tasks import Part, Task
from deepmf_sumo.study import moments
from deepmf_sumo.study.moments import FoundMoments, Moment, MomentRequest
from deepmf_sumo.study.moments.promising import Promising
from deepmf_sumo.study.plans import entries, layout, tables
from deepmf_sumo.study.plans.entries import Entry
from deepmf_sumo.study.plans.layout import PlanLayout
from deepmf_sumo.study.plans.plan import Loaded
from deepmf_sumo.study.sweep import batch, shards
from deepmf_sumo.study.sweep.batch import Options, Progress
from deepmf_sumo.study.sweep.inputs import fingerprinted
from deepmf_sumo.study.sweep.shards import Shard, note

Report = Callable[[Progress], None]
Announce = Callable[[MomentRequest, FoundMoments], None]
"""Called with the moments of a network that were found."""
_NEAR: Final = 0.5
"""Worth of a contact that is no finding; of a miss less, by how near it came."""


def run_specs(
    specs: Sequence[Spec],
    options: batch.Options,
    report: Report = lambda _: None,
    announce: Announce = lambda *_: None,
    *,
    by_option: bool = False,
) -> list[Result]:
    """Run specs and write the result folder; results in the order of the runs.

    Of specs with ``source.moments`` the moments are chosen first, and moments.csv says which.

    Args:
        specs: any.
        options: of the runs.
        report: called when a run has ended.
        announce: called when moments were found.
        by_option: messages name the options of ``attack``, see `WantedMoments`.

    Raises SpecError, UsageError, SimulationError or OutputError before anything is attacked.
    """
    wanted = {
        index: moments.request(one, by_option=by_option)
        for index, one in enumerate(specs)
        if isinstance(one.source, FromMoments)
    }
    for request in wanted.values():
        refuse(request, options)
    if wanted:
        folder.check(options.out, resume=options.resume, overwrite=options.overwrite)
    chosen: dict[int, list[Task]] = {}
    found: dict[str, Moment] = {}
    traffic: list[tuple[Spec, FoundMoments]] = []
    rounds = DrawRounds()
    for index, request in wanted.items():
        traffic.append((request.spec, _found(request, options, announce)))
        moments_of = traffic[-1][1].moments
        chosen[index] = moments.tasks(request.spec, moments_of)
        if request.wish.pool:
            rounds.add(request, traffic[-1][1], chosen[index])
        else:
            found |= zip((task.run_id for task in chosen[index]), moments_of, strict=True)
    planned = rounds.begin(tasks.plan(specs, cache_folder(), options.name_filter, chosen))
    if wanted:
        spread = [(one, found[one.run_id]) for one in planned if one.run_id in found]
        report = _noting(lambda: [*spread, *rounds.drawn], traffic, options, report)
    return batch.run_tasks(planned, options, report, rounds)


def _found(request: MomentRequest, options: batch.Options, announce: Announce) -> FoundMoments:
    found = moments.find(request.survey, request.wish, options.timeout_s, request.area)
    announce(request, found)
    return found


def _noting(
    chosen: Callable[[], Sequence[tuple[Task, Moment]]],
    traffic: Iterable[tuple[Spec, FoundMoments]],
    options: batch.Options,
    report: Report,
) -> Report:
    """The report, which also writes moments and flows, before the first run and as more are drawn.

    Those of runs of earlier commands that a resumed folder keeps stay.
    """
    specs = {spec.name for spec, _ in traffic}
    flows = moments.flow_rows(traffic)

    def tell(progress: Progress) -> None:
        if progress.last is None:
            out, rows = options.out, moments.rows(chosen())
            kept = stored.keys_of(out).keys() - {row["run_id"] for row in rows}
            earlier, passed = {}, []
            if kept:
                earlier, passed = stored.moments_of(out), stored.flows_of(out)
            before = [row for run_id, row in earlier.items() if run_id in kept]
            passed = [row for row in passed if row["spec"] not in specs]
            files.write(out / stored.MOMENTS, moments.table([*rows, *before]))
            files.write(out / stored.FLOW, moments.flow_table([*flows, *passed]))
        report(progress)

    return tell


def run(
    loaded: Loaded,
    options: batch.Options,
    report: Report = lambda _: None,
    announce: Announce = lambda *_: None,
) -> list[Result]:
    """Run a plan, or a shard of it, and write runs.csv and the tables.

    Runs begin scene by scene, so that an unfinished plan shows all methods; tables are in the
    plan's order. An interrupt leaves the finished runs and their tables behind and is passed on.

    Raises SpecError, UsageError, SimulationError or OutputError before anything runs.
    """
    plan, shard = loaded.plan, options.shard

    traffic: list[tuple[Spec, FoundMoments]] = []

    def look(spec: Spec) -> Sequence[Moment]:
        request = moments.request(spec)
        if request.wish.pool:
            raise UsageError(
                f"plan '{plan.name}', source.moments.draw: promising: methods are compared at the"
                " same moments, and these depend on what a method finds; leave it out."
            )
        traffic.append((spec, _found(request, options, announce)))
        return traffic[-1][1].moments

    rows = entries.entries_of(loaded, cache_folder(), look)
    planned, read = fingerprinted(entries.tasks_of(rows, plan.seeds))
    outlined = layout.layout_of(plan, rows, planned)
    if options.resume and (options.out / layout.FILE).is_file():
        _refuse_lost(options.out, layout.read_layout(options.out), outlined)
    chosen = shard.choose(planned) if shard else planned
    places = {place.scene: place.moment for entry in rows for place in entry.situations}
    if any(places.values()):
        at = [(one, moment) for one in planned if (moment := places[one.scene])]
        report = _noting(lambda: at, traffic, options, report)
    with opened(options.out, resume=options.resume, overwrite=options.overwrite) as store:
        changed = batch.begin(store, chosen, options, read)
        note(options.out, None)
        outlined.write(options.out)
        queue = _scene_by_scene(rows, plan.seeds)
        try:
            known = batch.Known(changed=changed, read=read)
            return batch.fill(store, chosen, options, report, queue=queue, known=known)
        finally:
            if (options.out / stored.RUNS).is_file():
                tables.write(options.out)


def _refuse_lost(out: Path, before: PlanLayout, now: PlanLayout) -> None:
    """Raise UsageError where a resumed folder has results that would be in no table any more."""
    done = [one for one in before.runs.keys() - now.runs if (out / "runs" / one).is_dir()]
    if not done:
        return
    gone = {
        kind: [one for one in getattr(before, kind) if one not in getattr(now, kind)]
        for kind in ("methods", "planners", "scenes")
    }
    what = "; ".join(f"{kind} {', '.join(names)}" for kind, names in gone.items() if names)
    raise UsageError(
        f"{out} has results of {len(done)} runs that this plan, as it is run now, does not have"
        f" ({what or f'e.g. {min(done)}'}): --resume would leave them out of all tables. Run the"
        " plan as before, without --without or --set, or give another folder for --out."
    )


def expected(out: Path, shard: Shard | None = None) -> int:
    """How many runs the plan of a folder, or a shard of it, has."""
    runs = list(layout.read_layout(out).runs)
    return len(runs[shard.number - 1 :: shard.of]) if shard else len(runs)


def _scene_by_scene(rows: Sequence[Entry], seeds: Sequence[int]) -> Callable[[Task], Any]:
    """Key of the order in which runs begin: own budgets first, then scene, seed, planner, method.

    So a worker reads a scene once for all methods.
    """
    every = (place.scene for entry in rows for place in entry.situations)
    scenes = {scene: number for number, scene in enumerate(dict.fromkeys(every))}
    labels = {entry.label: number for number, entry in enumerate(rows)}
    parts = get_args(Part)
    planners = list(dict.fromkeys(entry.label.planner for entry in rows))

    def key(task: Task) -> tuple[Any, ...]:
        assert task.label is not None
        return (
            parts.index(task.label.part),
            scenes[task.scene],
            seeds.index(task.spec.seed),
            planners.index(task.label.planner),
            labels[task.label],
        )

    return key


def merge(
    out: Path, folders: Sequence[Path], *, overwrite: bool = False
) -> tuple[list[Result], list[str]]:
    """Copy the runs of all shards into ``out``; returns their results and the ids of missing runs.

    Runs that are not there yet have no row: `run --resume` in ``out`` does them. Raises
    UsageError for folders of other plans or versions, or that hold a run twice, and OutputError.
    """
    plan = _common(folders)
    found = shards.found_in(folders, plan.runs)
    missing = [run_id for run_id in plan.runs if run_id not in found]
    with shards.joining(out, folders, plan.runs, found, overwrite=overwrite) as store:
        results = shards.copied(store, folders, plan.runs, found)
        plan.write(out)
        for name in (stored.MOMENTS, stored.FLOW):  # those of all shards
            if (folders[0] / name).is_file():
                files.copy(folders[0] / name, out / name)
        store.finish(
            results,
            junit_too=any((folder / "junit.xml").is_file() for folder in folders),
            interrupted=bool(missing),
        )
        tables.write(out)
    return results, missing


def _common(folders: Sequence[Path]) -> PlanLayout:
    """The plan of all shards. Raises UsageError where they differ."""
    first = layout.read_layout(folders[0])
    plan = _placeless(first)
    for each in folders[1:]:
        other = _placeless(layout.read_layout(each))
        if other != plan:
            names = (field.name for field in fields(PlanLayout))
            key = next(name for name in names if getattr(plan, name) != getattr(other, name))
            raise UsageError(
                f"{each} is of another plan than {folders[0]} (they differ in '{key}'); "
                "merge shards of one plan, run on one set of scenes."
            )
    return first


def _placeless(plan: PlanLayout) -> PlanLayout:
    """The plan, of its files the names alone: on another machine they lie elsewhere.

    That their contents are the same is in the keys of its runs.
    """
    return replace(plan, plan=_named(plan.plan))


def _named(value: Any) -> Any:
    """Plain values, in which absolute paths are the names at their ends."""
    if isinstance(value, dict):
        return {key: _named(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_named(each) for each in value]
    return Path(value).name if isinstance(value, str) and value.startswith(os.sep) else value


class DrawRounds:
    """The moments of specs with ``draw: promising``, see `study.moments.promising`."""

    def __init__(self) -> None:
        self._pools: list[tuple[dict[str, int], Promising]] = []
        self._runs: dict[str, Task] = {}  # of all moments
        self._tasks: dict[str, Task] = {}  # drawn
        self._moments: dict[str, Moment] = {}

    def add(self, request: MomentRequest, found: FoundMoments, runs: Sequence[Task]) -> None:
        """The pool of a spec, and the run of each of its moments."""
        spread = [at for _, at in sorted(zip(found.order, range(len(runs)), strict=True))]
        pool = [found.moments[at] for at in spread]
        places = {runs[at].run_id: place for place, at in enumerate(spread)}
        self._pools.append((places, Promising(pool, request.wish.count, request.spec.seed)))
        self._moments |= zip((one.run_id for one in runs), found.moments, strict=True)

    @property
    def left(self) -> int:
        """Runs that are not drawn yet."""
        return sum(promising.count for _, promising in self._pools) - len(self._tasks)

    @property
    def drawn(self) -> list[tuple[Task, Moment]]:
        """All runs so far."""
        return [(task, self._moments[run_id]) for run_id, task in self._tasks.items()]

    def begin(self, planned: Iterable[Task]) -> list[Task]:
        """The runs to begin with: of the pools the first moments, and all other runs."""
        every = list(planned)
        self._runs = {task.run_id: task for task in every}
        first = {task.run_id: task for task in self([])}
        later = {run_id for places, _ in self._pools for run_id in places} - first.keys()
        self._tasks = {one.run_id: first[one.run_id] for one in every if one.run_id in first}
        return [first.get(one.run_id, one) for one in every if one.run_id not in later]

    def __call__(self, results: Sequence[Result]) -> list[Task]:
        """The next runs, by what all before them found; none at the end."""
        found = {one["run_id"]: _worth(one) for one in results}
        drawn = {}
        for places, promising in self._pools:
            names = list(places)
            known = {
                places[name]: value for name in names if (value := found.get(name)) is not None
            }
            for place, draw in promising.draw(known).items():
                drawn[names[place]] = replace(self._runs[names[place]], draw=draw)
        self._tasks |= drawn
        return list(drawn.values())


def refuse(request: MomentRequest, options: Options) -> None:
    """Raise UsageError where not all runs of a spec whose moments are drawn would be done here."""
    for option, given in (("--shard", options.shard), ("-k", options.name_filter)):
        if request.wish.pool and given:
            raise UsageError(
                f"{option} leaves runs out, and with source.moments.draw: promising the runs before"
                " decide which are next: leave one of them out."
            )


def _worth(result: Result) -> float | None:
    """1 for a finding, 0 where nothing came near; None where no vehicle attacked."""
    if result["status"] != "ok" or not attacked(result):
        return None
    metrics = {name: one["value"] for name, one in result["metrics"].items()}
    if findings.finding(metrics):
        return 1.0
    return _NEAR * criticality(metrics[SPARE]) if SPARE in metrics else 0.0
