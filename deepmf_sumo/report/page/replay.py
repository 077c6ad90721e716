"""What the page needs to replay a run: poses, plans, gaps and times to collision.

Numbers become short text: whole units, differences of differences, deflated, in base 64. The page
restores them with ``unpacked`` and ``restored`` of ``assets/packing.js``.
"""

import base64
import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo.judge.metrics import NotMeasurable, conflict
from deepmf_sumo.report.drawing import met_at
from deepmf_sumo.results import stored
from deepmf_sumo.scene import (
    Bools,
    Contact,
    Driver,
    Floats,
    Ints,
    RoadMap,
    Rollout,
    agent_ids,
)
from deepmf_sumo.scene.geometry import sight
from deepmf_sumo.scene.geometry.lane_map import width_m
from deepmf_sumo.scene.signals import FORBIDS, GOES, HALTS, STOP_FIRST


def packed(values: Any) -> str:
    """JSON values as deflated base-64 text. Raises ValueError for NaN and infinity."""
    text = json.dumps(values, separators=(",", ":"), allow_nan=False)
    return base64.b64encode(zlib.compress(text.encode(), 9)).decode()


def steady(values: Floats | Ints, unit: float) -> list[int]:
    """(K) multiples of ``unit`` as second differences: near 0 for steady motion.

    The running sum of their running sum restores them, each within half a unit.
    """
    whole = np.rint(np.asarray(values) / unit).astype(int)
    return list(np.diff(np.diff(whole, prepend=0), prepend=0).tolist())


def stepwise(values: Floats | Ints, unit: float) -> list[int]:
    """(K) multiples of ``unit`` as differences: short for shapes; their running sum restores."""
    whole = np.rint(np.asarray(values) / unit).astype(int)
    return list(np.diff(whole, prepend=0).tolist())


REACH_M: Final = 100.0
"""Others that never come this close to the AV or the opponent are left out, and counted."""
LONGEST_TTC_S: Final = 10.0
FINE_M, COARSE_M = 0.02, 0.05
"""Units of positions: of AV and opponent, and of the others."""
_ENDS: Final = ("begin_s", "end_s")
FULL_TURN: Final = 1024
"""Headings are parts of a turn."""
OTHERS_EVERY: Final = 2
"""Steps from one pose of the others to the next; the page draws lines between."""
_SAME_PLACE_M: Final = 0.5
_LIGHTS: Final = {
    **dict.fromkeys(FORBIDS | STOP_FIRST, "stop"),
    **dict.fromkeys(HALTS - FORBIDS, "caution"),
    **dict.fromkeys(GOES, "go"),
}
"""Others are drawn as if they were off: a yellow that flashes asks to yield, as no light does."""


def replay(
    rollout: Rollout,
    origin: Floats,
    turns: Sequence[Mapping[str, Any]] = (),
    road: RoadMap | None = None,
) -> dict[str, Any]:
    """Poses, contacts and timelines, positions relative to ``origin`` (2,).

    ``turns``: of ``result.json``, where several vehicles attacked. ``road``: whose buildings hide
    road users from the AV; None where it is not known, then only vehicles do.
    """
    tracks = rollout.tracks
    near = _near(rollout)
    shown = [tracks.ids[row] for row in np.flatnonzero(near)]
    roles = rollout.roles
    unseen = _unseen(rollout, np.flatnonzero(near), road or RoadMap(lanes={}))
    return {
        "origin": origin.tolist(),
        "steps": tracks.steps,
        "now": rollout.now,
        "dt": rollout.dt_s,
        "turn": FULL_TURN,
        "hidden": len({*agent_ids.wholes(tracks.ids)} - {*agent_ids.wholes(shown)}),
        "agents": [
            _agent(rollout, int(row), roles.get(tracks.ids[row], "other"), origin)
            | ({"unseen": spans} if spans else {})
            for row, spans in zip(np.flatnonzero(near), unseen, strict=True)
        ],
        "contacts": [_contact(rollout, contact, origin) for contact in rollout.contacts],
        "decisive": None if (one := rollout.first(rollout.outcome)) is None else one.step,
        "timeline": _timeline(rollout, turns),
    }


def lights(rollout: Rollout, road: RoadMap, origin: Floats) -> list[list[Any]]:
    """Ends of each light's bar across its lane (x, y, x, y), and the steps of its changes.

    Lanes that begin at one place, as those of a lane's turns, share its width: the left one is on
    the left. Positions are relative to ``origin`` (2,).
    """
    groups: dict[tuple[float, float], list[str]] = {}
    for name in dict.fromkeys(name for each in rollout.signals for name in each):
        if name in road.lanes and len(road.lanes[name].centre_m) > 1:
            x, y = np.rint(road.lanes[name].centre_m[0] / _SAME_PLACE_M).tolist()
            groups.setdefault((x, y), []).append(name)
    return [bar for names in groups.values() for bar in _bars(rollout, road, names, origin)]


