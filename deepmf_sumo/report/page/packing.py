"""Numbers as small text: whole units, differences of differences, deflated, in base 64.

The page restores them with ``unpacked`` and ``restored`` of ``assets/packing.js``.
"""

import base64
import json
import zlib
from typing import Any

import numpy as np

from deepmf_sumo.datatypes import Floats, Ints


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
