"""Unpickling with a list of allowed names.

A pickle is a program: it can call everything that it names. This reader allows the functions with
which numpy rebuilds arrays and scalars, plain containers, and the one dict subclass of old
ScenarioNet files; all other names are refused before they are looked up. An allowed function is
replaced if the original could reserve any amount of memory, or trusts the pickle's claims.

A small pickle can also expand: a list that contains one list twice, which contains another twice,
and so on, has a few bytes, but becomes gigabytes of text or arrays. `check_extent` refuses it.
"""

import collections
import math
import pickle
import pickletools
import re
from collections.abc import Callable, Iterable
from io import BytesIO
from typing import Any, Final, NoReturn

import numpy as np

MOST_OPERATIONS: Final = 2_000_000
"""Of one pickle; the largest known scene has 100 000. Each needs up to a few hundred bytes."""
LARGEST_NUMBER: Final = 8
"""Bytes of a whole number. Longer ones can be chosen so that a dict of them takes hours to fill."""

DEEPEST: Final = 16
"""Containers in containers; scenes have 7."""
MOST_ITEMS: Final = 10_000_000
"""Of all containers and arrays, counted at each occurrence; large scenes have 1 000 000."""

_DTYPE: Final = re.compile(r"[biufSUO][0-9]{1,4}")
_MOST_DIMENSIONS: Final = 8
_STORES: Final = {"PUT", "BINPUT", "LONG_BINPUT"}


class ForbiddenClassError(pickle.UnpicklingError):
    """The pickle names something that is not on the list."""

    def __init__(self, name: str) -> None:
        super().__init__(f"it names '{name[:100]}', which is not plain data and was not loaded")


class _Fixed(type):
    """A class that a pickle cannot change: pickles can set attributes of everything they name."""

    def __setattr__(cls, name: str, value: object) -> NoReturn:
        raise pickle.UnpicklingError(f"it sets '{name}' of a class")


class ScenarioDescription(dict, metaclass=_Fixed):  # type: ignore[type-arg]
    """Replaces MetaDrive's class of this name, which is a dict without state of its own."""

    __slots__ = ()


class _TypeName(metaclass=_Fixed):
    """Replaces a type that a pickle names as an argument: it can be named, but builds nothing."""

    __slots__ = ()


class _Function:
    """A function that a pickle can call, but not change."""

    __slots__ = ("_call",)

    def __init__(self, call: Callable[..., Any]) -> None:
        self._call = call

    def __call__(self, *arguments: Any) -> Any:
        return self._call(*arguments)

    def __setstate__(self, state: object) -> NoReturn:
        raise pickle.UnpicklingError("it changes a function")


def load_plain(content: bytes) -> Any:
    """The content of a pickle, at most as deep and large as `check_extent` allows.

    Raises:
        ForbiddenClassError: it names a class or function that is not allowed.
        pickle.UnpicklingError: it is damaged or invalid.
    """
    try:
        _check_operations(content)
        loaded = _Unpickler(BytesIO(content)).load()
        check_extent(loaded)
    except (pickle.UnpicklingError, MemoryError):
        raise
    except Exception as error:  # noqa: BLE001 - a damaged pickle can raise anything
        raise pickle.UnpicklingError(f"it is damaged ({type(error).__name__}: {error})") from None
    return loaded


def _check_operations(content: bytes) -> None:
    """Refuse operations that only occur in attacks on memory or time."""
    for count, (opcode, argument, _) in enumerate(pickletools.genops(content)):
        if count >= MOST_OPERATIONS:
            raise pickle.UnpicklingError(f"it has more than {MOST_OPERATIONS} operations")
        entry = argument if opcode.name in _STORES else 0
        if not isinstance(entry, int) or not 0 <= entry <= len(content):
            raise pickle.UnpicklingError(f"it stores to memo entry {argument}")
        bits = argument.bit_length() if isinstance(argument, int) else 0
        if bits > 8 * LARGEST_NUMBER:
            raise pickle.UnpicklingError(f"it contains a number of {bits} bits")


