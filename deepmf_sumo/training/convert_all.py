"""Conversion of many scenes: one folder per scene, and a table of the results."""

import csv
import glob
import io
import re
import shutil
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Final, Literal, Protocol

from deepmf_sumo import files
from deepmf_sumo.errors import DeepmfError
from deepmf_sumo.scene import Scene
from deepmf_sumo.sumo.network.conversion import convert
from deepmf_sumo.texts import cell
from deepmf_sumo.training import processes

TABLE: Final = "convert.csv"
_AHEAD: Final = 2
"""Scenes read ahead per worker: enough to keep it busy, few enough for the memory."""


class RefusedRecord(Protocol):
    """A record that its reader rejected."""

    @property
    def name(self) -> str:
        """The scene's name, or empty."""
        ...

    @property
    def reason(self) -> str:
        """Why it could not be used."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class ConvertedScene:
    """One scene of the table; figures are None if there is no net."""

    scene: str
    status: Literal["ok", "failed"]
    reason: str = ""
    lanes: int | None = None
    lanes_lost: int | None = None
    connections: int | None = None
    connections_lost: int | None = None
    error_mean_m: float | None = None
    error_p99_m: float | None = None
    error_max_m: float | None = None
    seconds: float | None = None
    connections_bridged: int | None = None
    signals_lost: int | None = None
    ghost: bool | None = None
    folder: str = ""


def convert_all(
    scenes: Iterable[Scene | RefusedRecord], out: Path, jobs: int
) -> Iterator[ConvertedScene]:
    """Convert scenes into folders of ``out``; rows in the order of the scenes.

    A scene that fails is a row with the reason; the others continue. The table ``convert.csv`` is
    written when the iterator ends or is closed.

    Args:
        scenes: as readers give them.
        out: created if it is missing.
        jobs: worker processes; 1 converts in this one.

    Raises OutputError if ``out`` cannot be written.
    """
    with files.writing(out):
        out.mkdir(parents=True, exist_ok=True)
        files.write(out / TABLE, "")  # a folder that cannot be written shows now
    names = [field.name for field in fields(ConvertedScene)]
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(names)
    try:
        for row in _rows(scenes, out, jobs):
            table.writerow([_cell(getattr(row, name)) for name in names])
            yield row
    finally:
        files.write(out / TABLE, text.getvalue())


def _cell(value: object) -> object:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return cell(value)
    return f"{value:.4f}" if isinstance(value, float) else value


def _rows(
    scenes: Iterable[Scene | RefusedRecord], out: Path, jobs: int
) -> Iterator[ConvertedScene]:
    folders = _named(scenes, out)
    if jobs == 1:
        for scene, folder in folders:
            yield _row(scene, folder) if isinstance(scene, Scene) else _refusal(scene)
        return
    with processes.pool(jobs) as pool:
        waiting: deque[tuple[str, Future[ConvertedScene] | ConvertedScene]] = deque()
        for scene, folder in folders:
            if isinstance(scene, Scene):
                waiting.append((scene.name, pool.submit(_row, scene, folder)))
            else:
                waiting.append((scene.name, _refusal(scene)))
            while len(waiting) > jobs * _AHEAD:
                yield _result(*waiting.popleft())
        while waiting:
            yield _result(*waiting.popleft())


def _named(
    scenes: Iterable[Scene | RefusedRecord], out: Path
) -> Iterator[tuple[Scene | RefusedRecord, Path]]:
    """Each scene with its folder; scenes with the same name get numbers."""
    count: Counter[str] = Counter()
    used: set[str] = set()
    for scene in scenes:
        name = re.sub(r"[^\w.-]", "_", scene.name).lstrip(".") or "scene"
        count[name] += isinstance(scene, Scene)
        folder = name if count[name] <= 1 else f"{name}-{count[name]}"
        while folder in used:  # the name of another scene
            count[name] += 1
            folder = f"{name}-{count[name]}"
        if isinstance(scene, Scene):
            used.add(folder)
        yield scene, out / folder


def _result(name: str, result: Future[ConvertedScene] | ConvertedScene) -> ConvertedScene:
    if isinstance(result, ConvertedScene):
        return result
    try:
        return result.result()
    except BrokenProcessPool:
        return ConvertedScene(scene=name, status="failed", reason="the worker process died")


def _refusal(refused: RefusedRecord) -> ConvertedScene:
    return ConvertedScene(scene=refused.name, status="failed", reason=refused.reason)


def _row(scene: Scene, folder: Path) -> ConvertedScene:
    """Convert one scene; what a killed command has begun of its folder is removed."""
    for left in folder.parent.glob(f".{glob.escape(folder.name)}-{'?' * 8}"):
        shutil.rmtree(left, ignore_errors=True)
    try:
        net = convert(scene, folder)
    except DeepmfError as error:
        return ConvertedScene(scene=scene.name, status="failed", reason=str(error))
    except Exception as error:  # noqa: BLE001 (our own mistake must not end the batch)
        reason = f"unexpected {type(error).__name__}: {error}"
        return ConvertedScene(scene=scene.name, status="failed", reason=reason)
    report = net.report
    assert report is not None
    return ConvertedScene(
        scene=scene.name,
        status="ok",
        lanes=report.lanes,
        lanes_lost=len(report.lost_lanes),
        connections=report.connections,
        connections_lost=len(report.lost_connections),
        error_mean_m=report.error_mean_m,
        error_p99_m=report.error_p99_m,
        error_max_m=report.error_max_m,
        seconds=report.seconds,
        connections_bridged=len(report.bridged_connections),
        signals_lost=len(report.lost_signals),
        ghost=net.ghost_edge is not None,
        folder=folder.name,
    )
