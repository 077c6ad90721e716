"""deepmf-sumo: closed-loop, safety-critical attacks on an automated vehicle in SUMO traffic."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deepmf_sumo.live.attacker import Attacker
    from deepmf_sumo.results.results import Results

__version__ = "0.1.0"
__all__ = ["Attacker", "Results", "__version__"]


_HOMES = {"Attacker": "deepmf_sumo.live", "Results": "deepmf_sumo.results.results"}


def __getattr__(name: str) -> Any:
    """`Attacker` or `Results`, imported on first use: what they need takes a second to import."""
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
