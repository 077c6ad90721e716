"""Folders of shards -> one folder, as if the plan had been run in one piece."""

import shutil
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

from deepmf_sumo.benchmark.result import Result
from deepmf_sumo.benchmark.store import Store, open_folder
from deepmf_sumo.benchmark.study import layout, tables
from deepmf_sumo.benchmark.study.layout import Layout
from deepmf_sumo.errors import OutputError, UsageError


def merge(out: Path, shards: Sequence[Path]) -> tuple[list[Result], list[str]]:
    """Copy the runs of all shards into ``out``; returns their results and the ids of missing runs.

    Runs that are not there yet are no rows: `benchmark --resume` in ``out`` makes them. Raises
    UsageError for folders of other plans or versions, or that hold a run twice, and OutputError.
    """
    plan = _common(shards)
    found = _found(plan, shards)
    if out.resolve() in {shard.resolve() for shard in shards}:
        raise UsageError(f"{out} is one of the shards; choose another folder for OUT.")
    store = open_folder(out, resume=False)
    keys = {run_id: key for run_id, key in plan.runs.items() if run_id in found}
    try:
        for run_id in keys:
            beside = store.runs / f".{run_id}.partial"
            shutil.copytree(found[run_id], beside)
            beside.replace(store.runs / run_id)
    except OSError as error:
        raise OutputError(f"{out} cannot be written: {error.strerror or error}.") from None
    plan.write(out)
    store.manifest(keys, {"shards": [str(shard) for shard in shards]})
    results = [store.read_run(run_id) for run_id in keys]
    missing = [run_id for run_id in plan.runs if run_id not in found]
    store.finish(
        results,
        junit_too=any((shard / "junit.xml").is_file() for shard in shards),
        interrupted=bool(missing),
    )
    tables.write(out)
    return results, missing


def _common(shards: Sequence[Path]) -> Layout:
    """The plan of all shards. Raises UsageError where they differ."""
    first = layout.read(shards[0])
    for shard in shards[1:]:
        other = layout.read(shard)
        if other != first:
            names = (field.name for field in fields(Layout))
            key = next(name for name in names if getattr(first, name) != getattr(other, name))
            raise UsageError(
                f"{shard} is of another plan than {shards[0]} (they differ in '{key}'); "
                "merge shards of one plan, run on one set of scenes."
            )
    return first


def _found(plan: Layout, shards: Sequence[Path]) -> dict[str, Path]:
    """Folder of every run that is there. Raises UsageError for one that two shards have."""
    found: dict[str, Path] = {}
    for shard in shards:
        for run_id in plan.runs:
            folder = shard / "runs" / run_id
            if not folder.is_dir() or Store(shard).read_run(run_id)["key"] != plan.runs[run_id]:
                continue
            if run_id in found:
                raise UsageError(
                    f"The run {run_id} is in {found[run_id].parents[1]} and in {shard}; "
                    "give each shard once."
                )
            found[run_id] = folder
    return found


__all__ = ["merge"]
