"""``tl_states`` of a Nocturne or GPUDrive scene -> Signals."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from deepmf_sumo.datatypes import Lane, Signals, SignalState

STATES: Final = {state.name.lower(): state.value for state in SignalState}
STOP_GAP_M: Final = 0.5
"""A lane's signal stands at its first point: coordinates differ by rounding alone."""


def signals(
    described: Mapping[str, Mapping[str, Any]],
    lanes: Mapping[str, Lane],
    steps: int,
    repairs: list[str],
) -> Signals:
    """Signals over all steps.

    Early files do not name their lanes. There a signal is given to a lane that starts at its stop
    point; several signals at one point go to several lanes in the order of the file.
    """
    taken = {str(key) for key in described if str(key) in lanes}
    rows: dict[str, Mapping[str, Any]] = {}
    lost: list[str] = []
    moved = 0
    for key, light in described.items():
        name = str(key)
        if name not in lanes:
            match = _lane_at(light, lanes, taken)
            if match is None:
                lost.append(name)
                continue
            name, moved = match, moved + 1
            taken.add(name)
        rows[name] = light
    if moved:
        repairs.append(f"{moved} signals were given to the lanes that start at their stop points.")
    if lost:
        repairs.append(f"Signals of lanes that are not in the file were left out: {_list(lost)}.")
    return _over_time(rows, steps, repairs)


def _lane_at(light: Mapping[str, Any], lanes: Mapping[str, Lane], taken: set[str]) -> str | None:
    if not light["x"]:
        return None
    stop = np.array([light["x"][-1], light["y"][-1]], float)
    for name, lane in lanes.items():
        if name in taken or not len(lane.centre_m):
            continue
        if np.hypot(*(lane.centre_m[0] - stop)) <= STOP_GAP_M:
            return name
    return None


def _over_time(rows: Mapping[str, Mapping[str, Any]], steps: int, repairs: list[str]) -> Signals:
    state = np.zeros((len(rows), steps), "uint8")
    seen = np.zeros(state.shape, bool)
    stop = np.zeros((len(rows), 3))
    strange: set[str] = set()
    outside = 0
    for row, light in enumerate(rows.values()):
        for step, name in zip(light["time_index"], light["state"], strict=True):
            if not 0 <= int(step) < steps:
                outside += 1
                continue
            if name not in STATES:
                strange.add(str(name))
            state[row, int(step)] = STATES.get(name, 0)
            seen[row, int(step)] = True
        for axis, key in enumerate(("x", "y", "z")):
            stop[row, axis] = light[key][-1] if light.get(key) else 0.0
    if strange:
        repairs.append(
            f"Unknown signal states were taken as unknown: {', '.join(sorted(strange))}."
        )
    if outside:
        repairs.append(f"{outside} signal states of steps that are not recorded were left out.")
    return Signals(
        lane_ids=tuple(rows), state=state, seen=seen, stop_m=stop[:, :2], stop_z_m=stop[:, 2]
    )


def _list(names: list[str]) -> str:
    return ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")
