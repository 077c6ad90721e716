"""Rows -> ``ablation.csv`` with all figures, and ``ablation.md`` to read."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from deepmf_sumo.benchmark import files
from deepmf_sumo.benchmark.ablation.figures import MODES, Attacked, Estimate, Row
from deepmf_sumo.errors import OutputError

HEADINGS: Final = (
    "variant", "networks", "weights", "minutes", "minFDE6 m", "minFDE16 m", "minFDE32 m",
    "log lik. nats", "gain true", "gain shuffled", "cycle ms",
)  # fmt: skip
"""Then two for each planner: hits, and the opponent's RMS acceleration."""


def headings(planners: Sequence[str]) -> list[str]:
    """Of the readable table."""
    each = [heading for name in planners for heading in (f"{name}: hits", f"{name}: rms m/s2")]
    return [*HEADINGS, *each]


def cells(row: Row) -> list[str]:
    """A row of the readable table."""
    return [
        row.variant,
        row.networks,
        f"{row.weights:,}",
        f"{row.minutes:.1f}",
        *(_estimate(row.min_fde_m[modes], "{:.2f}") for modes in MODES),
        _estimate(row.log_likelihood, "{:.2f}"),
        _estimate(row.gain_true, "{:+.2f}"),
        _estimate(row.gain_shuffled, "{:+.2f}"),
        _number(row.cycle_ms, "{:.0f}"),
        *(cell for attacked in row.attacks for cell in _hits(attacked)),
    ]


def write(folder: Path, notes: Sequence[str], rows: Sequence[Row]) -> None:
    """Write both tables, the notes above the readable one. Raises OutputError."""
    planners = [attacked.planner for attacked in rows[0].attacks]
    lines = [_line(headings(planners)), _line(["---"] * len(headings(planners)))]
    lines += [_line(cells(row)) for row in rows]
    text = "\n\n".join(["# Ablation", *notes, "\n".join(lines)]) + "\n"
    try:
        files.write(folder / "ablation.md", text)
        files.write(folder / "ablation.csv", _csv(rows))
    except OSError as error:
        raise OutputError(f"{folder} cannot be written: {error.strerror}.") from None


def _csv(rows: Sequence[Row]) -> str:
    records = [_record(row) for row in rows]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(records[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return text.getvalue()


def _record(row: Row) -> dict[str, Any]:
    estimates = {
        **{f"min_fde_{modes}_m": row.min_fde_m[modes] for modes in MODES},
        "log_likelihood": row.log_likelihood,
        "gain_true": row.gain_true,
        "gain_shuffled": row.gain_shuffled,
    }
    record: dict[str, Any] = {
        "variant": row.variant,
        "networks": row.networks,
        "weights": row.weights,
        "training_minutes": round(row.minutes, 2),
        "marginal_steps": row.cards["marginal"]["steps_made"],
        "conditional_steps": row.cards["conditional"]["steps_made"],
        "objects": row.objects,
        "avs": row.avs,
    }
    for name, estimate in estimates.items():
        record |= {name: estimate.mean, f"{name}_standard_error": estimate.standard_error}
    record |= {"cycle_ms": _rounded(row.cycle_ms), "cycles": row.cycles}
    for one in row.attacks:
        rate = one.rate._asdict() if one.rate else dict.fromkeys(("rate", "low", "high"))
        values = {"runs": one.runs, "not_ok": one.not_ok, "hits": one.hits, **rate}
        values["rms_mps2"] = one.rms_mps2
        record |= {f"{one.planner} {name}": _rounded(value) for name, value in values.items()}
    return record


def _hits(attacked: Attacked) -> list[str]:
    runs = f"{attacked.hits}/{attacked.runs}"
    if attacked.not_ok:
        runs += f" ({attacked.not_ok} not ok)"
    if attacked.rate:
        rate = attacked.rate
        runs += f" = {rate.rate:.2f} ({rate.low:.2f} to {rate.high:.2f})"
    return [runs, _number(attacked.rms_mps2, "{:.2f}")]


def _estimate(estimate: Estimate, form: str) -> str:
    error = estimate.standard_error
    return _number(estimate.mean, form) + ("" if error is None else f" ± {error:.2f}")


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def _rounded(value: float | None) -> float | None:
    return round(value, 4) if isinstance(value, float) else value


def _line(values: Sequence[str]) -> str:
    return f"| {' | '.join(value.replace('|', '/') for value in values)} |"
