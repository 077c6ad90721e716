"""Array types, and dataclasses whose arrays are read-only."""

from dataclasses import fields
from functools import cache
from types import NoneType, UnionType
from typing import Any, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]

_DTYPES: dict[Any, Any] = {
    Floats: np.float64,
    Ints: np.int64,
    Bools: np.bool_,
    Bytes: np.uint8,
}


def dtype_of(kind: Any) -> Any:
    """The dtype of one of the types above, or of one of them or None; None for all other types.

    What ``NDArray[...]`` is made of depends on numpy's version, so types are compared as wholes.
    """
    if isinstance(kind, UnionType):
        found = [_DTYPES.get(one) for one in get_args(kind) if one is not NoneType]
        return found[0] if len(found) == 1 else None
    return _DTYPES.get(kind)


def frozen(values: ArrayLike, dtype: Any = np.float64) -> NDArray[Any]:
    """A read-only, C-contiguous copy of ``values`` with the given dtype."""
    array = np.array(values, dtype=dtype, order="C")
    array.setflags(write=False)
    return array


class Frozen:
    """Base of dataclasses: their arrays, and those in their dictionaries, are read-only copies."""

    __slots__ = ()

    def __post_init__(self) -> None:
        kind: Any = type(self)
        for name, dtype in _arrays_of(kind):
            value = getattr(self, name)
            if isinstance(value, dict):
                copied: Any = {key: frozen(one, dtype) for key, one in value.items()}
            else:
                copied = None if value is None else frozen(value, dtype)
            object.__setattr__(self, name, copied)


@cache
def _arrays_of(kind: type[Any]) -> tuple[tuple[str, Any], ...]:
    """Names and dtypes of the fields of a dataclass that are arrays or dictionaries of them."""
    listed = [(field.name, _held(field.type)) for field in fields(kind)]
    return tuple((name, dtype) for name, dtype in listed if dtype is not None)


def _held(kind: Any) -> Any:
    """The dtype of a field's array, or of the values of its dictionary."""
    return dtype_of(get_args(kind)[1]) if get_origin(kind) is dict else dtype_of(kind)
