"""Two results side by side -> tables of text, CSV and Markdown."""

from pathlib import Path
from typing import Any, Final

from deepmf_sumo import files, tables
from deepmf_sumo.errors import OutputError
from deepmf_sumo.report.table import SECTORS, counted
from deepmf_sumo.results.changes import QuantityChange
from deepmf_sumo.results.gate.verdict import difference, figure
from deepmf_sumo.results.matching import Matched
from deepmf_sumo.results.quantities import RATE
from deepmf_sumo.results.risk.origins import HitOrigin
from deepmf_sumo.results.risk.two_sides import Compared

DIFFERENCES, ORIGINS, TEXT = "differences.csv", "origins.csv", "comparison.md"
_MADE: Final = {DIFFERENCES, ORIGINS, TEXT}
DIFFERENCE_HEADINGS: Final = ("quantity", "A", "B", "B - A", "")
ORIGIN_HEADINGS: Final = ("where hits come from", "A", "B", "B - A of all runs", "")


def write(out: Path, compared: Compared, names: tuple[str, str]) -> None:
    """Write the folder: two tables, and both as Markdown. Raises OutputError."""
    with files.writing(out):
        out.mkdir(parents=True, exist_ok=True)
        others = {path.name for path in out.iterdir() if not path.name.startswith(".")} - _MADE
        if others:
            raise OutputError(f"{out} holds '{min(others)}'; choose an empty folder for --out.")
        files.write(out / DIFFERENCES, tables.to_csv(difference_rows(compared)))
        files.write(out / ORIGINS, tables.to_csv(_origin_rows(compared)))
        files.write(out / TEXT, markdown(compared, names))


def markdown(compared: Compared, names: tuple[str, str]) -> str:
    """What was compared, both tables, and what to know before trusting them."""
    lines = ["## deepmf-sumo compare", "", *(f"{line}  " for line in heading(compared, names)), ""]
    lines += tables.to_markdown(DIFFERENCE_HEADINGS, differences(compared))
    if compared.origins:
        lines += ["", *tables.to_markdown(ORIGIN_HEADINGS, origins(compared))]
    lines += [f"\n{note}." for note in compared.notes]
    return "\n".join(lines) + "\n"


def heading(compared: Compared, sides: tuple[str, str]) -> list[str]:
    """Which is A, which is B, and what is different on purpose: names of equal values together."""
    lines = [
        f"{letter}: {name}, {counted(runs, 'run')}"
        for letter, name, runs in zip("AB", sides, compared.runs, strict=True)
    ]
    lines.append(f"{counted(compared.pairs, 'pair')} of the same moment and seed")
    alike: dict[tuple[tuple[str, ...], tuple[str, ...]], list[str]] = {}
    for name, values in compared.differs.items():
        alike.setdefault(values, []).append(name)
    lines += [
        f"{', '.join(names)}: {', '.join(was)} in A, {', '.join(now)} in B"
        for (was, now), names in alike.items()
    ]
    return lines


def differences(compared: Compared) -> list[tuple[str, ...]]:
    """Cells of the table of differences."""
    return [
        (
            one.quantity,
            *(_figure(end, one.unit) for end in (one.found.old, one.found.new)),
            difference(one.found),
            _state(one, _unit(compared)),
        )
        for one in compared.differences
    ]


def _unit(compared: Compared) -> str:
    """What the runs of both sides are independent by; of one unit alone it is not known."""
    several = [one.found.specs for one in compared.differences if one.found.units > 1]
    return "spec" if several and all(several) else "attacked moment"


def _state(one: QuantityChange, unit: str) -> str:
    """What the interval says: the margin that it lies in, or how many would tell."""
    if one.state == "within margin":
        return f"at most {figure(one.margin, one.unit)} apart"
    return _undecided(one, unit) if one.state == "cannot tell" else one.state


def _undecided(one: QuantityChange | HitOrigin, unit: str) -> str:
    """With about how many attacks would decide, where that can be told."""
    if not one.needed:
        return "cannot tell"
    least = "at least" if one.found.units < one.found.fewest else "about"
    return f"cannot tell; {least} {counted(one.needed, unit)} would"


def origins(compared: Compared) -> list[tuple[str, ...]]:
    """Cells of the table of origins."""
    return [
        (
            f"{one.dimension}: {_value(one)}",
            *(f"{hits} of {runs}" for hits, runs in zip(one.hits, one.runs, strict=True)),
            _shift(one.found),
            _origin_state(one, _unit(compared)),
        )
        for one in compared.origins
    ]


def _origin_state(one: HitOrigin, unit: str) -> str:
    if one.state == "within margin":
        return f"at most {RATE:g} apart"
    return _undecided(one, unit) if one.state == "cannot tell" else one.state


def _value(one: HitOrigin) -> str:
    return SECTORS[int(one.value)] if one.dimension == "sector" else one.value


def _figure(value: float | None, unit: str) -> str:
    return "-" if value is None else figure(value, unit)


def _shift(found: Matched) -> str:
    if found.difference is None:
        return "-"
    mean, low, high = found.difference
    if low is None or high is None:
        return f"{mean:+.3f}"
    return f"{mean:+.3f} ({low:+.3f} to {high:+.3f})"


def difference_rows(compared: Compared) -> list[dict[str, Any]]:
    """The table of differences, as numbers by column."""
    return [
        {
            "quantity": one.quantity,
            "unit": one.unit,
            "a": one.found.old,
            "b": one.found.new,
            **_interval(one.found),
            "state": one.state,
            "margin": one.margin,
            "units": one.found.units,
            "units_needed": one.needed,
        }
        for one in compared.differences
    ]


def _origin_rows(compared: Compared) -> list[dict[str, Any]]:
    return [
        {
            "dimension": one.dimension,
            "value": _value(one),
            "a_hits": one.hits[0],
            "a_runs": one.runs[0],
            "b_hits": one.hits[1],
            "b_runs": one.runs[1],
            **_interval(one.found),
            "state": one.state,
            "units": one.found.units,
            "units_needed": one.needed,
        }
        for one in compared.origins
    ]


def _interval(found: Matched) -> dict[str, Any]:
    mean, low, high = found.difference or (None, None, None)
    return {
        "difference": mean,
        "difference_lo": low,
        "difference_hi": high,
        "compared_by": found.by,
        "count": found.count,
    }
