"""Links between lanes for sources that have none: which follows which, which lies beside which."""

from collections.abc import Sequence
from dataclasses import replace

from deepmf_sumo.datatypes import Lane
from deepmf_sumo.readers.topology.connections import connections
from deepmf_sumo.readers.topology.neighbours import neighbours

__all__ = ["connections", "linked", "neighbours"]


def linked(lanes: Sequence[Lane]) -> dict[str, Lane]:
    """The lanes by id, with what was inferred as ``next``, ``previous``, ``left`` and ``right``."""
    follows: dict[str, list[str]] = {lane.id: [] for lane in lanes}
    precedes: dict[str, list[str]] = {lane.id: [] for lane in lanes}
    for before, after in connections(lanes):
        follows[before].append(after)
        precedes[after].append(before)
    beside = neighbours(lanes)
    return {
        lane.id: replace(
            lane,
            next=tuple(follows[lane.id]),
            previous=tuple(precedes[lane.id]),
            left=tuple(beside.left.get(lane.id, ())),
            right=tuple(beside.right.get(lane.id, ())),
        )
        for lane in lanes
    }
