"""Trajectories for FHWA's SSAM (Surrogate Safety Assessment Model): ``ssam/run.trj``.

Binary records of one byte of type each, as in the file formats 1.04 (2004) and 3.0 (2017) that come
with SSAM: format, dimensions, and at each time step the vehicles with both bumpers, length, width,
speed and acceleration; 3.0 has heights as well. SSAM numbers vehicles: ``vehicles.csv`` says which
is which, ``about.json`` what is not from the run.

SSAM judges no step of the last five seconds (its largest post-encroachment time), and ends a
conflict when the two have parted. So a contact near the end is followed by seconds that are made
up: both stand, then the AV goes straight on, through the other where need be; no others are there.
"""

import itertools
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from pydantic import Field

from deepmf_sumo import files, plugins, tables
from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.judge.metrics.traffic_conflicts import RoadUserMotions
from deepmf_sumo.scene import Contact, Floats, Rollout, Tracks, agent_ids
from deepmf_sumo.scene.geometry import frames

FILE: Final = "ssam/"
TRAJECTORIES, VEHICLES, ABOUT = "run.trj", "vehicles.csv", "about.json"
METRIC: Final = 1
_LITTLE_ENDIAN: Final = ord("L")
_MARGIN_M: Final = 10.0
"""Around the vehicles; SSAM drops those whose centre is out of the observed area."""
_FAR_M: Final = 2.0**16
"""From here on single precision is coarser than a centimetre: coordinates get another origin."""
_ORIGIN_M: Final = 1000.0
_STANDING_S: Final = 1.0
"""SSAM looks for vehicles that overlap 1.5 s later on the ways that they take at the speed of now;
only where both stay at the place of the contact does it surely find them."""
_PARTING_MPS: Final = 3.0
"""The AV's speed after that: at rest the two would never part."""
_UNKNOWN_LINK: Final = 0
"""SSAM then tells kinds of conflicts by the angle alone."""


class Settings(plugins.Settings):
    """How SSAM reads it.

    Attributes:
        version: of the format; SSAM 2 reads 1.04 alone.
        after_s: seconds that must follow a contact of the AV; more than SSAM's largest PET. 0 adds
            none.
    """

    version: Literal["1.04", "3.0"] = "1.04"
    after_s: float = Field(default=14.0, ge=0.0, le=60.0)


def write(run: Exportable, path: Path, settings: Settings) -> None:
    """Write the folder ``path``; time 0 is the first step of history. Raises OutputError."""
    rollout = run.rollout
    tracks = _followed(rollout, settings.after_s)
    motions = _motions(tracks, rollout.dt_s)
    origin = origin_of(motions)
    with files.writing(path), files.whole_folder(path) as folder:
        content = trajectories(motions, origin, settings.version, rollout.tracks.steps)
        (folder / TRAJECTORIES).write_bytes(content)
        (folder / VEHICLES).write_text(_vehicles(rollout), "utf-8")
        made_up = tracks.steps - rollout.tracks.steps
        files.write_json(folder / ABOUT, _about(run, settings) | {
            "origin_m": origin.tolist(), "made_up_steps": made_up,
        })  # fmt: skip


def _followed(rollout: Rollout, after_s: float) -> Tracks:
    """The tracks, and the seconds after the AV's last contact."""
    tracks = rollout.tracks
    contacts = [one for one in rollout.contacts if rollout.av_id in (one.first_id, one.second_id)]
    if not contacts:
        return tracks
    contact = max(contacts, key=lambda one: one.step)
    more = round(after_s / rollout.dt_s) - (tracks.steps - 1 - contact.step)
    return _going_on(tracks, contact, rollout, more) if more > 0 else tracks


def _going_on(tracks: Tracks, contact: Contact, rollout: Rollout, more: int) -> Tracks:
    """With ``more`` steps: the two of the contact stand, and then the AV goes straight on."""
    longer, last = tracks.padded(more), tracks.steps - 1
    arrays = {
        name: getattr(longer, name).copy()
        for name in ("position_m", "z_m", "heading_rad", "velocity_mps", "valid")
    }
    gone_on = np.maximum(np.arange(1, more + 1) * rollout.dt_s - _STANDING_S, 0.0)
    for agent in (contact.first_id, contact.second_id):
        row = tracks.row(agent)
        if not tracks.valid[row, last]:
            continue
        heading = tracks.heading_rad[row, last]
        velocity = _PARTING_MPS * frames.unit(heading) * (agent == rollout.av_id)
        after = slice(last + 1, None)
        arrays["position_m"][row, after] = (
            tracks.position_m[row, last] + gone_on[:, None] * velocity
        )
        arrays["z_m"][row, after] = tracks.z_m[row, last]
        arrays["heading_rad"][row, after] = heading
        arrays["velocity_mps"][row, after] = velocity * (gone_on[:, None] > 0)
        arrays["valid"][row, after] = True
    return replace(longer, **arrays)


