"""Case + planner + policy -> Rollout: the loop over SUMO."""

import importlib
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from deepmf_sumo.sumo.simulation.episode import plain, simulate
    from deepmf_sumo.sumo.simulation.sumo_config import hold, network_case, release

__all__ = ["hold", "network_case", "plain", "release", "simulate"]

_PLACES: Final = {"plain": "episode", "simulate": "episode"}


def __getattr__(name: str) -> Any:
    """A name of the package, imported on first use: who reads SUMO's options needs none of them."""
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    module = importlib.import_module(f"{__name__}.{_PLACES.get(name, 'sumo_config')}")
    return getattr(module, name)
