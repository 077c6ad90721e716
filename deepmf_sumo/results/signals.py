"""``signals.csv.gz`` of a run: the states of the traffic lights near the AV and the opponent."""

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from deepmf_sumo import files
from deepmf_sumo.exporters.base import lights_near
from deepmf_sumo.results import stored
from deepmf_sumo.scene import RoadMap, Rollout, SignalState

FILE: Final = "signals.csv.gz"
UNSEEN: Final = "unseen"
"""A light whose state is not known from here on, as in a recording with gaps."""
COLUMNS: Final = ("step", "time_s", "lane", "state")


def write_signals(path: Path, rollout: Rollout, road: RoadMap) -> None:
    """A row for each light at the first step, and for each change; no file without lights near.

    A state holds from the step of its row on. A light is named by the lane behind it.
    """
    rows, shown = [], dict[str, SignalState | None]()
    near = lights_near(rollout, road)
    for number, lights in enumerate(rollout.signals):
        time_s = f"{number * rollout.dt_s:.1f}"
        for lane in near:
            state = lights.get(lane)
            if shown.get(lane) == state:
                continue
            shown[lane] = state
            said = UNSEEN if state is None else state.name.lower()
            rows.append((rollout.now + number, time_s, lane, said))
    if rows:
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        table.writerows([COLUMNS, *rows])
        files.write(path, files.gzipped(text.getvalue()))


def read_signals(file: Path, now: int, steps: int) -> tuple[dict[str, SignalState], ...]:
    """As `Rollout.signals` of a run of that many steps; empty without a file.

    Raises `stored.DAMAGE`.
    """
    if not file.is_file():
        return ()
    changes: dict[int, dict[str, SignalState | None]] = {}
    with stored.tracks(file) as text:
        for row in csv.DictReader(text):
            said = row["state"]
            state = None if said == UNSEEN else SignalState[said.upper()]
            changes.setdefault(int(row["step"]), {})[row["lane"]] = state
    return tuple(_states(changes, now, steps))


def _states(
    changes: dict[int, dict[str, SignalState | None]], now: int, steps: int
) -> Iterator[dict[str, SignalState]]:
    states: dict[str, SignalState | None] = {}
    for step in range(now, steps - 1):
        states = states | changes.get(step, {})
        yield {lane: state for lane, state in states.items() if state is not None}
