"""Kinds of inputs: every module here has some in ``KINDS``."""

import importlib
import pkgutil

from tests.fuzz.runner import Kind


def all_kinds() -> list[Kind]:
    """The kinds of all modules of this folder, in the order of their names."""
    names = sorted(module.name for module in pkgutil.iter_modules(__path__))
    return [kind for name in names for kind in importlib.import_module(f"{__name__}.{name}").KINDS]
