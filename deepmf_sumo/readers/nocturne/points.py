"""Points and vectors as these files write them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from deepmf_sumo.datatypes import Floats


def points(written: Any) -> Floats:
    """(P, 3) from ``{"x": [..], "y": [..]}`` or ``[{"x": .., "y": ..}, ..]``; a missing z is 0.

    Raises KeyError, TypeError or ValueError where it is neither.
    """
    if isinstance(written, Mapping):
        columns = [np.asarray(written[axis], float) for axis in ("x", "y")]
        columns.append(np.asarray(written.get("z", np.zeros(len(columns[0]))), float))
        return np.column_stack(columns)
    if not isinstance(written, Sequence):
        raise TypeError(f"points are written as {type(written).__name__}")
    flat = np.fromiter(
        (value for one in written for value in (one["x"], one["y"], one.get("z", 0.0))), float
    )
    return flat.reshape(-1, 3)
