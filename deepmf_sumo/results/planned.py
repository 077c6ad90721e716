"""The runs that a result folder's manifest plans, whether they have ended or not.

Tables of ended runs (`Results.open`) say nothing of those that are missing. Whoever judges a
planner has to know of them.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

from deepmf_sumo.results import stored
from deepmf_sumo.results.reader import MISSING, Results, Run
from deepmf_sumo.results.result import COLUMNS
from deepmf_sumo.spec.tasks import slug

_REASON: Final = "the run has no result: it was not started, or interrupted"


def read(out: Path) -> Results:
    """The runs of a folder's manifest in its order, without those of other budgets and figures.

    A run without a result has the status ``missing``; a result of an earlier batch does not count.
    ``runs.csv`` is not needed. Raises UsageError where a file cannot be read.
    """
    known = stored.planned_of(out)
    found: dict[str, Run | None] = {}
    for run_id, key in stored.keys_of(out).items():
        file = stored.run_folder(out, run_id, stored.MANIFEST) / stored.RESULT
        result = stored.result_of(file) if file.is_file() else None
        if result is not None and result["key"] != key:
            result = None
        part = result["part"] if result else known.get(run_id, {}).get("part", "main")
        if part == "main":
            found[run_id] = None if result is None else Run.of_result(out, result)
    ended = [run for run in found.values() if run is not None]
    runs = (
        run or _missing(out, run_id, known.get(run_id) or _guessed(run_id, ended))
        for run_id, run in found.items()
    )
    return Results(folders=(out,), runs=tuple(runs))


def _missing(out: Path, run_id: str, known: Mapping[str, Any]) -> Run:
    row = dict.fromkeys(COLUMNS, "") | {
        **{name: str(value or "") for name, value in known.items()},
        "run_id": run_id,
        "seed": str(known["seed"]),
        "status": MISSING,
        "error": _REASON,
    }
    return Run.of_row(out, row)


def _guessed(run_id: str, others: Iterable[Run]) -> dict[str, Any]:
    """What the id of a run says of it, where an earlier version wrote the manifest.

    Ids are in small letters and dashes: names are as in the runs of the same spec, if there are
    any, and network and planner where all of these have the same.
    """
    spec, scene, seed = [*run_id.rsplit("--", 2), "", ""][:3]
    of_spec = [run for run in others if slug(run.row["spec"]) == spec]

    def common(values: Iterable[str | None], otherwise: str) -> str:
        found = set(values)
        return found.pop() or otherwise if len(found) == 1 else otherwise

    return {
        "spec": common((run.row["spec"] for run in of_spec), spec),
        "scene": scene,
        "network": common((run.network for run in of_spec), scene),
        "seed": int(seed) if seed.isdecimal() else 0,
        "method": common((run.method for run in of_spec), ""),
        "planner_label": common((run.planner for run in of_spec), ""),
    }
