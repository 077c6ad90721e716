"""Results as tables: a row a run, an attack or a contact.

Whatever counts, averages or compares results takes its numbers from here. The columns are described
in docs/reference/python.md.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, Literal, get_args

import pandas as pd

from deepmf_sumo import plugins
from deepmf_sumo.errors import UsageError, nearest
from deepmf_sumo.results import findings, statistics
from deepmf_sumo.results.quantities import QUANTITIES
from deepmf_sumo.results.reader import HIT, Results, Run
from deepmf_sumo.results.result import COLUMNS, Result, attacked, known_of
from deepmf_sumo.results.setups import moment_of, setup_of
from deepmf_sumo.scene import DT_S

Kind = Literal["runs", "attacks", "contacts"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)

_NUMBERS: Final = frozenset(
    {"contact_time_s", "contact_speed_mps", "impact_sector", "opponent_score", "generation_s",
     "cycle_ms_median", "simulation_s", "budget_simulations", "budget_seconds", "simulations",
     "turns", "turn_hits", "feasible", "on_road"}
)  # fmt: skip
"""Columns of ``runs.csv`` that are numbers, beside the seed."""
_RUN: Final = ("folder", "run_id", "spec", "scene", "method", "planner_label", "seed")
"""What every table says of the run of a row."""
CONTACT: Final = (
    "time_s", "step", "kind", "first_id", "second_id", "striker_id", "relative_mps", "closing_mps",
    "delta_v_mps", "sector",
)  # fmt: skip
"""Keys of a contact in ``result.json`` that are columns, see `result.ContactValues`."""


def frame(results: Results, kind: Kind) -> pd.DataFrame:
    """See `Results.frame`."""
    if kind not in KINDS:
        hint = nearest(str(kind), KINDS) or f" Known: {', '.join(KINDS)}."
        raise UsageError(f"'{kind}' is not a kind of frame.{hint}")
    rows = [row for run in results.runs for row in _ROWS[kind](run)]
    metrics = plugins.names("metrics") if kind != "contacts" else ()
    return _typed(rows, (*_FIRST[kind], *metrics, *_LAST[kind]))


def _runs(run: Run) -> Iterator[dict[str, Any]]:
    yield run_row(run, run.result if run.has_result else None)


def run_row(run: Run, result: Result | None) -> dict[str, Any]:
    """The row of a run, by column; None where there is no value.

    ``result``: None where it is not there, or cannot be read: then the row is that of ``runs.csv``.
    """
    done = result is not None and run.status == "ok"
    has_hit = run.status == "ok" and run.hit
    has_opponent = run.status == "ok" and bool(run.row["opponent"])
    return {
        **_about(run),
        **_cells(run, result),
        "network": (result or run.row).get("network") or None,
        "part": run.part,
        "moment": moment_of(result) if result else "",
        "setup": digest_of(setup_of(result)) if result else "",
        "source": result.get("inputs", {}).get("source", "")[:16] if result else "",
        "ended": result.get("ended") if result else None,
        "attacked": has_opponent,
        "judged": has_opponent or (run.status == "ok" and run.adversary == "none"),
        "hit": has_hit,
        "worth": findings.said(run.worth if done else None) if has_hit else None,
        "wall_s": float(result["timings"]["wall_s"]) if result else None,
        "expectations_broken": tuple(result["expectations_broken"]) if result else (),
        **(run.values if done else {}),
        **(_quantities(result) if result and done else {}),
    }


def _quantities(result: Result) -> dict[str, float | None]:
    """But for the column of ``runs.csv``, which runs without an attack have, too."""
    return {one.name: one.of(result) for one in QUANTITIES if one.name not in COLUMNS}


def digest_of(setup: Mapping[str, Any]) -> str:
    """A short name of what makes an attack, see `setups.setup_of`."""
    return hashlib.sha256(json.dumps(setup, sort_keys=True).encode()).hexdigest()[:16]


def _about(run: Run) -> dict[str, Any]:
    known = (
        str(run.folder.parents[1]), run.run_id, run.row["spec"], run.scene, run.method,
        run.planner, run.seed,
    )  # fmt: skip
    return dict(zip(_RUN, known, strict=True))


def _cells(run: Run, result: Result | None) -> dict[str, Any]:
    """Those of ``runs.csv``; what tables of earlier versions lack is that of the result."""
    names = [name for name in COLUMNS if name not in _RUN]
    lack = result is not None and any(name not in run.row for name in names)
    more = known_of(result) if result is not None and lack else {}
    return {name: _cell_of(run, name) if name in run.row else more.get(name) for name in names}


def _cell_of(run: Run, name: str) -> Any:
    return run.number(name) if name in _NUMBERS else run.row[name]


def attacks_of(run: Run) -> Iterator[dict[str, Any]]:
    """Rows of its attacks: one, or one for each turn; none without a vehicle to attack with."""
    if run.status != "ok" or not run.has_result or not attacked(run.result):
        return
    for number, one in enumerate(_parts(run.result), start=1):
        metrics = one.pop("metrics")
        yield {
            **_about(run),
            "network": run.network,
            "turn": number if run.result["turns"] is not None else None,
            **one,
            "worth": findings.said(findings.worth(metrics)) if one["hit"] else None,
            **metrics,
        }


def _parts(result: Result) -> Iterator[dict[str, Any]]:
    turns = result["turns"]
    if turns is None:
        yield {
            "opponent": result["opponent"],
            "begin_s": 0.0,
            "end_s": round(result["steps"] * DT_S, 3),
            "ended": result["ended"],
            "outcome": result["outcome"],
            "hit": result["outcome"] == HIT,
            "metrics": {name: one["value"] for name, one in result["metrics"].items()},
        }
    for one in turns or ():
        names = ("opponent", "begin_s", "end_s", "ended", "outcome", "metrics")
        yield {name: one[name] for name in names} | {"hit": one["ended"] == "contact"}


def _contacts(run: Run) -> Iterator[dict[str, Any]]:
    for one in run.contacts:
        yield {**_about(run), **{name: one.get(name) for name in CONTACT}}


_ROWS: Final[Mapping[Kind, Callable[[Run], Iterator[dict[str, Any]]]]] = {
    "runs": _runs, "attacks": attacks_of, "contacts": _contacts,
}  # fmt: skip
_FIRST: Final[Mapping[Kind, tuple[str, ...]]] = {
    "runs": (*_RUN, *(name for name in COLUMNS if name not in _RUN), "network", "part", "attacked",
             "judged", "hit", "worth", *(one.name for one in QUANTITIES)),
    "attacks": (*_RUN, "network", "turn", "opponent", "begin_s", "end_s", "ended", "outcome", "hit",
                "worth"),
    "contacts": (*_RUN, *CONTACT),
}  # fmt: skip
_LAST: Final[Mapping[Kind, tuple[str, ...]]] = {
    "runs": ("moment", "setup", "source", "ended", "wall_s", "expectations_broken"),
    "attacks": (), "contacts": (),
}  # fmt: skip
"""Columns that are always there, also in a folder without runs: before and after the metrics."""


_TEXTS: Final = frozenset(
    {
        *_RUN,
        *COLUMNS,
        "network",
        "moment",
        "setup",
        "source",
        "ended",
        "worth",
        "expectations_broken",
        "kind",
        "first_id",
        "second_id",
        "striker_id",
    }
)
_TYPES: Final[Mapping[str, type]] = {
    **dict.fromkeys(_TEXTS - _NUMBERS, object),
    **dict.fromkeys(("seed", "step", "sector"), int),
    **dict.fromkeys(("attacked", "judged", "hit"), bool),
}  # fmt: skip
"""Of columns that are not decimal numbers."""


def _typed(rows: list[dict[str, Any]], first: tuple[str, ...]) -> pd.DataFrame:
    """All columns of all rows; an empty text is missing."""
    names = dict.fromkeys([*first, *(name for row in rows for name in row)])
    columns = {name: [_cell(row.get(name)) for row in rows] for name in names}
    return pd.DataFrame(
        {name: pd.Series(values, dtype=_TYPES.get(name, float)) for name, values in columns.items()}
    )


def _cell(value: Any) -> Any:
    return None if isinstance(value, str) and not value else value


def rows_of(table: pd.DataFrame) -> Iterator[Any]:
    """The rows, with the columns as attributes."""
    return iter(table.itertuples())


def rate(runs: pd.DataFrame, name: str) -> statistics.Interval:
    """The rate of a column of zeros and ones, of the runs of a frame that have a value.

    Runs of one spec and scene are one unit. Raises ValueError where no run has a value.
    """
    measured = runs[runs[name].notna()]
    units = zip(measured["spec"], measured["scene"], strict=True)
    values = zip(units, map(float, measured[name]), strict=True)
    return statistics.rate(statistics.by_unit(values))
