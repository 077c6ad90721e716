"""Specs -> tasks: one for every scene of a recording, one for a network."""

import hashlib
import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal
from zlib import crc32

import deepmf_sumo
from deepmf_sumo.errors import ReaderError, SpecError, UsageError, nearest
from deepmf_sumo.scene import readers
from deepmf_sumo.scene.readers import RecordRef
from deepmf_sumo.spec import First, FromMoments, FromNetwork, FromRecording, Spec

How = Literal["spread", "promising"]
Part = Literal["main", "budgets", "figures"]
"""``budgets``: what a method finds with other budgets than its own; ``figures``: in no table."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """The names of a run in tables.

    Attributes:
        method: how the attack is found, with the budget where that is not its own.
        planner: what drives the AV. part: of a plan.
        base: the method without the budget.
    """

    method: str
    planner: str
    part: Part = "main"
    base: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Draw:
    """How the moment of a run was drawn, where that depends on what others found.

    Attributes:
        drawn: ``spread``: one of the first, which are all attacked; ``promising``: at random.
        draw: its number, from 1.
        probability: of this one being drawn then, of those that were left; 1 if spread.
        pool: number of moments that all were drawn from.
    """

    drawn: How
    draw: int
    probability: float
    pool: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """One run.

    Attributes:
        run_id: ``<spec>--<scene>--<seed>``, safe as a file name, unique in a batch.
        scene: id in the recording; of a network its file name without suffix, or the moment.
        label: in a plan; None takes the names of spec and planner.
        inputs: what the files are for that it reads, and the digest of what is in them, see
            `inputs.fingerprinted`.
        record: where the scene is recorded; None of a network. Not part of `key`.
        draw: of its moment; None where all moments are spread, or given.
    """

    run_id: str
    spec: Spec
    scene: str
    label: Label | None = None
    inputs: tuple[tuple[str, str], ...] = ()
    record: RecordRef | None = field(default=None, compare=False)
    draw: Draw | None = None

    @property
    def key(self) -> str:
        """Digest of the spec, the files that it names and the version: of equal runs the same.

        Files count by content: where they are on this machine does not matter.
        """
        parts = [self.run_id, self.scene, deepmf_sumo.__version__, self.placeless(), self.inputs]
        parts += [asdict(self.draw)] if self.draw else []
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()

    def entropy(self) -> list[int]:
        """Seeds of the run's random generators: the same for every method and planner of a scene.

        So differences between methods are not those of random numbers, and a search with a larger
        budget begins as one with a smaller.
        """
        source, situation = self.spec.source, self.scene
        if isinstance(source, FromNetwork):
            situation = f"{source.network.stem} {source.start_s:.12g} {source.av.vehicle}"
        return [self.spec.seed, crc32(situation.encode())]

    def placeless(self) -> dict[str, Any]:
        """`resolved`, of files and folders the names alone."""
        values = self.resolved()
        named = {"network", "recording"} & values["source"].keys()
        places = [(values["source"], key) for key in named] + [(values, "weights")]
        places += [(values[key], "file") for key in ("planner", "adversary")]
        for of, key in places:
            if isinstance(of.get(key), str):
                of[key] = Path(of[key]).name
        return values

    def resolved(self) -> dict[str, Any]:
        """The spec of this run alone."""
        values = self.spec.resolved()
        if isinstance(self.spec.source, FromRecording):
            values["source"]["scenes"] = [self.scene]
        return values


def plan(
    specs: Sequence[Spec],
    cache: Path,
    name_filter: str = "",
    moments: Mapping[int, Sequence[Task]] | None = None,
) -> list[Task]:
    """All runs of the specs whose id holds ``name_filter``, in order.

    Specs of one name on a network, such as ``attack`` writes for its runs, are called after their
    moments. Raises SpecError where a recording holds no scene, or not the one asked for, or where
    two runs would have one id; UsageError where the filter leaves nothing.

    Args:
        specs: any.
        cache: keeps what is known of recordings.
        name_filter: empty leaves all runs.
        moments: runs of the specs whose moments are chosen (`FromMoments`), by index.
    """
    moments = moments or {}
    found = [
        list(moments[index]) if index in moments else list(_of(spec, cache))
        for index, spec in enumerate(specs)
    ]
    times = Counter(task.run_id for tasks in found for task in tasks)
    tasks: dict[str, Task] = {}
    for task in (_told_apart(task, times) for each in found for task in each):
        if task.run_id in tasks:
            raise SpecError(
                f"Two runs are called '{task.run_id}'; give the specs different names or seeds."
            )
        tasks[task.run_id] = task
    chosen = [task for task in tasks.values() if name_filter.lower() in task.run_id.lower()]
    if not chosen and (name_filter or not moments):
        raise UsageError(
            f"-k {name_filter} leaves none of {len(tasks)} runs; e.g. {next(iter(tasks), 'none')}."
        )
    return chosen


def _of(spec: Spec, cache: Path) -> Iterator[Task]:
    for scene, record in scenes(spec, cache):
        yield Task(run_id=run_id_of(spec, scene), spec=spec, scene=scene, record=record)


def _told_apart(task: Task, times: Mapping[str, int]) -> Task:
    """The task, called after its moment where another one has its id."""
    source = task.spec.source
    if times[task.run_id] == 1 or not isinstance(source, FromNetwork):
        return task
    scene = moment_name(source.av.vehicle, source.start_s)
    return replace(task, run_id=run_id_of(task.spec, scene), scene=scene)


def moment_name(av: str, start_s: float) -> str:
    """The name of the scene where a network is attacked at several moments."""
    return f"{av}-{start_s:.12g}s"


def run_id_of(spec: Spec, scene: str) -> str:
    """``<spec>--<scene>--<seed>``."""
    return "--".join([slug(spec.name), slug(scene), str(spec.seed)])


def is_run_id(text: object) -> bool:
    """Whether this can be the id of a run: letters, digits and dashes, at most 200 of them.

    Ids that are read from files become folders: anything else could name a folder elsewhere.
    """
    return isinstance(text, str) and re.fullmatch(r"[a-z0-9][a-z0-9-]{0,199}", text) is not None


def slug(name: str) -> str:
    """Lower-case letters, digits and single dashes; a checksum where that lost something."""
    plain = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:60].strip("-")
    spelled = re.sub(r"[\s_.-]+", "-", name.lower())
    return plain if plain and plain == spelled else f"{plain}-{crc32(name.encode()):08x}".strip("-")


def scenes(spec: Spec, cache: Path) -> Iterator[tuple[str, RecordRef | None]]:
    """Names of a spec's scenes, and where they are recorded (None of a network).

    Raises SpecError if there is none, or not the one asked for, and for moments that are to be
    chosen, which takes a simulation (`deepmf_sumo.study.moments`).
    """
    source = spec.source
    if isinstance(source, FromMoments):
        raise SpecError(
            f"spec '{spec.name}': key 'source.moments' is for `deepmf-sumo run`; give 'start_s' and"
            " 'av' here."
        )
    if isinstance(source, FromNetwork):
        yield source.network.stem, None
        return
    records: dict[str, RecordRef] = {}
    twice: dict[str, RecordRef] = {}
    try:
        for record in readers.records(source.recording, cache):
            if records.setdefault(record.name, record) is not record:
                twice.setdefault(record.name, record)
    except ReaderError as error:
        raise SpecError(f"spec '{spec.name}': {error}") from None
    if not records:
        raise SpecError(f"spec '{spec.name}': {source.recording} holds no recorded scene.")
    for scene in _chosen(source.scenes, records):
        if scene not in records:
            hint = nearest(scene, records)
            raise SpecError(f"spec '{spec.name}': {source.recording} has no scene '{scene}'.{hint}")
        if scene in twice:
            one, other = (found[scene].file for found in (records, twice))
            places = f"in {one} and in {other}" if one != other else f"twice in {one}"
            raise SpecError(
                f"spec '{spec.name}': {source.recording} has two scenes '{scene}', {places}, so"
                " that one would be lost; give a folder without one of them as 'source.recording',"
                " or other scenes in 'source.scenes'."
            )
        yield scene, records[scene]


def _chosen(
    scenes: Sequence[str] | First | Literal["all"], records: Mapping[str, RecordRef]
) -> Iterable[str]:
    if isinstance(scenes, First):
        return list(records)[: scenes.first]
    return records if scenes == "all" else scenes
