"""How deep and how large what a pickle holds is when it is written out.

A list that holds one list twice, which holds another twice, and so on, takes some bytes in a pickle
and gigabytes where it is made text or an array.
"""

import pickle
from collections.abc import Iterable
from typing import Any, Final

import numpy as np

DEEPEST: Final = 16
"""Containers in containers; scenes have 7."""
MOST_ITEMS: Final = 10_000_000
"""Of all containers and arrays, each as often as it stands there; large scenes have 1 000 000."""


def check_extent(value: Any) -> None:
    """Raises UnpicklingError where the value is too deep, too large, or holds itself."""
    _extent(value, 0, {})


def _extent(value: Any, depth: int, known: dict[int, tuple[int, int]]) -> tuple[int, int]:
    """Items in it, and containers in containers below it; ``known`` are those looked at."""
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        return value.size, 0
    parts = _parts(value)
    if parts is None:
        return 1, 0
    if id(value) not in known:
        if depth > DEEPEST:
            raise pickle.UnpicklingError(
                f"its lists are more than {DEEPEST} deep, or hold themselves"
            )
        items, height = 1, 0
        for part in parts:
            more, high = _extent(part, depth + 1, known)
            items, height = items + more, max(height, high + 1)
            if items > MOST_ITEMS:
                raise pickle.UnpicklingError(f"it unfolds to more than {MOST_ITEMS} items")
        known[id(value)] = items, height
    if depth + known[id(value)][1] > DEEPEST + 1:
        raise pickle.UnpicklingError(f"its lists are more than {DEEPEST} deep")
    return known[id(value)]


def _parts(value: Any) -> Iterable[Any] | None:
    """What a container holds; None of what is none."""
    if isinstance(value, dict):
        return (part for pair in value.items() for part in pair)
    if isinstance(value, list | tuple | set | frozenset):
        return value
    if isinstance(value, np.ndarray):
        return value.flat
    return None
