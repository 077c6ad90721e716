"""What the page needs to replay a run: who was where, what was planned, how near it came."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from deepmf_sumo.datatypes import Bools, Contact, Driver, Floats, Ints, Rollout
from deepmf_sumo.metrics import NotMeasurable, conflict
from deepmf_sumo.report.figures.episode import met_at
from deepmf_sumo.report.page.packing import steady

REACH_M: Final = 100.0
"""Others that never come so near to the AV or the opponent are left out, and counted."""
LONGEST_TTC_S: Final = 10.0
FINE_M, COARSE_M = 0.02, 0.05
"""Units of positions: of AV and opponent, and of the others."""
_ENDS: Final = ("begin_s", "end_s")
FULL_TURN: Final = 1024
"""Headings are parts of a turn."""
OTHERS_EVERY: Final = 2
"""Steps from one pose of the others to the next; the page draws lines between."""


def replay(
    rollout: Rollout, origin: Floats, turns: Sequence[Mapping[str, Any]] = ()
) -> dict[str, Any]:
    """Poses, contacts and timelines, positions relative to ``origin`` (2,).

    ``turns``: of ``result.json``, where opponents took turns.
    """
    tracks = rollout.tracks
    near = _near(rollout)
    main = {rollout.av_id: "av", rollout.opponent_id: "opponent"}
    return {
        "origin": origin.tolist(),
        "steps": tracks.steps,
        "now": rollout.now,
        "dt": rollout.dt_s,
        "turn": FULL_TURN,
        "hidden": int(tracks.agents - near.sum()),
        "agents": [
            _agent(rollout, int(row), main.get(tracks.ids[row], "other"), origin)
            for row in np.flatnonzero(near)
        ],
        "contacts": [_contact(rollout, contact, origin) for contact in rollout.contacts],
        "timeline": _timeline(rollout, turns),
    }


def main_places(rollout: Rollout) -> Floats:
    """(K, 2) where AV and opponent were from the current step on, or before if gone by then."""
    tracks, places = rollout.tracks, []
    for agent in (rollout.av_id, rollout.opponent_id):
        if agent in tracks.ids:
            row = tracks.row(str(agent))
            there = tracks.valid[row].copy()
            if there[rollout.now :].any():
                there[: rollout.now] = False
            places.append(tracks.position_m[row, there])
    found: Floats = np.concatenate(places)
    return found


def _near(rollout: Rollout) -> Bools:
    """(A) whether an agent was ever within `REACH_M` of the AV or the opponent at the same time."""
    tracks = rollout.tracks
    near = np.zeros(tracks.agents, bool)
    for agent in (rollout.av_id, rollout.opponent_id):
        if agent in tracks.ids:
            row = tracks.row(str(agent))
            apart = np.linalg.norm(tracks.position_m - tracks.position_m[row], axis=-1)
            near |= ((apart <= REACH_M) & tracks.valid & tracks.valid[row]).any(axis=1)
    return near


def _agent(rollout: Rollout, row: int, role: str, origin: Floats) -> dict[str, Any]:
    tracks = rollout.tracks
    every, unit = (OTHERS_EVERY, COARSE_M) if role == "other" else (1, FINE_M)
    agent = {
        "id": tracks.ids[row],
        "role": role,
        "kind": tracks.kinds[row],
        "size": [round(float(side), 2) for side in tracks.size_m[row, :2]],
        "every": every,
        "unit": unit,
        "parts": [_part(rollout, row, steps, every, unit, origin) for steps in _runs(rollout, row)],
    }
    if role != "other":
        steps = np.flatnonzero(tracks.valid[row])
        agent["speed"] = [int(steps[0]), steady(tracks.speed_mps[row, steps], 0.01)]
        agent["drivers"] = _drivers(rollout, row, steps)
    return agent


def _drivers(rollout: Rollout, row: int, steps: Ints) -> list[list[Any]]:
    """Step and name of each change of who drives an agent, the first one among them."""
    driver = rollout.driver[row, steps].astype(int)
    changes = np.flatnonzero(np.diff(driver, prepend=-1))
    return [[int(steps[at]), Driver(driver[at]).name.lower()] for at in changes]


def _runs(rollout: Rollout, row: int) -> list[Any]:
    """Steps at which an agent is there, without gaps."""
    steps = np.flatnonzero(rollout.tracks.valid[row])
    return np.split(steps, np.flatnonzero(np.diff(steps) > 1) + 1)


def _part(
    rollout: Rollout, row: int, steps: Any, every: int, unit: float, origin: Floats
) -> list[Any]:
    """First step, x, y, heading; the last step is always among those kept."""
    tracks, steps = rollout.tracks, steps[::-1][::every][::-1]
    x, y = (tracks.position_m[row, steps] - origin).T
    heading = np.unwrap(tracks.heading_rad[row, steps])
    step = 2 * np.pi / FULL_TURN
    return [int(steps[0]), steady(x, unit), steady(y, unit), steady(heading, step)]


def _contact(rollout: Rollout, contact: Contact, origin: Floats) -> dict[str, Any]:
    place = met_at(rollout.tracks, contact) - origin
    return {
        "kind": contact.kind,
        "step": contact.step,
        "first": contact.first_id,
        "second": contact.second_id,
        "speed": round(float(contact.relative_mps), 2),
        "place": [round(float(value), 2) for value in place],
    }


def _timeline(rollout: Rollout, turns: Sequence[Mapping[str, Any]]) -> dict[str, Any] | str:
    """Gap and time to collision of AV and opponent, or why there are none.

    Of opponents in turn each while its turn lasts. A time to collision is null off a collision
    course and above `LONGEST_TTC_S`.
    """
    whole = rollout.now, rollout.tracks.steps
    spans = [(rollout.opponent_id, *whole)]
    if turns:
        spans = [
            (turn["opponent"], *(rollout.now + round(turn[end] / rollout.dt_s) for end in _ENDS))
            for turn in turns
        ]
    parts, reason = [], conflict.NEVER_TOGETHER
    for opponent, first, last in spans:
        there = opponent if opponent in rollout.tracks.ids else None
        try:
            found = conflict.over_time(replace(rollout, opponent_id=there))
        except NotMeasurable as error:
            reason = str(error)
            continue
        inside = (found.step >= first) & (found.step <= last)
        parts.append(np.stack([found.step, found.gap_m, found.ttc_s])[:, inside])
    if not sum(part.shape[1] for part in parts):
        return reason
    step, gap_m, ttc_s = np.concatenate(parts, axis=1)
    return {
        "step": steady(step, 1),
        "gap": steady(gap_m, 0.01),
        "ttc": [round(float(ttc), 2) if ttc <= LONGEST_TTC_S else None for ttc in ttc_s.tolist()],
    }
