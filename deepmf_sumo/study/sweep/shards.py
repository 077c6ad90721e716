"""A batch in parts, each in a separate folder; and the parts joined, as if run in one piece.

Benchmarks have more to join than runs (`study.plans.run`); they share `Shard`.
"""

import re
import shutil
import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

import deepmf_sumo
from deepmf_sumo import files
from deepmf_sumo.errors import OutputError, UsageError
from deepmf_sumo.results import stored
from deepmf_sumo.results.folder import Store, opened
from deepmf_sumo.results.result import Result
from deepmf_sumo.spec.tasks import Task

FILE: Final = "shard.json"
_WAYS: Final = "--overwrite deletes them, another folder for OUT keeps them"
_WHOLE: Final = {stored.MOMENTS: stored.moments_of, stored.FLOW: stored.flows_of}
"""Tables that are complete in every part, and how each is read."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shard:
    """Every ``of``-th run, from the ``number``-th on (1 is the first)."""

    number: int
    of: int

    @classmethod
    def parse(cls, text: str) -> Self:
        """``2/8``. Raises UsageError."""
        match = re.fullmatch(r"(\d+)/(\d+)", text)
        if match and 1 <= int(match[1]) <= int(match[2]):
            return cls(number=int(match[1]), of=int(match[2]))
        raise UsageError(f"--shard {text}: must be i/n with 1 <= i <= n, e.g. 2/8.")

    def choose(self, tasks: Sequence[Task]) -> list[Task]:
        """Its tasks. In a plan's order these are scenes: every shard has every method.

        Raises UsageError where it has none, and others have.
        """
        chosen = list(tasks[self.number - 1 :: self.of])
        if tasks and not chosen:
            raise UsageError(f"There are {len(tasks)} runs: this shard of them is empty.")
        return chosen


def note(out: Path, every: Sequence[Task] | None) -> None:
    """Write into a part's folder the list of all runs, in order; None: it is not a part."""
    if every is None:
        (out / FILE).unlink(missing_ok=True)
        return
    runs = [[task.run_id, task.key] for task in every]
    files.write_json(out / FILE, {"version": deepmf_sumo.__version__, "runs": runs})


def merge(
    out: Path, shards: Sequence[Path], *, overwrite: bool = False
) -> tuple[list[Result], list[str]]:
    """Copy the runs of all parts into ``out``; returns their results and the ids of missing runs.

    ``overwrite`` deletes earlier results in ``out``; without it they are refused.

    Raises UsageError for folders of other batches or versions, that hold a run twice, or all of
    which have a damaged table of moments or flows, and OutputError.
    """
    runs = _common(shards)
    found = found_in(shards, runs)
    missing = [run_id for run_id in runs if run_id not in found]
    whole = {name: shard for name in _WHOLE if (shard := _having(name, shards)) is not None}
    junit_too = any((shard / "junit.xml").is_file() for shard in shards)
    with joining(out, shards, runs, found, overwrite=overwrite) as store:
        results = copied(store, shards, runs, found)
        for name, shard in whole.items():
            files.copy(shard / name, out / name)
        store.finish(results, junit_too=junit_too, interrupted=bool(missing))
    return results, missing


def _having(name: str, shards: Sequence[Path]) -> Path | None:
    """The first part that has a table, undamaged; None where no part has it.

    Raises UsageError where it is damaged in all.
    """
    having = [shard for shard in shards if (shard / name).is_file()]
    for shard in having:
        try:
            _WHOLE[name](shard)
        except UsageError:
            if shard == having[-1]:
                raise
        else:
            return shard
    return None


def of_benchmark(shard: Path) -> bool:
    """Whether `study.plans.run` joins a folder."""
    return (shard / "study.json").is_file()


