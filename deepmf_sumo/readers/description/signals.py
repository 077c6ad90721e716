"""``dynamic_map_states`` of a ScenarioNet scene -> Signals."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from deepmf_sumo.datatypes import Floats, Ints, Signals, SignalState
from deepmf_sumo.readers.checks import identifier

STATES: Final = {f"LANE_STATE_{state.name}": state.value for state in SignalState}
"""How a state is written in files of all versions but the earliest, which have numbers."""


def signals(
    described: Mapping[Any, Mapping[str, Any]],
    steps: int,
    unknown_is_missing: bool,
    repairs: list[str],
) -> Signals:
    """Signals over all steps.

    Args:
        described: by lane id.
        steps: of the scene.
        unknown_is_missing: the file writes UNKNOWN for steps without a state, too.
        repairs: gets a sentence for states that are not known.
    """
    lane_ids = [identifier(key) for key in described]
    state = np.zeros((len(lane_ids), steps), "int64")
    seen = np.zeros(state.shape, bool)
    stop = np.zeros((len(lane_ids), 3))
    strange: set[str] = set()
    for row, light in enumerate(described.values()):
        listed = light["state"]["object_state"]
        if isinstance(listed, np.ndarray) and listed.dtype.kind in "iuf":
            numbers, there = _from_numbers(listed)
            points = np.asarray(light["state"]["stop_point"], float).reshape(len(listed), -1)
            stop[row] = _place(points[there])
        else:
            numbers, there = _from_names(listed, unknown_is_missing, strange)
            stop[row] = _place(np.asarray(light["stop_point"], float).reshape(1, -1))
        kept = min(steps, len(numbers))
        state[row, :kept], seen[row, :kept] = numbers[:kept], there[:kept]
    if strange:
        repairs.append(
            f"Signal states that are not known were taken as unknown: {', '.join(sorted(strange))}."
        )
    return Signals(
        lane_ids=tuple(lane_ids),
        state=np.where(seen, state, 0),
        seen=seen,
        stop_m=stop[:, :2],
        stop_z_m=stop[:, 2],
    )


def _from_numbers(listed: np.ndarray) -> tuple[Ints, np.ndarray]:
    """The earliest files: WOMD's numbers, 0 where there is no state."""
    numbers = listed.reshape(-1).astype("int64")
    return np.clip(numbers, 0, 255), numbers > 0


def _from_names(
    listed: Any, unknown_is_missing: bool, strange: set[str]
) -> tuple[Ints, np.ndarray]:
    names = [None if name is None else identifier(name) for name in listed]
    strange.update(name for name in names if name is not None and name not in STATES)
    numbers = np.array([STATES.get(name or "", 0) for name in names], "int64")
    there = np.array([name is not None for name in names], bool)
    if unknown_is_missing:
        there &= numbers > 0
    return numbers, there


def _place(points: Floats) -> Floats:
    """The last of the points (P, 2 or 3) as (3); zeros where there is none."""
    place = np.zeros(3)
    if len(points):
        place[: points.shape[1]] = points[-1]
    return place
