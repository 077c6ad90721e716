"""``tracks.csv.gz`` of a run: how each road user moved, and what drove it."""

import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TextIO

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo import files
from deepmf_sumo.results import stored
from deepmf_sumo.scene import Driver, Rollout, Tracks
from deepmf_sumo.scene.geometry import frames

FILE: Final = "tracks.csv.gz"
_PIECE: Final = 1 << 20
"""Characters that are searched at a time."""
TRACK_COLUMNS: Final = (
    "step,time_s,id,kind,role,driver,x_m,y_m,heading_rad,speed_mps,length_m,width_m,z_m"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedTracks:
    """What the file of a run says.

    Attributes:
        tracks: velocities lie along the headings, heights of vehicles are 0.
        driver: (A, T) `scene.Driver`.
        now: step at which the simulation took over.
        attackers: as of `Rollout`; those that were asked for.
    """

    tracks: Tracks
    driver: NDArray[np.uint8]
    now: int
    av_id: str
    attackers: tuple[str, ...]


def write_tracks(path: Path, rollout: Rollout) -> None:
    """One row per agent and step; time 0 is the step at which the simulation took over."""
    tracks, roles = rollout.tracks, rollout.roles
    drivers = {int(driver): driver.name.lower() for driver in Driver}
    who = [
        f"{_quoted(agent_id)},{kind},{roles.get(agent_id, 'other')}"
        for agent_id, kind in zip(tracks.ids, tracks.kinds, strict=True)
    ]
    size = [f"{length:.3f},{width:.3f}" for length, width, _ in tracks.size_m]
    step, row = np.nonzero(tracks.valid.T)
    # Lists, for formatting numbers of numpy takes several times as long.
    cells = (
        step,
        np.array([f"{(at - rollout.now) * rollout.dt_s:.1f}" for at in range(tracks.steps)])[step],
        row,
        rollout.driver[row, step],
        *tracks.position_m[row, step].T,
        tracks.heading_rad[row, step],
        tracks.speed_mps[row, step],
        tracks.z_m[row, step],
    )
    lines = [
        f"{at},{time},{who[agent]},{drivers[driver]},{x:.4f},{y:.4f},{heading:.5f},{speed:.4f},"
        f"{size[agent]},{z:.2f}"
        for at, time, agent, driver, x, y, heading, speed, z in zip(
            *(cell.tolist() for cell in cells), strict=True
        )
    ]
    lines.insert(0, TRACK_COLUMNS)
    files.write(path, files.gzipped("\n".join(lines) + "\n"))


def read_tracks(file: Path, vehicles: Sequence[str] | None = None) -> RecordedTracks:
    """The tracks of all road users, or of the AV and those ``vehicles`` that are there.

    Raises `stored.DAMAGE`.
    """
    import pandas as pd  # 0.5 s that only reading needs; workers write

    with stored.tracks(file) as text:
        lines = text if vehicles is None else io.StringIO("".join(_of_interest(text, vehicles)))
        table = pd.read_csv(lines, dtype={"id": str}, keep_default_na=False)
    if vehicles is not None:
        table = table[(table["role"] == "av") | table["id"].isin(vehicles)]
    of_role = {role: tuple(rows["id"].unique()) for role, rows in table.groupby("role")}
    ids = tuple(table["id"].unique())
    place = pd.Series(np.arange(len(ids)), index=ids)
    row, step = place[table["id"]].to_numpy(), table["step"].to_numpy()
    if not (len(step) and step.min() >= 0 and step.max() < stored.MOST_STEPS):
        raise ValueError(f"a step is not within 0 and {stored.MOST_STEPS}")
    shape = (len(ids), int(step.max()) + 1)

    def dense(name: str) -> Any:
        array = np.zeros(shape)
        array[row, step] = table[name]
        return array

    valid, driver = np.zeros(shape, bool), np.zeros(shape, np.uint8)
    valid[row, step] = True
    driver[row, step] = table["driver"].str.upper().map(Driver.__members__)
    first = table.drop_duplicates("id")
    heading, speed = dense("heading_rad"), dense("speed_mps")
    return RecordedTracks(
        tracks=Tracks(
            ids=ids,
            kinds=tuple(first["kind"]),
            size_m=np.column_stack([first["length_m"], first["width_m"], np.zeros(len(ids))]),
            position_m=np.stack([dense("x_m"), dense("y_m")], axis=-1),
            z_m=dense("z_m") if "z_m" in table else np.zeros(shape),  # older results have none
            heading_rad=heading,
            velocity_mps=speed[..., None] * frames.unit(heading),
            valid=valid,
        ),
        driver=driver,
        now=int(step[np.abs(table["time_s"].to_numpy()).argmin()]),
        av_id=of_role["av"][0],
        attackers=of_role.get("opponent", ())[:1] + of_role.get("attacker", ()),
    )


def _quoted(text: str) -> str:
    plain = not any(mark in text for mark in ',"\n\r')
    return text if plain else '"' + text.replace('"', '""') + '"'


def _of_interest(stream: TextIO, vehicles: Sequence[str]) -> Iterator[str]:
    """The first line, and those that may be of the AV or a vehicle: most lines are of others."""
    marks = (",av,", *(one.replace('"', '""') for one in vehicles))
    yield stream.readline()
    rest = ""
    while piece := stream.read(_PIECE):
        whole, newline, rest = (rest + piece).rpartition("\n")
        yield from _marked(whole + newline, marks)
    yield from _marked(rest, marks)


def _marked(text: str, marks: Iterable[str]) -> Iterator[str]:
    """The lines with any of the marks, in order, without a look at every line."""
    begins = set()
    for mark in marks:
        at = text.find(mark)
        while at >= 0:
            begins.add(text.rfind("\n", 0, at) + 1)
            end = text.find("\n", at)
            at = text.find(mark, end) if end >= 0 else -1
    for begin in sorted(begins):
        end = text.find("\n", begin)
        yield text[begin:] if end < 0 else text[begin : end + 1]
