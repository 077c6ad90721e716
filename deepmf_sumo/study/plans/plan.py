"""``run PLAN``: methods, planners, scenes, seeds and budgets, in strict YAML."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    Tag,
    model_validator,
)
from pydantic_core import PydanticCustomError

import deepmf_sumo
from deepmf_sumo.errors import SpecError, UsageError, nearest
from deepmf_sumo.spec import FromMoments, ProfileName, SearchBudget, profiles
from deepmf_sumo.spec.document import Document, read
from deepmf_sumo.spec.loading import checked
from deepmf_sumo.spec.model import First, Seed, Source, Strict, Turns, Version
from deepmf_sumo.spec.tasks import slug


def _distinct(values: tuple[Any, ...]) -> tuple[Any, ...]:
    """A value that is given twice would be counted twice."""
    for value in values:
        if values.count(value) > 1:
            rule = f"'{value}' is given twice; leave one of them out"
            raise PydanticCustomError("rule", "{rule}", {"rule": rule})
    return values


Distinct = AfterValidator(_distinct)
Names = Annotated[tuple[str, ...], Field(strict=False), Distinct]
Simulations = Annotated[int, Field(ge=1)]
Seconds = Annotated[float, Field(gt=0)]


class Subset(Strict):
    """Some of the plan's planners (none: all) and scenes."""

    planners: Names = ()
    scenes: Annotated[
        Annotated[Literal["all"], Tag("(all)")] | Annotated[First, Tag("(first)")],
        Discriminator(lambda value: "(all)" if isinstance(value, str) else "(first)"),
    ] = "all"


class Method(Subset):
    """How attacks are found: an adversary as in a spec, its profile, its budget, and its weights.

    Attributes:
        profile, weights: else the plan's.
        figures_only: run for figures, without a row in tables.
    """

    adversary: str | dict[str, Any]
    profile: ProfileName | None = None
    budget: SearchBudget = SearchBudget()
    weights: str | None = None
    figures_only: bool = False


class EqualSeconds(Subset):
    """Methods that search, again with the same time; the others appear beside them unchanged."""

    seconds: Seconds
    methods: Annotated[Names, Field(min_length=1)]


class Points(Strict):
    """Budgets of a curve."""

    simulations: Annotated[tuple[Simulations, ...], Field(strict=False), Distinct] = ()
    seconds: Annotated[tuple[Seconds, ...], Field(strict=False), Distinct] = ()

    @property
    def budgets(self) -> tuple[SearchBudget, ...]:
        """A budget a point."""
        by_number = tuple(SearchBudget(simulations=number) for number in self.simulations)
        return by_number + tuple(SearchBudget(seconds=float(limit)) for limit in self.seconds)


class BudgetCurves(Subset):
    """Rate against budget, by method."""

    methods: dict[str, Points] = Field(min_length=1)


class Tables(Strict):
    """Which methods appear in which table.

    Attributes:
        baseline: what the paired differences are taken to; None is the first method.
        versions: rows of the first table; by default those of DeepMF.
        compared: rows of the others; by default the baseline and all that are not DeepMF.
    """

    baseline: str | None = None
    versions: Names | None = None
    compared: Names | None = None


