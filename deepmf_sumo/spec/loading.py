"""Spec file -> `Spec`, or one line that says what is wrong and where."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ValidationError

from deepmf_sumo import plugins
from deepmf_sumo.errors import PluginError, SpecError
from deepmf_sumo.spec.document import Document, KeyPath, read
from deepmf_sumo.spec.model import Plugin, Spec, placed, unknown_key

VERSIONS: Final[dict[str, float | None]] = {"G": None, "S1": 1.0, "S2": 2.0, "S4": 4.0}
"""The paper's versions of DeepMF: seconds between plans; G plans once."""

_DEEPMF: Final = ("deepmf", *VERSIONS)


def load(path: Path, sets: Sequence[str] = ()) -> Spec:
    """The spec in a file, with ``key=value`` assignments over it (dotted keys, YAML values).

    Raises SpecError for anything wrong: file, YAML, keys, types, values, plug-ins, their settings.
    """
    document = read(path)
    expand(document)
    for assignment in sets:
        assign(document, assignment)
    return of_document(document)


def assign(document: Document, assignment: str) -> None:
    """Apply ``key=value``; short forms are written out, so that the next one may name their keys.

    Raises SpecError.
    """
    document.assign(assignment)
    expand(document, override=True)


def of_document(document: Document) -> Spec:
    """The spec that a document holds, paths relative to its file. Raises SpecError as `load`."""
    expand(document)
    _place_files(document)
    context = {"folder": str(document.file.parent)}
    spec: Spec = checked(Spec, document.values, (), document, context)
    _check_plugin("planners", "planner", spec.planner, document)
    _check_plugin("adversaries", "adversary", spec.adversary, document)
    _check_sight(spec, document)
    if spec.opponents == "in_turn" and not takes_turns(spec):
        raise SpecError(
            f"{document.place(('opponents',))}: key 'opponents': in_turn is for an adversary that"
            f" chooses opponents by score as it goes (deepmf, none); {_one_opponent(spec)}."
            " Leave it at one."
        )
    return spec


def _check_sight(spec: Spec, document: Document) -> None:
    """SUMO's own model asks no view, so that nothing can be hidden from it."""
    lane = spec.planner.settings.get("perception", "lane") == "lane"
    if spec.av_sees == "all" or not (spec.planner.name == "sumo" or (_idm(spec) and lane)):
        return
    cure = "set planner.perception to corridor" if _idm(spec) else "choose another planner"
    raise SpecError(
        f"{document.place(('av_sees',))}: key 'av_sees': in_sight is for planners that decide by"
        f" what they are shown; SUMO's own model sees everybody. Leave it at all, or {cure}."
    )


def _idm(spec: Spec) -> bool:
    return spec.planner.name == "idm"


def takes_turns(spec: Spec) -> bool:
    """Whether the spec's adversary can choose one opponent after another."""
    choice = spec.adversary
    settings = plugins.settings("adversaries", choice.name, choice.settings)
    return bool(getattr(settings, "takes_turns", False))


def _one_opponent(spec: Spec) -> str:
    """Why there is only one opponent."""
    named = spec.adversary.settings.get("opponent")
    if spec.adversary.name in _DEEPMF and named is not None:
        return f"adversary.opponent is '{named}'"
    if spec.adversary.settings.get("tries", 1) != 1:
        return "several tries (adversary.tries) are for one opponent"
    return f"{spec.adversary.name} looks for one attack"


def expand(document: Document, *, override: bool = False) -> None:
    """Write short forms out: ``planner: idm``, ``adversary: S1``, ``adversary: {version: S1}``."""
    values = document.values
    for key in ("planner", "adversary"):
        if isinstance(values.get(key), str):
            values[key] = {"name": values[key]}
    if isinstance(values.get("planner"), dict):
        values["planner"].setdefault("name", "idm")
    adversary = values.get("adversary")
    if not isinstance(adversary, dict) or adversary.get("name", "deepmf") not in _DEEPMF:
        return
    key = "version" if "version" in adversary else "name"
    version = adversary.get(key, "deepmf")
    if isinstance(version, str) and version in VERSIONS:
        if "period_s" in adversary and not override:
            raise SpecError(
                f"{document.place(('adversary', 'period_s'))}: key 'adversary.period_s': version"
                f" {version} sets it already; leave one of them out."
            )
        adversary["period_s"] = VERSIONS[adversary.pop(key)]
    elif key == "version":
        raise SpecError(
            f"{document.place(('adversary', key))}: key 'adversary.version': {version!r} must be"
            f" one of {', '.join(VERSIONS)}."
        )
    adversary.setdefault("name", "deepmf")


def _place_files(document: Document) -> None:
    """Make ``adversary.file`` and ``planner.file`` absolute, as `source` makes its paths."""
    for key in ("planner", "adversary"):
        choice = document.values.get(key)
        if isinstance(choice, dict) and isinstance(choice.get("file"), str):
            choice["file"] = str(placed(document.file.parent, choice["file"]))


def _check_plugin(kind: plugins.Kind, key: str, choice: Plugin, document: Document) -> None:
    place = f"{document.place((key, 'name'))}: key '{key}.name'"
    try:
        model = plugins.settings_class(kind, choice.name)
    except PluginError as error:
        raise SpecError(f"{place}: {error}") from None
    checked(model, choice.settings, (key,), document)


def checked(
    model: type[BaseModel],
    values: dict[str, Any],
    at: KeyPath,
    document: Document,
    context: dict[str, str] | None = None,
) -> Any:
    """``values`` as ``model``; they hang under the key path ``at`` of the document.

    Raises SpecError for the first key that is wrong, with its place.
    """
    try:
        return model.model_validate(values, context=context)
    except ValidationError as error:
        first = error.errors()[0]
    path = [*at, *_walk(values, first["loc"])]
    named = first.get("ctx", {}).get("key")
    rule = first["msg"].removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        rule = unknown_key(str(path[-1]), model)
    elif first["type"] == "missing":
        path.append(first["loc"][-1])
    elif first["type"] == "too_short" and not first["input"]:
        rule = "is empty"
    elif named:
        path += named.split(".")
    elif first["input"] is not values:
        rule = f"{_short(first['input'])}: {rule}{_yaml_trap(first)}"
    key = ".".join(str(part) for part in path)
    place = document.place(tuple(path))
    raise SpecError(f"{place}: key '{key}': {rule.rstrip('.')}." if key else f"{place}: {rule}.")


def _walk(values: Any, loc: Sequence[str | int]) -> Iterator[str | int]:
    """The parts of pydantic's location that are keys of the document; its union tags are not."""
    for part in loc:
        known = part in values if isinstance(values, dict) else isinstance(values, list | tuple)
        if known and (isinstance(values, dict) or isinstance(part, int)):
            values = values[part]
            yield part


def _yaml_trap(problem: Any) -> str:
    value = problem["input"]
    if isinstance(value, bool) and "string" in problem["type"]:
        return " (YAML reads yes, no, on and off as booleans: put it in quotes)"
    if isinstance(value, str) and ("float" in problem["type"] or "int" in problem["type"]):
        return " (text; YAML wants 1.0e-3 for 1e-3, and numbers without quotes)"
    if isinstance(value, int | float) and "string" in problem["type"]:
        return " (a number; put it in quotes)"
    return ""


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