def found_in(shards: Sequence[Path], runs: Mapping[str, str]) -> dict[str, Path]:
    """Folder of every run that is there. Raises UsageError for one that two shards have."""
    found: dict[str, Path] = {}
    for shard in shards:
        for run_id, key in runs.items():
            folder = stored.run_folder(shard, run_id, FILE)
            if not folder.is_dir() or Store(shard).read_run(run_id).get("key") != key:
                continue
            if run_id in found:
                raise UsageError(
                    f"The run {run_id} is in {found[run_id].parents[1]} and in {shard}; "
                    "give each shard once."
                )
            found[run_id] = folder
    return found


@contextmanager
def joining(
    out: Path,
    shards: Sequence[Path],
    runs: Iterable[str],
    found: Mapping[str, Path],
    *,
    overwrite: bool,
) -> Iterator[Store]:
    """A new result folder for what the shards hold.

    Raises UsageError where that would lose runs, even with ``overwrite``: a user who forgets OUT
    gives the first shard in its position. Raises OutputError as `opened`.
    """
    if out.resolve() in {shard.resolve() for shard in shards}:
        raise UsageError(f"{out} is one of the shards; choose another folder for OUT.")
    lost = [run_id for run_id in runs if run_id not in found and (out / "runs" / run_id).is_dir()]
    if lost:
        raise UsageError(
            f"{out} holds {len(lost)} runs that no shard has, e.g. {lost[0]}, and would lose them;"
            " give it as a shard, and another folder for OUT."
        )
    with opened(out, resume=False, overwrite=overwrite, ways=_WAYS) as store:
        yield store


def copied(
    store: Store, shards: Sequence[Path], runs: Mapping[str, str], found: Mapping[str, Path]
) -> list[Result]:
    """Copy the runs that are there into a new result folder; their results in order.

    The manifest names all runs, so that those that no shard has are known to be missing.
    """
    there = [run_id for run_id in runs if run_id in found]
    read = {path: digest for shard in shards for path, digest in stored.inputs_of(shard).items()}
    planned = {run_id: one for shard in shards for run_id, one in stored.planned_of(shard).items()}
    # first, so that --overwrite knows the folder if this is killed
    store.manifest(runs, {"shards": [str(shard) for shard in shards], "inputs": read}, planned)
    try:
        for run_id in there:
            beside = store.runs / f".{run_id}.partial"
            _check_plain(found[run_id])
            shutil.copytree(found[run_id], beside)
            beside.replace(store.runs / run_id)
    except OSError as error:
        raise OutputError(f"{store.out} cannot be written: {error.strerror or error}.") from None
    return [store.read_run(run_id) for run_id in there]


def _check_plain(folder: Path) -> None:
    """Raise UsageError where a folder is or contains anything but files and folders.

    A link would copy files from elsewhere, and reading a device or pipe never ends.
    """
    for path in (folder, *folder.rglob("*")):
        mode = path.lstat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise UsageError(
                f"{path} is a link, a device or a pipe; a run has files and folders alone: remove"
                " it, or run that shard again."
            )


def _common(shards: Sequence[Path]) -> dict[str, str]:
    """Run id -> key of all runs, of which each folder is to be a part."""
    first = _read(shards[0])
    for shard in shards[1:]:
        if _read(shard) != first:
            raise UsageError(
                f"{shard} belongs to other runs than {shards[0]}; merge shards of the same"
                " command, with only --shard changed."
            )
    return dict(first)


def _read(shard: Path) -> list[tuple[str, str]]:
    file = shard / FILE
    if not file.exists():
        raise UsageError(f"{shard} is not a shard: it has no {FILE}, which --shard writes.")
    try:
        values = stored.mapping(file, again="run that shard again")
        version, runs = values["version"], [(str(run), str(key)) for run, key in values["runs"]]
    except (ValueError, KeyError, TypeError) as error:
        raise UsageError(f"{file} is damaged ({error}); run that shard again.") from None
    if version != deepmf_sumo.__version__:
        raise UsageError(
            f"{shard} was made by version {version} of deepmf-sumo, and this is"
            f" {deepmf_sumo.__version__}: run that shard again, or merge with that version."
        )
    for run_id, _ in runs:
        stored.run_folder(shard, run_id, FILE)
    return runs
