"""Attacks in a running simulation of another program: as a client of its port, or in its script.

A live attack sees and drives as the loop of `deepmf_sumo.sumo.simulation` does, but another program
steps SUMO (AlpaSim its own world), and the AV is never commanded. It shares the record of an
episode, the schedule of attacks and the judge; it has one episode and therefore one try.

Why it is as it is:

- SUMO's time is compared before each step: a script that loads a state begins anew.
- Commands of a client of `serve` that name a file are rewritten (`kept_files`), all else passes.
- Only a live attack subscribes, to the AV's surroundings: there each question is a message.

The room is optional: only commands, and the public name ``Attacker``, import it.
"""

import importlib
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from deepmf_sumo.live.attacker import Attached, Attacker, AttackRequest, attach, prepare
    from deepmf_sumo.live.server import SumoServer
    from deepmf_sumo.live.status import StatusServer

__all__ = [
    "Attached",
    "AttackRequest",
    "Attacker",
    "StatusServer",
    "SumoServer",
    "attach",
    "prepare",
]

MARK: Final = "deepmf_sumo "
"""How names of our points of interest begin, in SUMO and in results of subscriptions."""

_PLACES: Final = {"SumoServer": "server", "StatusServer": "status"}


def __getattr__(name: str) -> Any:
    """A name of the room, imported on first use: the process of the relay needs none of them."""
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    module = importlib.import_module(f"{__name__}.{_PLACES.get(name, 'attacker')}")
    return getattr(module, name)
