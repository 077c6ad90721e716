"""What `risk` and `compare` show: the worst places of each network; what is different."""

from collections.abc import Sequence
from typing import Final

from rich.table import Table

from deepmf_sumo.benchmark.risk import Row as PlaceRow
from deepmf_sumo.benchmark.risk import worst
from deepmf_sumo.benchmark.risk.comparison import Compared
from deepmf_sumo.cli.screen.console import escape, wide
from deepmf_sumo.report.risk import Written, comparison
from deepmf_sumo.report.table import counted

_HEADINGS: Final = (
    "where attacks were decided", "attacks", "hits", "avoidable hits", "least TTC",
    "mean delta-v", "risk of a hit (90 % interval)",
)  # fmt: skip
_MOST: Final = 30


def show(written: Sequence[Written], top: int) -> None:
    """A table a network: movements and edges, by the lower end of the risk of a hit."""
    console = wide()
    for one in written:
        network = one.network
        left = "".join(
            f"; not counted: {counted(count, 'run')} {why}"
            for why, count in network.left_out.items()
        )
        head = f"{network.name}: {counted(len(network.attacks), 'attack')}{left}"
        console.print(escape(head), soft_wrap=True)
        console.print(_grid(_HEADINGS, [_cells(row) for row in worst(one.rows)[:top]]))
        console.print(escape(f"{one.folder}/risk.html, risk.csv, risk.sumocfg"), soft_wrap=True)


def show_comparison(compared: Compared, names: tuple[str, str]) -> None:
    """What was compared, the differences, where they come from, and what to know."""
    console = wide()
    for line in comparison.heading(compared, names):
        console.print(escape(line), soft_wrap=True)
    console.print(_grid(comparison.DIFFERENCE_HEADINGS, comparison.differences(compared)))
    if compared.origins:
        shown = comparison.origins(compared.origins)
        console.print(_grid(comparison.ORIGIN_HEADINGS, shown[:_MOST]))
        if len(shown) > _MOST:
            console.print(f"and {len(shown) - _MOST} more with --out")
    for note in compared.notes:
        console.print(escape(note), soft_wrap=True)


def _grid(headings: Sequence[str], rows: Sequence[tuple[str, ...]]) -> Table:
    grid = Table(box=None, pad_edge=False, header_style="bold")
    for heading in headings:
        grid.add_column(escape(heading), overflow="fold")
    for row in rows:
        grid.add_row(*(escape(cell) for cell in row))
    return grid


def _cells(row: PlaceRow) -> tuple[str, ...]:
    risk = row.risk["hit"]
    speed = None if row.delta_v_mps is None else f"{row.delta_v_mps:.1f} m/s"
    return (
        row.title if row.kind == "movement" else f"{row.kind} {row.title}",
        str(row.attacks),
        str(row.events["hit"]),
        f"{row.events['avoidable']} of {row.judged}",
        "-" if row.ttc_s is None else f"{row.ttc_s:.1f} s",
        speed or "-",
        f"{100 * risk.rate:.0f} % ({100 * risk.low:.0f} to {100 * risk.high:.0f} %)",
    )
