"""Folders of the release before under their old names, for plug-ins and scripts that import them.

``deepmf_sumo.datatypes`` is `deepmf_sumo.scene` now, and so on: an old name gives the module of
today, with a warning that names it. What has gone inside a folder is not brought back. The next
release drops this module.
"""

import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import sys
import warnings
from collections.abc import Sequence
from types import ModuleType
from typing import Final

MOVED: Final = {
    "adversaries": "attacks",
    "avoidability": "judge.avoidability",
    "countermeasures": "roadcheck.countermeasures",
    "datatypes": "scene",
    "gate": "results.gate",
    "geometry": "scene.geometry",
    "metrics": "judge.metrics",
    "moments": "study.moments",
    "network": "sumo.network",
    "plans": "study.plans",
    "predictors": "deepmf.networks",
    "readers": "scene.readers",
    "recording": "training.recording",
    "risk": "results.risk",
    "screening": "roadcheck.screening",
    "shrink": "study.shrink",
    "simulation": "sumo.simulation",
    "sweep": "study.sweep",
    "tasks": "spec.tasks",
}
"""By the first name below the package: where it is now."""
_PACKAGE: Final = __name__.partition(".")[0]


def today(name: str) -> str | None:
    """The module of today for the full name of one; None if it was not moved."""
    package, _, rest = name.partition(".")
    first, _, below = rest.partition(".")
    if package != _PACKAGE or first not in MOVED:
        return None
    return ".".join(filter(None, (package, MOVED[first], below)))


class Finder(importlib.abc.Loader):
    """Finds modules under the names that they had."""

    @classmethod
    def find_spec(
        cls,
        name: str,
        path: Sequence[str] | None = None,  # noqa: ARG003
        target: ModuleType | None = None,  # noqa: ARG003
    ) -> importlib.machinery.ModuleSpec | None:
        """Of a module that was moved; None of all others."""
        if today(name) is None:
            return None
        return importlib.machinery.ModuleSpec(name, cls(), is_package=True)

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        """The module of today itself, so that both names have the same classes."""
        name = today(spec.name)
        assert name is not None
        warnings.warn(
            f"{spec.name} is {name} now; the next release does not know the old name",
            FutureWarning,
            stacklevel=2,
        )
        module = importlib.import_module(name)
        self._own = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Nothing: it has been executed; it keeps its own spec."""
        module.__spec__ = self._own


def install() -> None:
    """Let old names be found, once in a process.

    First of all finders: others would find modules below a moved folder, and load them twice.
    """
    if Finder not in sys.meta_path:
        sys.meta_path.insert(0, Finder)
