"""Unpickling with a list of allowed names.

A pickle is a program: it may call whatever it names. This reader lets it name numpy's way to
rebuild arrays and scalars, plain containers, and the one dict subclass that old ScenarioNet files
use; everything else is refused by name before it is looked up. What is allowed is replaced where
the original could be made to reserve memory at will.
"""

import collections
import pickle
import pickletools
import re
from collections.abc import Callable
from io import BytesIO
from typing import Any, Final

import numpy as np

_DTYPE: Final = re.compile(r"[biufSUO][0-9]{1,4}")


class ForbiddenClassError(pickle.UnpicklingError):
    """The pickle names something that is not on the list."""

    def __init__(self, name: str) -> None:
        super().__init__(f"it names '{name}', which is no plain data and was not loaded")


class ScenarioDescription(dict):  # type: ignore[type-arg]
    """Stands for MetaDrive's class of this name, which is a dict without state of its own."""


class _TypeName:
    """Stands for a type that a pickle names as an argument: it can be named, but builds nothing."""


def load_plain(content: bytes) -> Any:
    """What the pickle holds.

    Raises:
        ForbiddenClassError: it names a class or function that is not allowed.
        pickle.UnpicklingError: it is damaged or makes no sense.
    """
    try:
        _check_memo(content)
        return _Unpickler(BytesIO(content)).load()
    except pickle.UnpicklingError:
        raise
    except Exception as error:  # noqa: BLE001 - a damaged pickle can raise anything
        raise pickle.UnpicklingError(f"it is damaged ({type(error).__name__}: {error})") from None


def _check_memo(content: bytes) -> None:
    """Refuse numbers of memo entries that only an attack on memory uses."""
    for opcode, argument, _ in pickletools.genops(content):
        entry = argument if opcode.name in {"PUT", "BINPUT", "LONG_BINPUT"} else 0
        if not isinstance(entry, int) or not 0 <= entry <= len(content):
            raise pickle.UnpicklingError(f"it stores to memo entry {argument}")


class _DType:
    """Stands for ``numpy.dtype``: numbers, booleans, text, objects, and their byte order.

    The state that a pickle gives a real dtype can hold flags that make numpy take numbers for
    pointers; here only the byte order is taken from it.
    """

    def __init__(self, code: Any, *_: Any) -> None:
        if not isinstance(code, str) or not _DTYPE.fullmatch(code):
            raise pickle.UnpicklingError(f"it holds an array of type {code!r}")
        self.real = np.dtype(code)

    def __setstate__(self, state: Any) -> None:
        order = state[1]
        if order not in {"<", ">", "|", "="}:
            raise pickle.UnpicklingError(f"it holds an array of byte order {order!r}")
        if order in {"<", ">"}:
            self.real = self.real.newbyteorder(order)


class _Array(np.ndarray):
    """An array that is filled by a pickle's state, with a dtype that cannot be forged."""

    def __setstate__(self, state: Any) -> None:
        version, shape, dtype, is_fortran, content = state
        super().__setstate__((version, shape, dtype.real, is_fortran, content))


def _empty_array(subtype: Any, shape: Any, dtype: Any) -> np.ndarray:  # noqa: ARG001
    """``numpy.core.multiarray._reconstruct``: always empty, its shape comes as state."""
    return _Array((0,), "b")


def _scalar(dtype: _DType, content: bytes | str) -> Any:
    """``numpy.core.multiarray.scalar`` for numbers and booleans."""
    raw = content.encode("latin1") if isinstance(content, str) else content
    return np.frombuffer(raw, dtype=dtype.real, count=1)[0]


def _from_buffer(content: Any, dtype: _DType, shape: Any, order: Any) -> np.ndarray:
    """``numpy._core.numeric._frombuffer``: arrays in pickles of protocol 5."""
    return np.frombuffer(content, dtype=dtype.real).reshape(shape, order=order)


def _encode(text: str, encoding: str) -> bytes:
    """``_codecs.encode``: how protocols 0 to 2 write bytes."""
    if encoding != "latin1":
        raise pickle.UnpicklingError(f"it encodes text as {encoding}")
    return text.encode("latin1")


def _no_bytes() -> bytes:
    """``bytes``: how protocols 0 to 2 write empty ones. With a number it would fill memory."""
    return b""


def _default_dict(factory: Any = None) -> dict[Any, Any]:  # noqa: ARG001
    """``collections.defaultdict`` as a plain dict: nothing asks it for keys that it lacks."""
    return {}


_DESCRIPTION = "metadrive.scenario.scenario_description"
_ALLOWED: Final[dict[tuple[str, str], Callable[..., Any]]] = {
    ("numpy", "ndarray"): _TypeName,
    ("numpy", "dtype"): _DType,
    ("numpy.core.multiarray", "_reconstruct"): _empty_array,
    ("numpy.core.multiarray", "scalar"): _scalar,
    ("numpy.core.numeric", "_frombuffer"): _from_buffer,
    ("numpy._core.multiarray", "_reconstruct"): _empty_array,
    ("numpy._core.multiarray", "scalar"): _scalar,
    ("numpy._core.numeric", "_frombuffer"): _from_buffer,
    ("_codecs", "encode"): _encode,
    ("builtins", "bytes"): _no_bytes,
    ("__builtin__", "bytes"): _no_bytes,
    ("builtins", "set"): set,
    ("builtins", "frozenset"): frozenset,
    ("__builtin__", "set"): set,
    ("__builtin__", "frozenset"): frozenset,
    ("collections", "OrderedDict"): collections.OrderedDict,
    ("collections", "defaultdict"): _default_dict,
    **{("builtins", name): _TypeName for name in ("bool", "dict", "float", "int", "list", "str")},
    (_DESCRIPTION, "ScenarioDescription"): ScenarioDescription,
}


class _Unpickler(pickle.Unpickler):
    """Knows the names of the list only."""

    def find_class(self, module_name: str, global_name: str, /) -> Any:
        """The allowed stand-in of a name. Raises ForbiddenClassError."""
        try:
            return _ALLOWED[module_name, global_name]
        except KeyError:
            raise ForbiddenClassError(f"{module_name}.{global_name}") from None

    def persistent_load(self, pid: Any) -> Any:
        """Nothing is stored elsewhere. Raises UnpicklingError."""
        raise pickle.UnpicklingError(f"it refers to {pid!r} outside itself")