def _listed(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else [value]


def _method(value: Any) -> Any:
    return {"adversary": value} if isinstance(value, str) else value


class StudyPlan(Strict):
    """What is compared on what."""

    version: Version
    name: str = Field(min_length=1, max_length=200)
    source: Annotated[
        tuple[Source, ...], Field(strict=False, min_length=1), BeforeValidator(_listed)
    ]
    duration_s: float = Field(default=8.0, ge=0.1, le=3600)
    traffic: Literal["log", "sumo"] | None = Field(
        default=None, description="log for recordings, sumo for networks"
    )
    profile: ProfileName | None = Field(
        default=None, description="of all methods that name none; fair by default, of version 3"
    )
    opponents: Literal["one", "in_turn"] | None = Field(
        default=None, description="as in a spec, for all methods"
    )
    turns: Turns | None = Field(default=None, description="as in a spec")
    weights: str = "open"
    seeds: Annotated[tuple[Seed, ...], Field(strict=False, min_length=1), Distinct] = (0,)
    planners: dict[str, str | dict[str, Any]]
    methods: dict[str, Annotated[Method, BeforeValidator(_method)]]
    tables: Tables = Tables()
    equal_seconds: EqualSeconds | None = None
    curves: BudgetCurves | None = None

    @model_validator(mode="before")
    @classmethod
    def _moments_of_the_version(cls, values: Any) -> Any:
        if not isinstance(values, dict) or values.get("version") != 3 or "source" not in values:
            return values
        return {**values, "source": [*map(profiles.with_moments, _listed(values["source"]))]}

    @model_validator(mode="after")
    def _moments_have_one_seed(self) -> Self:
        if len(self.seeds) > 1 and any(isinstance(one, FromMoments) for one in self.source):
            raise _wrong("seeds", "moments are those of one traffic: give one seed with 'moments'")
        return self

    @model_validator(mode="after")
    def _labels_differ(self) -> Self:
        for key, labels in (("methods", self.methods), ("planners", self.planners)):
            if not labels:
                raise _wrong(key, f"the plan has no {key}; name at least one")
            slugs = [slug(label) for label in labels]
            for label, short in zip(labels, slugs, strict=True):
                if slugs.count(short) > 1:
                    raise _wrong(key, f"two of them would have the folder name '{short}': {label}")
        return self

    @model_validator(mode="after")
    def _labels_are_known(self) -> Self:
        tables, equal, curves = self.tables, self.equal_seconds, self.curves
        used: list[tuple[str, Iterable[str], Iterable[str]]] = [
            ("tables.baseline", [tables.baseline] if tables.baseline else [], self.methods),
            ("tables.versions", tables.versions or [], self.methods),
            ("tables.compared", tables.compared or [], self.methods),
            ("equal_seconds.methods", equal.methods if equal else [], self.methods),
            ("equal_seconds.planners", equal.planners if equal else [], self.planners),
            ("curves.methods", curves.methods if curves else [], self.methods),
            ("curves.planners", curves.planners if curves else [], self.planners),
        ]
        used += [
            (f"methods.{label}.planners", method.planners, self.planners)
            for label, method in self.methods.items()
        ]
        for key, labels, known in used:
            for label in labels:
                if label not in known:
                    hint = nearest(label, known)
                    rule = f"'{label}' is none of the plan's.{hint} Known: {', '.join(known)}"
                    raise _wrong(key, rule)
        return self

    @model_validator(mode="after")
    def _tables_have_rows(self) -> Self:
        shown = [label for label, method in self.methods.items() if not method.figures_only]
        if not shown:
            raise _wrong("methods", "all are run for figures alone; tables need one at least")
        tables, equal = self.tables, self.equal_seconds
        for key, labels in (
            ("tables.baseline", [tables.baseline] if tables.baseline else []),
            ("tables.versions", tables.versions or []),
            ("tables.compared", tables.compared or []),
            ("equal_seconds.methods", equal.methods if equal else []),
        ):
            for label in labels:
                if label not in shown:
                    raise _wrong(key, f"'{label}' is run for figures alone (figures_only)")
        return self


@dataclass(frozen=True)
class Loaded:
    """A plan and the document that it was read from, which knows where each key is."""

    plan: StudyPlan
    document: Document


PAPER: Final = Path("paper")
"""The plan of the paper's tables, which comes with the package: it is named like this."""


def is_plan(file: Path) -> bool:
    """Whether a file holds a plan, by its keys, or is the name of a plan of the package.

    Raises SpecError for a file that cannot be read.
    """
    if _is_packaged(file):
        return True
    keys = read(file).values.keys()
    return "methods" in keys or ("planners" in keys and "variants" not in keys)


def _is_packaged(file: Path) -> bool:
    return file == PAPER and not file.is_file()  # --out paper makes a folder of this name


def packaged() -> Path:
    """The file of the paper's plan: package data, or that of a checkout.

    Raises UsageError if the installation has neither.
    """
    package = Path(deepmf_sumo.__file__).resolve().parent
    for place in (package / "starter" / "paper.yaml", package.parent / "studies" / "paper.yaml"):
        if place.is_file():
            return place
    raise UsageError(f"The installation in {package} lacks paper.yaml: install it again.")


def load(file: Path, sets: Sequence[str] = (), without: Sequence[str] = ()) -> Loaded:
    """The plan in a file, with ``key=value`` assignments over it, and without some methods.

    Raises SpecError for anything wrong, with file, line and key. Adversaries and planners are
    checked by `entries.entries_of`.
    """
    document = read(packaged() if _is_packaged(file) else file)
    document.file = file  # paths in a plan of the package are relative to the working folder
    for assignment in sets:
        document.assign(assignment)
    _leave_out(document, without)
    context = {"folder": str(file.parent)}
    return Loaded(checked(StudyPlan, document.values, (), document, context), document)


def _leave_out(document: Document, without: Sequence[str]) -> None:
    """Take methods out of all lists of a plan. Raises SpecError for one that is not there."""
    methods = document.values.get("methods")
    known = methods if isinstance(methods, dict) else {}
    for label in without:
        if label not in known:
            hint = nearest(label, known)
            raise SpecError(f"--without {label}: the plan has no such method.{hint}")
        del known[label]
        for key in ("tables", "equal_seconds", "curves"):
            part = document.values.get(key)
            for name, values in list(part.items()) if isinstance(part, dict) else ():
                if not isinstance(values, list | dict) or label not in values:
                    continue
                values.remove(label) if isinstance(values, list) else values.pop(label)
                if name == "methods" and not values:  # all that it was about is left out
                    del document.values[key]


def _wrong(key: str, rule: str) -> PydanticCustomError:
    return PydanticCustomError("rule", "{rule}", {"rule": rule, "key": key})
