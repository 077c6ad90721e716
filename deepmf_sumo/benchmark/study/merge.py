"""Folders of shards -> one folder, as if the plan had been run in one piece."""

import os
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from deepmf_sumo.benchmark import shards
from deepmf_sumo.benchmark.result import Result
from deepmf_sumo.benchmark.study import layout, tables
from deepmf_sumo.benchmark.study.layout import Layout
from deepmf_sumo.errors import UsageError


def merge(
    out: Path, folders: Sequence[Path], *, overwrite: bool = False
) -> tuple[list[Result], list[str]]:
    """Copy the runs of all shards into ``out``; returns their results and the ids of missing runs.

    Runs that are not there yet are no rows: `benchmark --resume` in ``out`` makes them. Raises
    UsageError for folders of other plans or versions, or that hold a run twice, and OutputError.
    """
    plan = _common(folders)
    found = shards.found_in(folders, plan.runs)
    missing = [run_id for run_id in plan.runs if run_id not in found]
    with shards.joining(out, folders, plan.runs, found, overwrite=overwrite) as store:
        results = shards.copied(store, folders, plan.runs, found)
        plan.write(out)
        store.finish(
            results,
            junit_too=any((folder / "junit.xml").is_file() for folder in folders),
            interrupted=bool(missing),
        )
        tables.write(out)
    return results, missing


def _common(folders: Sequence[Path]) -> Layout:
    """The plan of all shards. Raises UsageError where they differ."""
    first = layout.read(folders[0])
    plan = _placeless(first)
    for folder in folders[1:]:
        other = _placeless(layout.read(folder))
        if other != plan:
            names = (field.name for field in fields(Layout))
            key = next(name for name in names if getattr(plan, name) != getattr(other, name))
            raise UsageError(
                f"{folder} is of another plan than {folders[0]} (they differ in '{key}'); "
                "merge shards of one plan, run on one set of scenes."
            )
    return first


def _placeless(plan: Layout) -> Layout:
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


__all__ = ["merge"]