def _bars(rollout: Rollout, road: RoadMap, names: list[str], origin: Floats) -> Iterator[list[Any]]:
    lanes = [road.lanes[name] for name in names]
    stop, width = lanes[0].centre_m[0], width_m(lanes[0])
    approach = next((road.lanes[one] for one in lanes[0].previous if one in road.lanes), None)
    line = approach.centre_m[::-1] if approach is not None else lanes[0].centre_m
    away = line[np.hypot(*(line - line[0]).T) > _SAME_PLACE_M]
    if not len(away):
        return  # it has no direction
    x, y = (line[0] - away[0]) if approach is not None else (away[0] - line[0])
    left = np.array([-y, x]) / np.hypot(x, y)
    lanes.sort(key=lambda lane: float((lane.centre_m[-1] - stop) @ left))
    for number, lane in enumerate(lanes):
        sides = (number + np.array([0.08, 0.92])) / len(lanes) - 0.5
        ends = stop - origin + width * sides[:, None] * left
        changes: list[list[Any]] = []
        for step, each in enumerate(rollout.signals, rollout.now):
            shown = _LIGHTS.get(each[lane.id], "off") if lane.id in each else None
            if shown is not None and (not changes or changes[-1][1] != shown):
                changes.append([step, shown])
        yield [*np.round(ends.ravel(), 2).tolist(), changes]


def main_places(rollout: Rollout) -> Floats:
    """(K, 2) where AV and attackers were from the current step on, or before if gone by then."""
    tracks, places = rollout.tracks, []
    for agent in (rollout.av_id, *rollout.attackers):
        if agent in tracks.ids:
            row = tracks.row(str(agent))
            there = tracks.valid[row].copy()
            if there[rollout.now :].any():
                there[: rollout.now] = False
            places.append(tracks.position_m[row, there])
    found: Floats = np.concatenate(places)
    return found


def _near(rollout: Rollout) -> Bools:
    """(A) whether an agent was ever within `REACH_M` of the AV or an attacker at the same time."""
    tracks = rollout.tracks
    near = np.zeros(tracks.agents, bool)
    for agent in (rollout.av_id, *rollout.attackers):
        if agent in tracks.ids:
            row = tracks.row(str(agent))
            apart = np.linalg.norm(tracks.position_m - tracks.position_m[row], axis=-1)
            near |= ((apart <= REACH_M) & tracks.valid & tracks.valid[row]).any(axis=1)
    return near


def _unseen(rollout: Rollout, rows: Ints, road: RoadMap) -> list[list[list[int]]]:
    """Of each row: first and last step of each time at which the AV cannot see it, see `sight`.

    From the current step on, to `OTHERS_EVERY` steps.
    """
    tracks = rollout.tracks.select(rows.tolist())
    av = tracks.row(rollout.av_id)
    steps = np.arange(rollout.now, tracks.steps, OTHERS_EVERY)
    unseen = np.zeros((tracks.agents, len(steps) + 2), bool)  # none is hidden before and after
    for place, step in enumerate(steps.tolist(), start=1):
        if tracks.valid[av, step]:
            seen = sight.visible(tracks, step, av, road)
            unseen[:, place] = tracks.valid[:, step] & ~seen
    found: list[list[list[int]]] = []
    for row in unseen:
        begin, end = np.flatnonzero(np.diff(row.astype(int))).reshape(-1, 2).T
        last = np.append(steps, tracks.steps)[end] - 1
        found.append(np.stack([steps[begin], last], axis=1).tolist())
    return found


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
    """Step and name of each driver of an agent, from its first step on."""
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

    Of opponents in turn each while its turn lasts, of those that attack together the nearest. A
    time to collision is null off a collision course and above `LONGEST_TTC_S`.
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
            found = conflict.over_time(replace(rollout, attackers=(there,) if there else ()))
        except NotMeasurable as error:
            reason = str(error)
            continue
        inside = (found.step >= first) & (found.step <= last)
        parts.append(np.stack([found.step, found.gap_m, found.ttc_s])[:, inside])
    if not sum(part.shape[1] for part in parts):
        return reason
    step, gap_m, ttc_s = np.concatenate(parts, axis=1)
    nearest = np.lexsort((gap_m, step))
    nearest = nearest[np.diff(step[nearest], prepend=-1) > 0]
    step, gap_m, ttc_s = step[nearest], gap_m[nearest], ttc_s[nearest]
    return {
        "step": steady(step, 1),
        "gap": steady(gap_m, 0.01),
        "ttc": [round(float(ttc), 2) if ttc <= LONGEST_TTC_S else None for ttc in ttc_s.tolist()],
    }


