"""deepmf-sumo: closed-loop, safety-critical attacks on an automated vehicle in SUMO traffic."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deepmf_sumo.benchmark.live import Attacker

__version__ = "0.1.0"
__all__ = ["Attacker", "__version__"]


def __getattr__(name: str) -> Any:
    """`Attacker`, when it is asked for: what it needs takes a second to import."""
    if name == "Attacker":
        return importlib.import_module("deepmf_sumo.benchmark.live").Attacker
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
