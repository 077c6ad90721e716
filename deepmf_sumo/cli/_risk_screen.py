"""What commands show of risk maps, evidence and their differences.

Imports inside functions: help and short commands load nothing that they do not show.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from deepmf_sumo.cli._screen import escape, filled, plain_grid, wide

if TYPE_CHECKING:
    from deepmf_sumo.report.risk import Written
    from deepmf_sumo.results.risk.attacks import Network
    from deepmf_sumo.results.risk.coverage import EvidenceCell
    from deepmf_sumo.results.risk.kinds import TypeRow
    from deepmf_sumo.results.risk.table import PlaceRow
    from deepmf_sumo.results.risk.two_sides import Compared

_HEADINGS: Final = (
    "where attacks were decided", "attacks", "hits", "findings", "least TTC",
    "mean delta-v", "risk of a hit (90 % interval)",
)  # fmt: skip
_KIND_HEADINGS: Final = (
    "kind of conflict", "attacks", "hits", "findings", "least TTC", "least PET",
    "mean delta-v",
)  # fmt: skip
_MOST: Final = 30
_TOP: Final = 10
"""Places on the screen; all of them are in the tables."""


def show_risk(written: Sequence[Written]) -> None:
    """One table for each network: movements and edges, by the lower end of the risk of a hit."""
    from deepmf_sumo.results.risk.kinds import by_type
    from deepmf_sumo.results.risk.table import worst

    console = wide()
    for one in written:
        network = one.network
        head = f"{_counted_on(network)}{_overall(network)}"
        console.print(escape(head), soft_wrap=True)
        console.print(filled(_HEADINGS, [_cells(row) for row in worst(one.rows)[:_TOP]]))
        console.print(
            filled(_KIND_HEADINGS, [_kind_cells(row) for row in by_type(network.attacks)])
        )
        listed = ("risk.csv", "attacks.csv", "types.csv", "coverage.csv", "risk.sumocfg", *one.more)
        files = f"{one.folder}/risk.html, {', '.join(listed)}"
        console.print(escape(files), soft_wrap=True)


def _overall(network: Network) -> str:
    """The rate of hits over all moments that the attacked ones were drawn from, if they were."""
    from deepmf_sumo.results.risk.table import rate

    if all(one.weight == 1.0 for one in network.attacks):
        return ""
    hits = rate(network.attacks)
    return (
        "; moments were drawn where conflicts came near, and rates count each for those that it was"
        f" drawn from: hits {100 * hits.rate:.0f} % ({100 * hits.low:.0f} to"
        f" {100 * hits.high:.0f} %)"
    )


def show_coverage(found: Sequence[tuple[Network, Sequence[EvidenceCell]]]) -> None:
    """The four tables of evidence of each network."""
    from deepmf_sumo.report import evidence
    from deepmf_sumo.results.risk.coverage import TABLES

    console = wide()
    for network, cells in found:
        console.print(escape(_counted_on(network)), soft_wrap=True)
        for table, title in TABLES.items():
            console.print()
            console.print(escape(title), style="bold", soft_wrap=True)
            rows = [evidence.row(one) for one in cells if one.table == table]
            grid = plain_grid(evidence.HEADINGS[:1], evidence.HEADINGS[1:-1])
            grid.add_column(escape(evidence.HEADINGS[-1]), overflow="fold")
            for row in rows:
                grid.add_row(*map(escape, row))
            console.print(grid)
        console.print()
        console.print(escape(evidence.NOTE), soft_wrap=True)


def _counted_on(network: Network) -> str:
    """The attacks on a network, the runs that do not count, and hits judged without a ladder."""
    from deepmf_sumo.report.table import counted
    from deepmf_sumo.results.findings import earlier_note

    left = "".join(
        f"; not counted: {counted(count, 'run')} {why}" for why, count in network.left_out.items()
    )
    hits = [one.worth for one in network.attacks if one.hit]
    old = earlier_note(sum(one is not None and one.rung is None for one in hits), len(hits))
    return f"{network.name}: {counted(len(network.attacks), 'attack')}{left}{'; ' * bool(old)}{old}"


def show_comparison(compared: Compared, names: tuple[str, str]) -> None:
    """What was compared, the differences, where they come from, and what to know."""
    from deepmf_sumo.report.risk import two_sides

    console = wide()
    for line in two_sides.heading(compared, names):
        console.print(escape(line), soft_wrap=True)
    console.print(filled(two_sides.DIFFERENCE_HEADINGS, two_sides.differences(compared)))
    if compared.origins:
        shown = two_sides.origins(compared)
        console.print(filled(two_sides.ORIGIN_HEADINGS, shown[:_MOST]))
        if len(shown) > _MOST:
            console.print(f"and {len(shown) - _MOST} more with --out")
    for note in compared.notes:
        console.print(escape(note), soft_wrap=True)


def _cells(row: PlaceRow) -> tuple[str, ...]:
    risk = row.risk["hit"]
    speed = None if row.delta_v_mps is None else f"{row.delta_v_mps:.1f} m/s"
    return (
        row.title if row.kind == "movement" else f"{row.kind} {row.title}",
        str(row.attacks),
        str(row.events["hit"]),
        f"{row.events['finding']} of {row.judged}",
        _ttc(row.ttc_s),
        speed or "-",
        f"{100 * risk.rate:.0f} % ({100 * risk.low:.0f} to {100 * risk.high:.0f} %)",
    )


def _kind_cells(row: TypeRow) -> tuple[str, ...]:
    pet = "-" if row.least_pet_s is None else f"{row.least_pet_s:.1f} s"
    speed = "-" if row.delta_v_mps is None else f"{row.delta_v_mps:.1f} m/s"
    found = f"{row.findings} of {row.judged}"
    return row.kind, str(row.attacks), str(row.hits), found, _ttc(row.least_ttc_s), pet, speed


def _ttc(value_s: float | None) -> str:
    """Beyond the ceiling of the quantity ``ttc_s`` a TTC says nothing."""
    from deepmf_sumo.results.quantities import TTC_CEILING_S

    if value_s is None:
        return "-"
    return f"{value_s:.1f} s" if value_s <= TTC_CEILING_S else f"over {TTC_CEILING_S:g} s"
