"""By which rule DeepMF's rows choose their attacks: the paper's is one of several."""

from collections.abc import Sequence
from typing import Any, Final

from deepmf_sumo.benchmark.study import Layout
from deepmf_sumo.spec.loading import VERSIONS

_PAPERS: Final = "expected"
"""The rule of DeepMF where nothing else is said, and of the paper's Algorithm 1."""


def title(layout: Layout, methods: Sequence[str]) -> str:
    """What a table's title says of the rules of its rows of DeepMF; empty without such rows."""
    rules = dict.fromkeys(_by_method(layout, methods).values())
    return f" (DeepMF's rule: {', '.join(rules)})" if rules else ""


def notes(layout: Layout) -> list[str]:
    """A sentence a rule that is not the paper's: which methods choose by it."""
    labels: dict[str, list[str]] = {}
    for label, rule in _by_method(layout, layout.methods).items():
        labels.setdefault(rule, []).append(label)
    return [
        f"{', '.join(found)}: attacks chosen by {rule}, not by the paper's product (rule"
        f" {_PAPERS})."
        for rule, found in labels.items()
        if rule != _PAPERS
    ]


def _by_method(layout: Layout, methods: Sequence[str]) -> dict[str, str]:
    found = {label: _rule(layout.plan["methods"][label].get("adversary", {})) for label in methods}
    return {label: rule for label, rule in found.items() if rule}


def _rule(choice: str | dict[str, Any]) -> str:
    """The rule of a plan's method; empty where it is not DeepMF."""
    settings = {"name": choice} if isinstance(choice, str) else choice
    if settings.get("name", "deepmf") not in {"deepmf", *VERSIONS}:
        return ""
    if settings.get("aggressiveness") is not None:
        return f"aggressiveness {settings['aggressiveness']:g}"
    return str(settings.get("rule", _PAPERS))