def _motions(tracks: Tracks, dt_s: float) -> RoadUserMotions:
    step, row = np.nonzero(tracks.valid.T)
    return RoadUserMotions(
        dt_s=dt_s,
        size_m=tracks.size_m[:, :2],
        step=step,
        body=row,
        position_m=tracks.position_m[row, step],
        heading_rad=tracks.heading_rad[row, step],
        speed_mps=tracks.speed_mps[row, step],
        z_m=tracks.z_m[row, step],
        lane=np.zeros(len(step), int),
        edge_of_lane=np.zeros(1, int),
    )


def origin_of(motions: RoadUserMotions) -> Floats:
    """(2) what coordinates count from: 0, or whole kilometres where they are large."""
    there = motions.position_m
    if float(np.abs(there).max()) <= _FAR_M:
        return np.zeros(2)
    origin: Floats = np.floor(there.min(axis=0) / _ORIGIN_M) * _ORIGIN_M
    return origin


def trajectories(
    motions: RoadUserMotions,
    origin_m: Floats,
    version: Literal["1.04", "3.0"] = "1.04",
    happened: int | None = None,
) -> bytes:
    """The content of a file; a road user's number is its index in the motions, plus 1.

    From step ``happened`` on accelerations are 0: standing right after a contact is not braking.
    """
    high = version == "3.0"
    half = motions.size_m[motions.body, :1] / 2 * frames.unit(motions.heading_rad)
    centre = motions.position_m - origin_m
    front, rear = centre + half, centre - half
    points = np.concatenate([front, rear])
    low = np.floor(points.min(axis=0) - _MARGIN_M).astype(int)
    top = np.ceil(points.max(axis=0) + _MARGIN_M).astype(int)
    parts = [struct.pack("<BBf", 0, _LITTLE_ENDIAN, float(version)) + b"\x01" * high]
    parts.append(struct.pack("<BBf4i", 1, METRIC, 1.0, *low.tolist(), *top.tolist()))
    gained = _accelerations(motions)
    gained[motions.step >= (motions.step[-1] + 1 if happened is None else happened)] = 0.0
    z = motions.z_m[:, None]
    columns = [front, rear, motions.size_m[motions.body], motions.speed_mps[:, None]]
    values = np.concatenate([*columns, gained[:, None], *[z, z] * high], axis=1)
    width = values.shape[1]
    record = [("kind", "u1"), ("number", "<i4"), ("link", "<i4"), ("lane", "u1")]
    vehicles = np.zeros(len(values), dtype=[*record, ("values", "<f4", (width,))])
    vehicles["kind"], vehicles["number"], vehicles["link"] = 3, motions.body + 1, _UNKNOWN_LINK
    vehicles["values"] = values
    bounds = np.searchsorted(motions.step, np.arange(int(motions.step[-1]) + 2))
    for step, (begin, end) in enumerate(itertools.pairwise(bounds.tolist())):
        parts.append(struct.pack("<Bf", 2, step * motions.dt_s))
        parts.append(vehicles[begin:end].tobytes())
    return b"".join(parts)


def _accelerations(motions: RoadUserMotions) -> Floats:
    """(K) difference to the step before; at a vehicle's first step to the one after it."""
    order = np.lexsort((motions.step, motions.body))
    body, step, speed = motions.body[order], motions.step[order], motions.speed_mps[order]
    next_one = (np.diff(body) == 0) & (np.diff(step) == 1)
    differences = np.where(next_one, np.diff(speed) / motions.dt_s, 0.0)
    change = np.zeros(len(order))
    change[1:] = differences
    first = np.flatnonzero(next_one & ~np.r_[False, next_one[:-1]])
    change[first] = differences[first]
    found = np.empty(len(order))
    found[order] = change
    return found


def _vehicles(rollout: Rollout) -> str:
    """SSAM's number of each road user, in the order of ``tracks.csv.gz``.

    A vehicle that bends is several boxes: SSAM, which does not know that, counts each.
    """
    tracks, roles = rollout.tracks, rollout.roles
    rows = [
        {
            "number": row + 1,
            "id": agent,
            "kind": tracks.kinds[row],
            "role": roles.get(agent, "other"),
            "part_of": whole if (whole := agent_ids.whole_of(agent)) != agent else "",
            "length_m": float(tracks.size_m[row, 0]),
            "width_m": float(tracks.size_m[row, 1]),
        }
        for row, agent in enumerate(tracks.ids)
    ]
    return tables.to_csv(rows)


def _about(run: Exportable, settings: Settings) -> dict[str, Any]:
    rollout = run.rollout
    return {
        "run_id": run.name,
        "version": settings.version,
        "attacked_from_s": round(rollout.now * rollout.dt_s, 3),
        "happened_until_s": round((rollout.tracks.steps - 1) * rollout.dt_s, 3),
        "made": list(run.made),
        "contacts": [
            {
                "time_s": round(one.step * rollout.dt_s, 3),
                "first_id": one.first_id,
                "second_id": one.second_id,
            }
            for one in rollout.contacts
        ],
    }
