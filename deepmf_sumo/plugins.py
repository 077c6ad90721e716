"""Plug-ins: a module in a folder of its kind, or a class of an installed package.

A plug-in module has ``Settings`` (a `plugins.Settings` subclass) and ``build(settings, ...)``. The
folder's listing is the registry. An exporter has ``write(run, path, settings)`` in place of
``build``, see `deepmf_sumo.exporters`; a metric is a function in a module of its folder. Other
packages join through the entry point group ``deepmf_sumo.<kind>``, or by
``my_package.my_module:MyClass``.
"""

import functools
import importlib
import importlib.metadata
import pkgutil
from typing import Any, Final, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from deepmf_sumo import foreign
from deepmf_sumo.errors import PluginError, nearest

Kind = Literal["readers", "planners", "adversaries", "metrics", "exporters"]
_ROOMS: Final[dict[Kind, tuple[str, ...]]] = {
    "readers": ("scene.readers",),
    "planners": ("planners",),
    "adversaries": ("attacks", "baselines"),
    "metrics": ("judge.metrics",),
    "exporters": ("exporters",),
}
"""Folders of the package that contain the plug-ins of a kind."""


class Settings(BaseModel):
    """Base of all plug-in settings: strict types, no unknown keys, immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


def names(kind: Kind) -> list[str]:
    """Names of all plug-ins of a kind, sorted."""
    return sorted({*_own(kind), *(point.name for point in _entry_points(kind))})


def own(kind: Kind, name: str) -> bool:
    """Whether a plug-in belongs to this package."""
    return name in _own(kind) and all(point.name != name for point in _entry_points(kind))


def module_of(kind: Kind, name: str) -> str | None:
    """The module of a plug-in that is not of this package; None of its own, and of none."""
    if ":" in name:
        return name.partition(":")[0]
    return next((point.module for point in _entry_points(kind) if point.name == name), None)


@functools.cache
def _own(kind: Kind) -> dict[str, str]:
    """Modules of this package's plug-ins by name; cached, because folders are slow to list."""
    found: dict[str, str] = {}
    for room in _ROOMS[kind]:
        package = importlib.import_module(f"deepmf_sumo.{room}")
        if kind == "metrics":
            return dict.fromkeys(package.own(), package.__name__)
        found |= {
            module.name: f"{package.__name__}.{module.name}"
            for module in pkgutil.iter_modules(package.__path__)
            if module.name != "base" and not module.name.startswith("_") and not module.ispkg
        }
    return found


def load(kind: Kind, name: str) -> Any:
    """The plug-in of a name: a module, a `metrics.Metric`, or for ``package.module:Class`` a class.

    Raises PluginError with the nearest name if there is none.
    """
    if ":" in name:
        return _load_class(kind, name)
    for point in _entry_points(kind):
        if point.name == name:
            with foreign.code():
                return point.load()
    if name not in _own(kind):
        known = names(kind)
        raise PluginError(
            f"No plug-in '{name}' in {kind}.{nearest(name, known)} Known: {', '.join(known)}."
        )
    module = importlib.import_module(_own(kind)[name])
    return module.own()[name] if kind == "metrics" else module


def settings(kind: Kind, name: str, values: dict[str, Any], *, texts: bool = False) -> Any:
    """The plug-in's checked settings. Raises PluginError naming the key, its value, the rule.

    ``texts``: the values are texts of a command line, and are read as the types of their keys.
    """
    schema = settings_class(kind, name)
    try:
        if texts:
            return schema.model_validate_strings(values, strict=False)
        return schema.model_validate(values)
    except ValidationError as error:
        raise PluginError(f"{kind} '{name}': {explain(error, schema)}") from None


def settings_class(kind: Kind, name: str) -> type[BaseModel]:
    """The class of a plug-in's settings. Raises PluginError where it lacks that or ``build``."""
    plugin = load(kind, name)
    found = getattr(plugin, "Settings", None)
    if not (isinstance(found, type) and issubclass(found, BaseModel)):
        raise PluginError(
            f"{name} has no class 'Settings'; derive one from deepmf_sumo.plugins.Settings."
        )
    if ":" in name and not callable(getattr(plugin, "build", None)):
        raise PluginError(f"{name} has no 'build', which makes one of its Settings.")
    return found


def explain(error: ValidationError, schema: type[BaseModel], *, tagged: bool = False) -> str:
    """One sentence for the first problem that pydantic found, with the nearest key.

    ``tagged``: ``schema`` was chosen from a discriminated union, whose tag leads all locations.
    """
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"][tagged:])
    if first["type"] == "extra_forbidden":
        hint = nearest(str(first["loc"][-1]), schema.model_fields)
        known = (
            f"Known: {', '.join(schema.model_fields)}." if schema.model_fields else "There is none."
        )
        return f"unknown key '{key}'.{hint} {known}"
    return f"'{key}' is {first['input']!r}: {first['msg']}."


@functools.cache
def _entry_points(kind: Kind) -> tuple[importlib.metadata.EntryPoint, ...]:
    """Entry points of a kind, cached: reading them visits every installed package."""
    return tuple(importlib.metadata.entry_points(group=f"deepmf_sumo.{kind}"))


def _load_class(kind: Kind, name: str) -> Any:
    module_name, _, class_name = name.partition(":")
    try:
        with foreign.code():
            return getattr(importlib.import_module(module_name), class_name)
    except (ImportError, AttributeError) as error:
        raise PluginError(f"{kind} '{name}' cannot be imported: {error}.") from None
    except (
        Exception,
        SystemExit,
    ) as error:  # whatever the user's code raises
        what = f"{type(error).__name__}: {error}"
        raise PluginError(f"{kind} '{name}' cannot be imported: {what}.") from error
