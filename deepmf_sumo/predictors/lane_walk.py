"""Walks along the lane graph: sequences of lanes, and the first signal on one."""

from deepmf_sumo.datatypes import SignalState
from deepmf_sumo.predictors.road_index import RoadIndex

_PASSED_M = 3.0
"""A signal counts until a vehicle is this far past it."""


def lane_sequences(
    index: RoadIndex, lane: int, along_m: float, depth_m: float, most: int
) -> list[tuple[int, ...]]:
    """At most so many sequences of lanes from a place on a lane, each as deep as wanted."""
    found: list[tuple[int, ...]] = []
    stack: list[tuple[tuple[int, ...], float]] = [((lane,), float(index.length_m[lane]) - along_m)]
    while stack and len(found) < most:
        lanes, length = stack.pop()
        following = [each for each in index.following[lanes[-1]] if each not in lanes]
        if length >= depth_m or not following:
            found.append(lanes)
        else:
            stack += [((*lanes, each), length + index.length_m[each]) for each in following[::-1]]
    return found


def first_signal(
    index: RoadIndex, lanes: tuple[int, ...], along_m: float, signals: dict[str, SignalState]
) -> tuple[float, SignalState] | None:
    """Distance to the first signal that is not behind, and its state."""
    start = -along_m
    for lane in lanes:
        state = signals.get(index.lane_ids[lane])
        if state is not None and start > -_PASSED_M:
            return start, state
        start += float(index.length_m[lane])
    return None
