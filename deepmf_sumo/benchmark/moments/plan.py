"""Moments -> tasks, as if each had been a spec."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any, Final
from zlib import crc32

from deepmf_sumo import files, tables
from deepmf_sumo.benchmark import batch, stored
from deepmf_sumo.benchmark.moments.choice import LONG_S
from deepmf_sumo.benchmark.moments.moment import Moment
from deepmf_sumo.benchmark.result import Result
from deepmf_sumo.benchmark.tasks import Task, moment_name, run_id_of
from deepmf_sumo.errors import UsageError
from deepmf_sumo.spec import Av, Plugin, Spec, of_document, takes_turns
from deepmf_sumo.spec.document import Document

MET: Final = "met"
"""The adversary's ``opponent`` that is whoever the AV is about to meet."""


def base_spec(
    config: Path,
    options: dict[str, Any],
    sets: Sequence[str],
    sumo_options: Sequence[str],
    name: str = "",
) -> Spec:
    """What all runs have in common; its AV and start are to be replaced.

    Args:
        config: the .sumocfg.
        options: keys of a spec and their values, as of the command line's options.
        sets: ``key=value`` over them.
        sumo_options: beside the configuration.
        name: what the runs are called after; the configuration's name where it is empty.

    In a long attack opponents take turns, unless the key ``opponents`` says something else, or the
    adversary looks for one attack, or is told whom to attack. Raises SpecError as `spec.load`,
    WeightsError where weights are named that are not there.
    """
    source = {
        "network": str(config.absolute()),
        "av": {"vehicle": "chosen"},
        "sumo_options": list(sumo_options),
    }
    values = {"version": 1, "name": name or config.stem, "source": source, **options}
    places: dict[Any, str] = {(key,): f"--{key.removesuffix('_s')}" for key in options}
    document = Document(file=Path("deepmf-sumo attack"), values=values, places=places)
    for assignment in sets:
        key = assignment.partition("=")[0].strip().partition(".")[0]
        if key == "source":
            raise UsageError(f"--set {assignment}: the source is chosen by the other options.")
        document.assign(assignment)
        places.setdefault((key,), f"--set {assignment}")
    spec = of_document(document)
    if "weights" in document.values:
        from deepmf_sumo.predictors import weights  # brings torch along

        weights.find(spec.weights)
    if spec.duration_s > LONG_S and "opponents" not in document.values and takes_turns(spec):
        return spec.model_copy(update={"opponents": "in_turn"})
    return spec


def attack(
    chosen: Sequence[tuple[Spec, Sequence[Moment]]],
    options: batch.Options,
    report: Callable[[batch.Progress], None],
) -> list[Result]:
    """Attack each moment, and write the result folder; ``moments.csv`` says where they are.

    Args:
        chosen: of each configuration what its runs have in common, and its moments.
        options: of the batch.
        report: is told of each run that is over.

    The configurations have names of their own, see `names_of`. Raises OutputError before anything
    runs.
    """
    tasks = [task for spec, moments in chosen for task in _tasks(spec, moments)]
    moments = [moment for _, found in chosen for moment in found]

    def tell(progress: batch.Progress) -> None:
        if progress.last is None:  # the folder is there by now, and empty
            files.write(options.out / stored.MOMENTS, _table(tasks, moments))
        report(progress)

    return batch.run_tasks(tasks, options, tell)


def _tasks(spec: Spec, moments: Sequence[Moment]) -> list[Task]:
    """One a moment, in order, with ids of their own.

    SUMO tells ``A1``, ``a1`` and ``a.1`` apart, but names of files do not: there a checksum does.
    """
    tasks = [_task(spec, one) for one in moments]
    times = Counter(task.run_id for task in tasks)
    return [
        task
        if times[task.run_id] == 1
        else replace(task, run_id=run_id_of(spec, _marked(task.scene)))
        for task in tasks
    ]


def _marked(scene: str) -> str:
    return f"{scene}-{crc32(scene.encode()):08x}"


def _task(spec: Spec, moment: Moment) -> Task:
    chosen = {"start_s": moment.start_s, "av": Av(vehicle=moment.av)}
    source = spec.source.model_copy(update=chosen)
    own = spec.model_copy(update={"source": source, "adversary": _against(spec, moment)})
    scene = moment_name(moment.av, moment.start_s)
    return Task(run_id=run_id_of(spec, scene), spec=own, scene=scene)


def _against(spec: Spec, moment: Moment) -> Plugin:
    """The adversary; ``opponent: met`` is whom the AV meets, else chosen as by default."""
    adversary = spec.adversary
    if not _of_met(spec):
        return adversary
    settings = {key: value for key, value in adversary.settings.items() if key != "opponent"}
    if moment.meets is not None:
        settings |= {"opponent": moment.meets}
    return Plugin(name=adversary.name, **settings)


def _of_met(spec: Spec) -> bool:
    return spec.adversary.settings.get("opponent") == MET


def _table(tasks: Sequence[Task], moments: Sequence[Moment]) -> str:
    rows = [
        {"run_id": task.run_id, **asdict(moment)}
        for task, moment in zip(tasks, moments, strict=True)
    ]
    names = ["run_id", *(field.name for field in fields(Moment))]
    return tables.to_csv(rows, names, cell=tables.exact)
