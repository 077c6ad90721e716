"""Runs of result folders in formats of other programs: what is written, what is not, and why."""

import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal, get_args

from deepmf_sumo import files, plugins
from deepmf_sumo.errors import OutputError, RunError, UsageError
from deepmf_sumo.exporters.base import Exportable, Exporter, NetFiles, RunRoad, signals_of
from deepmf_sumo.results import result, stored, tracks
from deepmf_sumo.results.findings import said
from deepmf_sumo.results.reader import Results, Run
from deepmf_sumo.scene import ROLLOUT, Source
from deepmf_sumo.sumo import network

Only = Literal["hits", "findings"]
ONLY: Final[tuple[Only, ...]] = get_args(Only)
Outcome = Literal["written", "left out", "failed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """A format by its name, with its settings."""

    name: str
    exporter: Exporter
    settings: Any

    @classmethod
    def named(cls, name: str, values: dict[str, str] | None = None) -> "Format":
        """Raises PluginError for a name or settings, given as texts, that are not known.

        Also where the exporter's ``check()`` does, e.g. for an extra that is not installed.
        """
        exporter = plugins.load("exporters", name)
        if hasattr(exporter, "check"):
            exporter.check()
        settings = plugins.settings("exporters", name, values or {}, texts=True)
        return cls(name=name, exporter=exporter, settings=settings)

    def place(self, folder: Path) -> Path:
        """Where a run is written, in the run's folder or in one of its name elsewhere."""
        return folder / self.exporter.FILE.rstrip("/")


@dataclass(frozen=True, slots=True, kw_only=True)
class Export:
    """What became of a run.

    Attributes:
        path: what was written, or would have been.
        reason: why it was left out or failed; of a written one what differs from the run.
    """

    run_id: str
    path: Path
    outcome: Outcome
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Chosen:
    """A run, and its folder below another root: ``runs/RUN_ID``, or ``OUT/runs/RUN_ID`` of several.

    ``run`` is None where it has not ended, with its ``run_id`` alone.
    """

    run_id: str
    run: Run | None
    folder: Path
    mirrored: Path


def chosen(folders: Sequence[Path]) -> list[Chosen]:
    """All runs of run folders and result folders, in order.

    Raises UsageError where a folder is neither, or is damaged, and where one is given twice.
    """
    found: list[Chosen] = []
    several = len(folders) > 1
    for folder in folders:
        if (folder / stored.RESULT).is_file():
            run = run_in(folder)
            name = Path(folder.resolve().name)
            found.append(Chosen(run_id=run.run_id, run=run, folder=folder, mirrored=name))
        else:
            found += _of_results(Results.open(folder), several)
    places = [one.mirrored for one in found]
    twice = next((one for one in places if places.count(one) > 1), None) if several else None
    if twice is not None:
        raise UsageError(f"{twice} is there twice: give each folder once, or export them apart.")
    return found


def run_in(folder: Path) -> Run:
    """The run of a run's folder. Raises UsageError where its ``result.json`` is damaged."""
    found = stored.result_of(folder / stored.RESULT)
    return replace(Run.of_row(folder.parent, result.row(found)), folder=folder)


def _of_results(results: Results, several: bool) -> Iterator[Chosen]:
    several = several or len(results.folders) > 1
    for out in results.folders:
        below = Path(out.resolve().name) if several else Path()
        one = Results.of(out)
        for run in one.runs:
            mirrored = below / "runs" / run.run_id
            yield Chosen(run_id=run.run_id, run=run, folder=run.folder, mirrored=mirrored)
        for run_id in one.missing:
            folder = out / "runs" / run_id
            yield Chosen(run_id=run_id, run=None, folder=folder, mirrored=below / "runs" / run_id)


def export(
    runs: Iterable[Chosen],
    form: Format,
    *,
    out: Path | None = None,
    only: Only | None = None,
    overwrite: bool = False,
) -> Iterator[Export]:
    """Write each run that is asked for; a run that cannot be written does not end the others.

    ``out``: write below this folder, not into the runs' own. Raises OutputError before anything is
    written where a file is there already and ``overwrite`` does not allow to replace it.
    """
    tasks = [
        (one, form.place(out / one.mirrored if out else one.folder), left_out(one.run, only))
        for one in runs
    ]
    there = [path for _, path, reason in tasks if not reason and path.exists()]
    if there and not overwrite:
        raise OutputError(
            f"{there[0]} is there already ({len(there)} of {len(tasks)} runs): give --overwrite to"
            " replace it, or another --out."
        )
    return (_exported(one, path, reason, form) for one, path, reason in tasks)


def _exported(one: Chosen, path: Path, reason: str, form: Format) -> Export:
    if reason or one.run is None:
        return Export(run_id=one.run_id, path=path, outcome="left out", reason=reason)
    return written(one.run, path, form)


def written(run: Run, path: Path, form: Format) -> Export:
    """Write one run to ``path``; a failure is an `Export` with its reason, and leaves nothing."""
    made = [one for one in (path, *path.parents) if not one.exists()]
    try:
        with files.writing(path.parent):
            path.parent.mkdir(parents=True, exist_ok=True)
        content = exportable(run)
        form.exporter.write(content, path, form.settings)
        lost = content.around.lost if "around" in vars(content) else ""
    except Exception as error:  # noqa: BLE001 - a plug-in may raise anything
        _removed(made)
        return Export(run_id=run.run_id, path=path, outcome="failed", reason=_said(run, error))
    return Export(run_id=run.run_id, path=path, outcome="written", reason=lost)


def _removed(made: Sequence[Path]) -> None:
    """Remove what a failed export has made: its file or folder, and folders that are empty."""
    for one in made:
        with suppress(OSError):  # another export has written into it meanwhile
            if one is made[0] and one.is_dir():
                shutil.rmtree(one)
            elif one.is_dir():
                one.rmdir()
            else:
                one.unlink()


def left_out(run: Run | None, only: Only | None) -> str:
    """Why a run is not written, as a sentence without its full stop; empty if it is."""
    if run is None:
        return "it has not ended"
    if run.status != "ok":
        return f"it has no result ({run.status})"
    if only and not run.hit:
        return "the opponent did not hit the AV"
    if not run.recorded:
        return f"it has no {tracks.FILE}"
    return _other_hit(run) if only == "findings" else ""


def _other_hit(run: Run) -> str:
    try:
        worth = run.worth
    except UsageError as error:
        return str(error).rstrip(".")
    return "" if worth and worth.finding else f"the hit is no finding ({said(worth)})"


def exportable(run: Run) -> Exportable:
    """A stored run. Raises `stored.DAMAGE`.

    Poses are those of ``tracks.csv.gz``: to 0.1 mm, velocities along the headings, heights of
    vehicles unknown (0).
    """
    rollout = run.rollout
    simulated = rollout.tracks.steps - 1 - rollout.now
    return Exportable(
        name=run.run_id,
        rollout=rollout,
        duration_steps=max(run.result["duration_steps"], simulated),
        look=lambda: _around(run),
        find_net=lambda: _net(run),
        made=tuple(one["id"] for one in run.result.get("made", [])),
    )


def _around(run: Run) -> RunRoad:
    road, lost = run.road()
    scene = None if lost else run.recording()
    if scene is not None:
        source = replace(scene.source, dataset=ROLLOUT)
        return RunRoad(road=road, source=source, signals=scene.signals)
    named = run.source.get("recording") or run.source.get("network") or run.result["network"]
    source = Source(dataset=ROLLOUT, file=str(named), record=0, sha256="")
    signals = None if lost else signals_of(run.rollout, road)
    return RunRoad(road=road, source=source, signals=signals, lost=lost)


def _net(run: Run) -> NetFiles:
    """That in the run's folder; else that of the recording, converted again where need be."""
    kept = stored.net_file(run.folder)
    if kept is not None:
        return NetFiles(net=kept, additional=stored.map_file(run.folder))
    scene = run.recording()
    if scene is None:
        raise UsageError(f"{run.folder}/sumo holds no net.net.xml; run it again.")
    found = network.cached(scene, files.cache_folder() / "nets")
    return NetFiles(net=found.file, additional=found.additional)


def _said(run: Run, error: BaseException) -> str:
    """A sentence; what is raised for damaged files does not name them."""
    if isinstance(error, UsageError | RunError):
        return " ".join(str(error).split()).rstrip(".")
    return f"{run.folder} cannot be exported: {type(error).__name__}: {error}".rstrip(".")
