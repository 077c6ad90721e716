"""What `attach` shows: a line an attack while it goes on, a table at the end."""

from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from deepmf_sumo.benchmark.live import Attached
from deepmf_sumo.cli.screen.console import escape, wide

_ENDS: Final = {
    "until": "left at {time:.1f} s, as asked",
    "attacks": "left at {time:.1f} s, after {count} attacks, as asked",
    "av_gone": "vehicle '{av}' left the traffic at {time:.1f} s",
    "simulation_over": "the simulation ended at {time:.1f} s",
    "stopped": "left at {time:.1f} s, stopped",
}
_HEADINGS: Final = ("", "opponent", "from s", "to s", "ended", "least gap m", "contact m/s")


def tell(row: dict[str, Any]) -> None:
    """An attack is over."""
    Console(stderr=True, highlight=False).print(
        escape(
            f"{row['begin_s']:.1f} to {row['end_s']:.1f} s: {row['opponent']}, {row['ended']}, "
            f"least gap {row['min_gap_m']:.1f} m"
        ),
        soft_wrap=True,
    )


def show(done: Attached, av: str, out: Path) -> None:
    """The attacks, why it is over, and where the files are."""
    console = wide(120)
    if done.rows:
        grid = Table(box=None, pad_edge=False, header_style="bold")
        for number, heading in enumerate(_HEADINGS):
            grid.add_column(heading, justify="left" if number in {1, 4} else "right")
        for row in done.rows:
            grid.add_row(*map(escape, _cells(row)), style="red" if row["contact"] else "")
        console.print(grid)
    count = len(done.rows)
    hits = sum(row["contact"] is not None for row in done.rows)
    why = _ENDS[done.end].format(time=done.time_s, count=count, av=av)
    nobody = f" ({done.nobody})" if not count and done.nobody else ""
    file = f"{out}/{'attacks.jsonl' if count else 'session.json'}"
    console.print(
        escape(f"{count} attacks, {hits} contacts{nobody}; {why}; {file}"),
        soft_wrap=True,
    )
    if hits and done.collisions == "teleport":
        console.print(
            "SUMO takes a vehicle away after a collision (collision.action teleport), perhaps the "
            "AV; start it with --collision.action warn to see what happens then",
            soft_wrap=True,
        )


def _cells(row: dict[str, Any]) -> list[str]:
    contact = row["contact"]
    return [
        str(row["number"]),
        row["opponent"],
        f"{row['begin_s']:.1f}",
        f"{row['end_s']:.1f}",
        row["ended"],
        f"{row['min_gap_m']:.2f}",
        "-" if contact is None else f"{contact['relative_mps']:.1f}",
    ]
