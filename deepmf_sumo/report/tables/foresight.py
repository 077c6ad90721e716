"""Which methods know what DeepMF has to predict, so that readers of a table compare like with like.

An adversary that simulates the scene before it attacks says what it learns there in the constant
``FORESIGHT`` of its module.
"""

from typing import Any, Final

from deepmf_sumo import plugins
from deepmf_sumo.benchmark.study import Layout
from deepmf_sumo.spec.loading import VERSIONS

_MEANT: Final = (
    "What a method looks up it learns from simulations of the same scene before its attack: under"
    " a replayed AV that is the AV's future itself. The others see the past alone. Who begins at"
    " the opponent's un-attacked motion is near the recording, with which naturalness compares, by"
    " construction."
)


def of(layout: Layout) -> list[str]:
    """Sentences: methods with foresight by what they look up; none where there are none."""
    methods: dict[str, list[str]] = {}
    for label in layout.methods:
        name = _adversary(layout.plan["methods"][label].get("adversary", "deepmf"))
        known = getattr(plugins.load("adversaries", name), "FORESIGHT", None)
        if known is not None:
            methods.setdefault(known, []).append(label)
    lines = [f"{', '.join(labels)}: looked up: {known}." for known, labels in methods.items()]
    return [*lines, _MEANT] if lines else []


def _adversary(choice: str | dict[str, Any]) -> str:
    """Name of the plug-in that a plan's method means."""
    name = choice if isinstance(choice, str) else str(choice.get("name", "deepmf"))
    return "deepmf" if name in VERSIONS else name
