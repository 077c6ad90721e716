"""What to train, to measure and to vary, in strict YAML."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, Self

import yaml
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from deepmf_sumo import spec
from deepmf_sumo.deepmf.networks.config import Preset, changed, preset_named
from deepmf_sumo.errors import SpecError, WeightsError
from deepmf_sumo.spec import Spec
from deepmf_sumo.spec.document import Document, read
from deepmf_sumo.spec.loading import checked
from deepmf_sumo.spec.model import ExistingPath, Strict
from deepmf_sumo.spec.tasks import slug
from deepmf_sumo.training import config
from deepmf_sumo.training.config import Config, DataEntries

BASE: Final = "base"
"""Name of the variant that changes nothing."""


class Variant(Strict):
    """One row of the table."""

    name: str = Field(min_length=1, max_length=60)
    sizes: dict[str, Any] = Field(
        default_factory=dict,
        description="sizes of a preset: marginal and conditional network are trained for them",
    )
    attack: dict[str, Any] = Field(
        default_factory=dict, description="settings of the adversary; nothing is trained for them"
    )


class Plan(Config):
    """A training as for ``train --config``, what to measure it on, and its variants.

    Attributes:
        test: recordings to evaluate and to attack, none of them in ``data``.
        study: the spec of the attack; its source and its weights are replaced.
        planners: planners to attack, by their name in the table: dotted keys of the study and
            their values.
    """

    data: DataEntries
    begin_from: None = Field(
        default=None, description="variants of other sizes start from random weights"
    )
    members: None = Field(default=None, description="each variant has one")
    preset: str = Field(default="light", description="sizes of the base's networks, all three")
    test: ExistingPath
    study: ExistingPath
    planners: dict[str, dict[str, Any]] = Field(min_length=1)
    variants: tuple[Variant, ...] = Field(default=(), strict=False)

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        for key, names in (
            ("variants", [variant.name for variant in self.all_variants]),
            ("planners", list(self.planners)),
        ):
            folders = [slug(name) for name in names]
            twice = next(
                (n for n, f in zip(names, folders, strict=True) if folders.count(f) > 1), ""
            )
            if twice:
                raise _wrong(
                    key, f"two {key} are named '{twice}'; '{BASE}' is the row that changes nothing"
                )
        return self

    @model_validator(mode="after")
    def _tested_on_others(self) -> Self:
        for entry in self.data:
            if entry.path.is_relative_to(self.test) or self.test.is_relative_to(entry.path):
                raise _wrong("test", f"{self.test} is trained on ('data'); give other recordings")
        return self

    @property
    def all_variants(self) -> tuple[Variant, ...]:
        """The base, then all others in the order of the file."""
        return (Variant(name=BASE), *self.variants)

    def trained_for(self, variant: Variant) -> Variant:
        """The first variant of the same sizes, whose networks this one uses too."""
        return next(one for one in self.all_variants if one.sizes == variant.sizes)

    def preset_of(self, variant: Variant) -> Preset:
        """Sizes of a variant's networks. Raises WeightsError for impossible sizes."""
        base = preset_named(self.preset)
        return changed(base, slug(variant.name), variant.sizes) if variant.sizes else base

    def spec_of(self, variant: Variant, planner: str, weights: Path | None = None) -> Spec:
        """The attack on one planner, by default with the weights that the study names.

        Its name, and so the random numbers of its runs, are the same for all variants. Raises
        SpecError.
        """
        values = {
            **self.planners[planner],
            "source.recording": str(self.test),
            **{f"adversary.{key}": value for key, value in variant.attack.items()},
            **({"weights": str(weights.resolve())} if weights else {}),
        }
        return spec.load(self.study, [f"{key}={_yaml(value)}" for key, value in values.items()])


def load(file: Path, sets: Sequence[str] = ()) -> Plan:
    """The plan in a file, with ``key=value`` assignments over it; paths are relative to the file.

    Raises SpecError for anything wrong, with file, line and key. The settings of all attacks are
    checked too, so that no error appears after hours of training.
    """
    document = read(file)
    for assignment in sets:
        document.assign(assignment)
    plan: Plan = checked(Plan, document.values, (), document, {"folder": str(file.parent)})
    config.check_weights(plan.sources(), f"{document.place(('data',))}: key 'data'")
    for place, variant in _places(plan, document):
        try:
            plan.preset_of(variant)
        except WeightsError as error:
            raise SpecError(f"{place}: variant '{variant.name}': {error}") from None
        for planner in plan.planners:
            try:
                plan.spec_of(variant, planner)
            except SpecError as error:
                what = f"variant '{variant.name}', planner '{planner}'"
                raise SpecError(f"{place}: {what}: {error}") from None
    return plan


def _places(plan: Plan, document: Document) -> Iterator[tuple[str, Variant]]:
    for number, variant in enumerate(plan.all_variants, start=-1):
        path = ("study",) if number < 0 else ("variants", number)
        yield document.place(path), variant


def _wrong(key: str, rule: str) -> PydanticCustomError:
    return PydanticCustomError("rule", "{rule}", {"rule": rule, "key": key})


def _yaml(value: Any) -> str:
    """In one line."""
    text = yaml.safe_dump(value, default_flow_style=True, width=float("inf"), allow_unicode=True)
    return text.removesuffix("\n").removesuffix("\n...")
