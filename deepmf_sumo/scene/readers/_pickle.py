"""Unpickling with a list of allowed names.

A pickle is a program: it can call everything that it names. This reader allows the functions with
which numpy rebuilds arrays and scalars, plain containers, and the one dict subclass of old
ScenarioNet files; all other names are refused before they are looked up. An allowed function is
replaced where numpy's own trusts what the pickle says of an array's memory.

Nothing here limits time or memory, which a small pickle can ask for without end: lists of lists of
the same list, numbers that collide in a dict, places in a memo. Each file is read in a process that
has limits (`_bounded`), and which it can only end.
"""

import collections
import pickle
import re
from collections.abc import Callable
from io import BytesIO
from typing import Any, Final, NoReturn

import numpy as np

_DTYPE: Final = re.compile(r"[biufSUO][0-9]{1,4}")


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
    """The content of a pickle.

    Raises:
        ForbiddenClassError: it names a class or function that is not allowed.
        pickle.UnpicklingError: it is damaged or invalid.
    """
    try:
        return _Unpickler(BytesIO(content)).load()
    except (pickle.UnpicklingError, MemoryError):
        raise
    except Exception as error:  # noqa: BLE001 - a damaged pickle can raise anything
        raise pickle.UnpicklingError(f"it is damaged ({type(error).__name__}: {error})") from None


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
    """An array that is filled once, with as many items as its shape says.

    numpy copies as many pointers from a list as the shape demands, without checking its length,
    and frees the array's former content even if a view still shows it.
    """

    _filled = False

    def __setstate__(self, state: Any) -> None:
        version, shape, dtype, is_fortran, content = state
        real = _real(dtype)
        if self._filled:
            raise pickle.UnpicklingError("it fills an array twice")
        if real.hasobject:
            _refuse_pointers(shape, content)
        else:
            shape = _values(content, real, shape).shape
        self._filled = True
        checked: Any = (version, shape, real, bool(is_fortran), content)
        super().__setstate__(checked)


def _refuse_pointers(shape: Any, content: Any) -> None:
    """Raises UnpicklingError if an array of objects has not exactly the items of a list."""
    count = np.empty(shape, object).size if type(shape) is tuple else -1
    if type(content) is not list or len(content) != count:
        raise pickle.UnpicklingError(
            f"it contains an array of shape {_told(shape)} without all its objects"
        )


def _values(content: Any, dtype: np.dtype[Any], shape: Any, order: Any = "C") -> np.ndarray:
    """The array of exactly these bytes. Raises UnpicklingError if they are not its bytes."""
    try:
        if dtype.hasobject or type(content) is not bytes or type(shape) is not tuple:
            raise ValueError("its values are not written as bytes")
        return np.frombuffer(content, dtype).reshape(shape, order=order)
    except (ValueError, TypeError) as error:
        raise pickle.UnpicklingError(
            f"it contains an array of shape {_told(shape)} that cannot be made: {error}"
        ) from None


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
    return _values(raw, _real(dtype), ())[()]


def _from_buffer(content: Any, dtype: Any, shape: Any, order: Any) -> np.ndarray:
    """``numpy._core.numeric._frombuffer``: arrays in pickles of protocol 5."""
    raw = bytes(content) if type(content) is bytearray else content
    return _values(raw, _real(dtype), shape, order)


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
