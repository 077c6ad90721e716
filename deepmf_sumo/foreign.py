"""Code of others in this process: what it sets in libraries holds in that code alone.

How numpy treats a division by zero, torch's kind of numbers, warnings that are errors and the
decimal point of the C library belong to the process. A planner may set them for itself, e.g.
``np.seterr(all="raise")``; ours would then compute other numbers, or none. So they change at the
boundary: inside they are as that code has left them, outside as they were.
"""

import locale
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import local
from typing import Any, Final, NamedTuple


class _Kind(NamedTuple):
    """Settings of one library; ``first`` are those with which it begins."""

    module: str
    now: Callable[[Any], Any]
    set: Callable[[Any, Any], None]
    first: Callable[[Any], Any]


_theirs: dict[str, Any] = {}
"""What code of others has set, by library, where it has set something."""
_thread = local()
"""``inside``: code of others is running."""


@contextmanager
def code() -> Iterator[None]:
    """While code of others runs: with its own settings of libraries, which end with the block."""
    if getattr(_thread, "inside", False):  # a planner that uses one of ours
        yield
        return
    ours = _now()
    _set(_theirs)
    _thread.inside = True
    try:
        yield
    finally:
        _thread.inside = False
        after = _now()
        before = {name: ours[name] if name in ours else _first(name) for name in after}
        changed = {name for name, value in after.items() if value != before[name]}
        _theirs.update({name: after[name] for name in changed | (after.keys() & _theirs.keys())})
        _set({name: before[name] for name in changed})


@contextmanager
def called() -> Iterator[None]:
    """While a program of others calls us: numpy and torch are as they begin, not as it set them."""
    loaded = _now()
    before: dict[str, Any] = {name: loaded[name] for name in ("errors", "torch") if name in loaded}
    _set({name: _first(name) for name in before})
    try:
        yield
    finally:
        _set(before)


def _now() -> dict[str, Any]:
    """Settings of the libraries that are loaded."""
    return {
        name: kind.now(sys.modules[kind.module])
        for name, kind in _KINDS.items()
        if kind.module in sys.modules
    }


def _first(name: str) -> Any:
    kind = _KINDS[name]
    return kind.first(sys.modules[kind.module])


def _set(wanted: dict[str, Any]) -> None:
    for name, value in wanted.items():
        _KINDS[name].set(sys.modules[_KINDS[name].module], value)


def _errors(numpy: Any) -> Any:
    return numpy.geterr(), numpy.geterrcall()


def _set_errors(numpy: Any, wanted: Any) -> None:
    numpy.seterr(**wanted[0])
    numpy.seterrcall(wanted[1])


@dataclass(frozen=True)
class _Filters:
    """Of warnings. They differ where others are errors: a library that is loaded adds its own."""

    errors: list[Any]
    every: list[Any] = field(compare=False)


def _filters(_: Any) -> Any:
    every = list(warnings.filters)
    return _Filters([one for one in every if one[0] == "error"], every)


def _set_filters(_: Any, wanted: Any) -> None:
    warnings.resetwarnings()  # it also tells Python that they have changed
    warnings.filters.extend(wanted.every)  # type: ignore[attr-defined]


def _point(_: Any) -> Any:
    return locale.setlocale(locale.LC_NUMERIC)


def _set_point(_: Any, wanted: Any) -> None:
    locale.setlocale(locale.LC_NUMERIC, wanted)


def _torch(torch: Any) -> Any:
    device = torch.get_default_device()
    return (
        torch.get_num_threads(),
        torch.get_default_dtype(),
        None if device.type == "cpu" else device,
        torch.is_grad_enabled(),
        torch.are_deterministic_algorithms_enabled(),
        torch.is_deterministic_algorithms_warn_only_enabled(),
        torch.get_float32_matmul_precision(),
    )


def _set_torch(torch: Any, wanted: Any) -> None:
    threads, dtype, device, gradients, deterministic, warn, precision = wanted
    torch.set_num_threads(threads)
    torch.set_default_dtype(dtype)
    torch.set_default_device(device)
    torch.set_grad_enabled(gradients)
    torch.use_deterministic_algorithms(deterministic, warn_only=warn)
    torch.set_float32_matmul_precision(precision)


def _first_torch(torch: Any) -> Any:
    threads = int(os.environ.get("OMP_NUM_THREADS", "") or torch.get_num_threads())
    return threads, torch.float32, None, True, False, False, "highest"


_KINDS: Final = {
    "errors": _Kind(
        "numpy",
        _errors,
        _set_errors,
        lambda _: ({"divide": "warn", "over": "warn", "under": "ignore", "invalid": "warn"}, None),
    ),
    "warnings": _Kind("warnings", _filters, _set_filters, _filters),
    "point": _Kind("locale", _point, _set_point, _point),
    "torch": _Kind("torch", _torch, _set_torch, _first_torch),
}