class _DType:
    """Replaces ``numpy.dtype``: numbers, booleans, text, objects, and their byte order.

    The state that a pickle gives a real dtype can contain flags that make numpy use numbers as
    pointers; here only the byte order is read from it.
    """

    __slots__ = ("real",)

    def __init__(self, code: Any, *_: Any) -> None:
        if not isinstance(code, str) or not _DTYPE.fullmatch(code):
            raise pickle.UnpicklingError(f"it contains an array of type {_told(code)}")
        self.real = np.dtype(code)

    def __setstate__(self, state: Any) -> None:
        order = state[1]
        if order not in ("<", ">", "|", "="):
            raise pickle.UnpicklingError(f"it contains an array of byte order {_told(order)}")
        if order in ("<", ">"):
            self.real = self.real.newbyteorder(order)


class _Array(np.ndarray):
    """An array that is filled once, by a state that was checked.

    numpy copies as many pointers from a list as the shape demands, without checking its length,
    and frees the array's former content even if a view still shows it.
    """

    _filled = False

    def __setstate__(self, state: Any) -> None:
        version, shape, dtype, is_fortran, content = state
        if self._filled:
            raise pickle.UnpicklingError("it fills an array twice")
        _check_content(shape, _real(dtype), content)
        self._filled = True
        checked: Any = (version, shape, dtype.real, bool(is_fortran), content)
        super().__setstate__(checked)


def _check_content(shape: Any, dtype: np.dtype[Any], content: Any) -> None:
    """Refuse an array without all its items: a list of objects, or the bytes of other types."""
    sound = isinstance(shape, tuple) and len(shape) <= _MOST_DIMENSIONS
    if not sound or not all(type(size) is int and 0 <= size < 2**31 for size in shape):
        raise pickle.UnpicklingError(f"it contains an array of shape {_told(shape)}")
    # numpy multiplies the sizes that are not 0, too
    count, extent = math.prod(shape), math.prod(size for size in shape if size)
    if dtype.hasobject:
        there, needed = (len(content) if type(content) is list else -1), count
    else:
        there, needed = (len(content) if type(content) is bytes else -1), count * dtype.itemsize
    if there != needed or extent >= 2**31:
        kind = "objects" if dtype.hasobject else "bytes"
        raise pickle.UnpicklingError(
            f"it contains an array of shape {_told(shape)} with {there} {kind}, not {needed}"
        )


def _told(value: Any) -> str:
    """A value in an error message, cut: it can be arbitrarily long."""
    plain = isinstance(value, int) or (
        isinstance(value, tuple) and all(type(one) is int for one in value[:10])
    )
    if isinstance(value, str):
        return repr(value[:40])
    return (
        repr(value[:10] if isinstance(value, tuple) else value)
        if plain
        else f"a {type(value).__name__}"
    )


def _real(dtype: Any) -> np.dtype[Any]:
    if type(dtype) is not _DType:
        raise pickle.UnpicklingError(f"it contains an array of type {type(dtype).__name__}")
    return dtype.real


def _empty_array(subtype: Any, shape: Any, dtype: Any) -> np.ndarray:  # noqa: ARG001
    """``numpy.core.multiarray._reconstruct``: always empty, its shape comes as state."""
    return _Array((0,), "b")


def _scalar(dtype: Any, content: Any) -> Any:
    """``numpy.core.multiarray.scalar`` for numbers, booleans and text."""
    raw = content.encode("latin1") if isinstance(content, str) else content
    real = _real(dtype)
    if real.hasobject:
        raise pickle.UnpicklingError("it contains a scalar of type 'object'")
    _check_content((), real, raw)
    return np.frombuffer(raw, dtype=real, count=1)[0]


