"""Array types, and dataclasses whose arrays are read-only."""

from dataclasses import fields
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]

_DTYPES: dict[Any, Any] = {Floats: np.float64, Bools: np.bool_, Bytes: np.uint8}


def dtype_of(kind: Any) -> Any:
    """The dtype of one of the types above, which `Frozen` copies; None for all others.

    What ``NDArray[...]`` is made of depends on numpy's version, so types are compared as wholes.
    """
    return _DTYPES.get(kind)


def frozen(values: ArrayLike, dtype: Any = np.float64) -> NDArray[Any]:
    """A read-only, C-contiguous copy of ``values`` with the given dtype."""
    array = np.array(values, dtype=dtype, order="C")
    array.setflags(write=False)
    return array


class Frozen:
    """Base of dataclasses: their fields of the types above become read-only copies."""

    __slots__ = ()

    def __post_init__(self) -> None:
        kind: Any = type(self)
        for name, dtype in _arrays_of(kind):
            object.__setattr__(self, name, frozen(getattr(self, name), dtype))


@cache
def _arrays_of(kind: type[Any]) -> tuple[tuple[str, Any], ...]:
    """Names and dtypes of the array fields of a dataclass."""
    listed = [(field.name, dtype_of(field.type)) for field in fields(kind)]
    return tuple((name, dtype) for name, dtype in listed if dtype is not None)