EVERY_STEPS: Final = 4
UNIT_M: Final = 0.1
MOST_A_RUN: Final = 160
"""Candidates of all plans of a run that are kept: so the page stays small."""
FEWEST_A_PLAN, MOST_A_PLAN = 6, 64
MOST_HEATED: Final = 400
"""Dense goals of a plan that are kept."""
_Arrays = Mapping[str, NDArray[Any]]


def reasons(file: Path, origin: Floats) -> list[dict[str, Any]]:
    """The plans in a ``plans.npz``, positions relative to ``origin`` (2,).

    Of each plan the chosen candidate and those of highest value are kept, at most `MOST_A_PLAN`
    (fewer where there are many plans); ``of`` says how many there were. Of the reactions all modes
    to the chosen candidate are kept, and the likeliest one to each other.
    """
    with stored.arrays(file) as arrays:
        plans = int(arrays["plans"])
        most = int(np.clip(MOST_A_RUN // max(plans, 1), FEWEST_A_PLAN, MOST_A_PLAN))
        return [_plan(_of(arrays, number), most, origin) for number in range(plans)]


def _of(arrays: Any, number: int) -> _Arrays:
    head = f"{number:02d}/"
    return {name.removeprefix(head): arrays[name] for name in arrays if name.startswith(head)}


def _plan(arrays: _Arrays, most: int, origin: Floats) -> dict[str, Any]:
    plan: dict[str, Any] = {
        "agent": str(arrays["agent_id"]),
        "step": int(arrays["first_step"]),
        "path": _path(arrays["position_m"], origin),
    }
    if "rule" not in arrays:
        return plan
    kept = _best(arrays, most)
    plan |= {
        "rule": str(arrays["rule"]),
        "of": len(arrays["candidate_probability"]),
        "chosen": int(np.flatnonzero(kept == int(arrays["chosen"]))[0]),
        "unmet": arrays["unmet"].tolist() if "unmet" in arrays else [],
        "candidates": [_candidate(arrays, int(number), origin) for number in kept],
    }
    if "heat_position_m" in arrays:
        plan["heat"] = _heat(arrays, origin)
    if "score_ids" in arrays:
        chance = 1.0 / (1.0 + np.exp(-arrays["score_logits"]))
        ids = arrays["score_ids"].tolist()
        plan["scores"] = dict(zip(ids, np.round(chance, 3).tolist(), strict=True))
    return plan


def _best(arrays: _Arrays, most: int) -> NDArray[Any]:
    """Numbers of the candidates that are kept, in their order: the chosen one, the best others."""
    value, chosen = arrays["value"], int(arrays["chosen"])
    order = np.lexsort((-arrays["candidate_probability"], -value))
    order = order[order != chosen][: most - 1]
    return np.sort(np.append(order, chosen))


def _candidate(arrays: _Arrays, number: int, origin: Floats) -> dict[str, Any]:
    candidate: dict[str, Any] = {
        "number": number,
        "path": _path(arrays["candidate_position_m"][number], origin),
        "p": _digits(arrays["candidate_probability"][number]),
        "value": _digits(arrays["value"][number]),
        "reactions": [],
    }
    if "candidate_origin" in arrays:
        candidate["origin"] = str(arrays["candidate_origin"][number])
    if "reaction_position_m" in arrays:
        chance = arrays["reaction_probability"][number]
        hits = arrays["collides"][number]
        candidate["hit"] = round(float((chance * hits).sum()), 4)
        modes = range(len(chance)) if number == int(arrays["chosen"]) else [int(chance.argmax())]
        candidate["reactions"] = [
            {
                "path": _path(arrays["reaction_position_m"][number, mode], origin),
                "p": round(float(chance[mode]), 3),
                "hits": bool(hits[mode]),
            }
            for mode in modes
        ]
    return candidate


def _heat(arrays: _Arrays, origin: Floats) -> list[list[float]]:
    """Of the likeliest dense goals x, y in metres, and the probability over the largest one."""
    chance = arrays["heat_probability"][:MOST_HEATED]
    place = np.round(arrays["heat_position_m"][:MOST_HEATED] - origin, 1)
    return np.column_stack([place, np.round(chance / chance.max(), 2)]).astype(float).tolist()


def _digits(value: Any) -> float:
    """Three digits: products of probabilities are small."""
    return float(f"{float(value):.3g}")


def _path(position_m: NDArray[Any], origin: Floats) -> list[list[int]]:
    """Coordinates x and y every `EVERY_STEPS` steps, from the first one."""
    x, y = (np.asarray(position_m[::EVERY_STEPS], float) - origin).T
    return [steady(x, UNIT_M), steady(y, UNIT_M)]
