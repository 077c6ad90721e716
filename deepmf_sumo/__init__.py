"""deepmf-sumo: closed-loop, safety-critical attacks on an automated vehicle in SUMO traffic.

What ``__all__`` lists is public; everything else may change.

- `run`: run specs, or a plan of methods and planners, and write a result folder.
- `attack`: attack vehicles of SUMO configurations at moments that are chosen; no spec needed.
- `Results`: the runs of result folders; ``frame()`` is a pandas table.
- `Attacker`: attacks in a SUMO that a TraCI script steps.
- `AttackEnv`: a Gymnasium environment in which the AV is attacked (extra ``gym``).
- `read_scenes`: recorded scenes of any format that is read.
- `load_predictors`: the networks of a set of weights.
- `Plan`: the trajectory that a policy drives an opponent along, with the reason for it.
"""

import importlib
from typing import TYPE_CHECKING, Any

from deepmf_sumo import _moved

if TYPE_CHECKING:
    from deepmf_sumo.api import attack, read_scenes, run
    from deepmf_sumo.deepmf.networks.weights import load as load_predictors
    from deepmf_sumo.gym import AttackEnv
    from deepmf_sumo.live.attacker import Attacker
    from deepmf_sumo.results.reader import Results
    from deepmf_sumo.scene import Plan

__version__ = "0.2.0"
__all__ = [
    "AttackEnv",
    "Attacker",
    "Plan",
    "Results",
    "__version__",
    "attack",
    "load_predictors",
    "read_scenes",
    "run",
]

_PLACES = {
    "AttackEnv": ("gym", "AttackEnv"),
    "Attacker": ("live.attacker", "Attacker"),
    "Plan": ("scene", "Plan"),
    "Results": ("results.reader", "Results"),
    "attack": ("api", "attack"),
    "load_predictors": ("deepmf.networks.weights", "load"),
    "read_scenes": ("api", "read_scenes"),
    "run": ("api", "run"),
}

_moved.install()


def __getattr__(name: str) -> Any:
    """A public name, imported on first use: what they need takes a second to import."""
    if name in _PLACES:
        module, attribute = _PLACES[name]
        return getattr(importlib.import_module(f"deepmf_sumo.{module}"), attribute)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


def __dir__() -> list[str]:
    """The public names."""
    return list(__all__)