def _from_buffer(content: Any, dtype: Any, shape: Any, order: Any) -> np.ndarray:
    """``numpy._core.numeric._frombuffer``: arrays in pickles of protocol 5."""
    raw, real = bytes(content) if type(content) is bytearray else content, _real(dtype)
    if real.hasobject:
        raise pickle.UnpicklingError("it uses numbers as objects")
    _check_content(shape, real, raw)
    return np.frombuffer(raw, dtype=real).reshape(shape, order=order)


def _encode(text: str, encoding: str) -> bytes:
    """``_codecs.encode``: how protocols 0 to 2 write bytes."""
    if encoding != "latin1":
        raise pickle.UnpicklingError(f"it encodes text as {_told(encoding)}")
    return text.encode("latin1")


def _no_bytes() -> bytes:
    """``bytes``: how protocols 0 to 2 write empty ones. With a number it would fill memory."""
    return b""


def _default_dict(factory: Any = None) -> dict[Any, Any]:  # noqa: ARG001
    """``collections.defaultdict`` as a plain dict: no code looks up its missing keys."""
    return {}


_DESCRIPTION = "metadrive.scenario.scenario_description"
_ALLOWED: Final[dict[tuple[str, str], Callable[..., Any]]] = {
    ("numpy", "ndarray"): _TypeName,
    ("numpy", "dtype"): _Function(_DType),
    ("numpy.core.multiarray", "_reconstruct"): _Function(_empty_array),
    ("numpy.core.multiarray", "scalar"): _Function(_scalar),
    ("numpy.core.numeric", "_frombuffer"): _Function(_from_buffer),
    ("numpy._core.multiarray", "_reconstruct"): _Function(_empty_array),
    ("numpy._core.multiarray", "scalar"): _Function(_scalar),
    ("numpy._core.numeric", "_frombuffer"): _Function(_from_buffer),
    ("_codecs", "encode"): _Function(_encode),
    ("builtins", "bytes"): _Function(_no_bytes),
    ("__builtin__", "bytes"): _Function(_no_bytes),
    ("builtins", "set"): set,
    ("builtins", "frozenset"): frozenset,
    ("__builtin__", "set"): set,
    ("__builtin__", "frozenset"): frozenset,
    ("collections", "OrderedDict"): collections.OrderedDict,
    ("collections", "defaultdict"): _Function(_default_dict),
    **{("builtins", name): _TypeName for name in ("bool", "dict", "float", "int", "list", "str")},
    (_DESCRIPTION, "ScenarioDescription"): ScenarioDescription,
}


class _Unpickler(pickle.Unpickler):
    """Allows the names of the list only."""

    def find_class(self, module_name: str, global_name: str, /) -> Any:
        """The replacement of an allowed name. Raises ForbiddenClassError."""
        try:
            return _ALLOWED[module_name, global_name]
        except KeyError:
            raise ForbiddenClassError(f"{module_name}.{global_name}") from None

    def persistent_load(self, pid: Any) -> Any:
        """Raises UnpicklingError: references to other storage are not allowed."""
        raise pickle.UnpicklingError(f"it refers to {_told(pid)} outside itself")


def check_extent(value: Any) -> None:
    """Raises UnpicklingError if the value is too deep, too large, or contains itself."""
    _extent(value, 0, {})


def _extent(value: Any, depth: int, known: dict[int, tuple[int, int]]) -> tuple[int, int]:
    """Its number of items and the depth of its containers; ``known`` are those of containers."""
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        return value.size, 0
    parts = _parts(value)
    if parts is None:
        return 1, 0
    if id(value) not in known:
        if depth > DEEPEST:
            raise pickle.UnpicklingError(
                f"its lists are more than {DEEPEST} deep, or contain themselves"
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
    """The parts of a container; None if the value is not one."""
    if isinstance(value, dict):
        return (part for pair in value.items() for part in pair)
    if isinstance(value, list | tuple | set | frozenset):
        return value
    if isinstance(value, np.ndarray):
        return value.flat
    return None
