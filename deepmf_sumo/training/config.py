"""The configuration of ``train``: a training in strict YAML, and the defaults of each network."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BeforeValidator, Field

from deepmf_sumo.deepmf.networks.weights import Network
from deepmf_sumo.errors import UsageError
from deepmf_sumo.spec.document import Document, read
from deepmf_sumo.spec.loading import checked
from deepmf_sumo.spec.model import ExistingPath, Strict
from deepmf_sumo.training.samples.feature_cache import Data

Precision = Literal["auto", "bf16", "fp32"]
DEFAULTS: Final[dict[Network, dict[str, Any]]] = {
    "opponent": {
        "steps": 900,
        "batch": 32,
        "rate": 2e-3,
        "weight_decay": 0.05,
        "ema": 0.998,
        "precision": "fp32",
    },
    "marginal": {"steps": 4000},
    "conditional": {"steps": 4000, "rate": 1.5e-3, "precision": "fp32"},
    "people": {"steps": 3000, "weight_decay": 0.05, "ema": 0.995, "precision": "fp32"},
    "strive": {"steps": 2000, "batch": 32, "ema": 0.99, "precision": "fp32"},
    "diffscene": {"steps": 4000, "ema": 0.998, "precision": "fp32"},
}
"""Defaults that differ from those of `Optimisation.with_defaults`."""
PRESETS: Final[dict[Network, str]] = {
    "opponent": "light",
    "marginal": "vector",
    "conditional": "vector",
    "people": "vector",
    "strive": "light",
    "diffscene": "light",
}
"""Sizes of each network. Images add nothing to the trajectories (studies/notebook/ablation.md)."""
MEMBERS: Final = 1
"""Members of the marginal network. A second one lowers errors of 16 and 32 modes, not of 6."""
MOST_MEMBERS: Final = 8
_FINE_RATE: Final = 5e-4
"""Learning rate of a network that starts from the weights of another set."""


class Optimisation(Strict):
    """How to train a network; None is the network's default."""

    steps: int | None = Field(default=None, ge=1, description="gradient steps")
    batch: int | None = Field(default=None, ge=1, description="samples a step")
    rate: float | None = Field(default=None, gt=0, le=1, description="highest learning rate")
    fresh_rate: float | None = Field(
        default=None,
        gt=0,
        le=1,
        description="of layers with random initial weights in a network that has others",
    )
    weight_decay: float | None = Field(default=None, ge=0, le=1, description="of AdamW")
    clip: float | None = Field(default=None, gt=0, description="largest norm of the gradient")
    ema: float | None = Field(
        default=None, ge=0, lt=1, description="decay of the average of the weights; 0: none"
    )
    precision: Precision | None = Field(
        default=None, description="auto: bf16 where the processor has it, else fp32"
    )
    evaluate_every: int | None = Field(default=None, ge=1, description="steps between evaluations")
    patience: int | None = Field(
        default=None, ge=0, description="evaluations without gain after which to stop; 0: never"
    )

    def over(self, other: "Optimisation") -> "Optimisation":
        """These settings; those that are None are the other's."""
        own = {name: getattr(self, name) for name in Optimisation.model_fields}
        return Optimisation(
            **{
                name: getattr(other, name) if value is None else value
                for name, value in own.items()
            }
        )

    def with_defaults(self, network: Network, *, began: bool) -> dict[str, Any]:
        """All values; those that are None are the network's defaults, else the common ones."""
        given = {name: value for name, value in dict(self).items() if value is not None}
        common: dict[str, Any] = {
            "batch": 64,
            "rate": 2e-3,
            "fresh_rate": 4e-3,
            "weight_decay": 0.02,
            "clip": 5.0,
            "ema": 0.0,
            "precision": "auto",
            "patience": 0,
        }
        values = common | DEFAULTS[network] | ({"rate": _FINE_RATE} if began else {}) | given
        values.setdefault("evaluate_every", min(250, max(values["steps"] // 4, 1)))
        return values


class DataEntry(Strict):
    """A source of recordings, and its share in training relative to the others."""

    path: ExistingPath
    weight: float | None = Field(default=None, gt=0)


def _entry(value: Any) -> Any:
    return {"path": value} if isinstance(value, str) else value


DataEntries = Annotated[list[Annotated[DataEntry, BeforeValidator(_entry)]], Field(min_length=1)]
"""At least one source; a path alone is one without a weight."""


OfOne = Annotated[Optimisation, Field(description="the keys above, for this network alone")]


class Config(Optimisation):
    """A training: its data, the optimisation, and that of single networks."""

    version: Literal[1]
    data: DataEntries | None = Field(default=None, description="sources, in place of --data")
    preset: str | None = Field(default=None, description="sizes, see the table below")
    begin_from: str | None = Field(
        default=None, description="set of weights whose networks give the initial weights"
    )
    seed: int | None = Field(
        default=None, ge=0, lt=2**31, description="of initial weights and samples"
    )
    licence: str | None = Field(default=None, description="written to the card")
    members: int | None = Field(
        default=None,
        ge=1,
        le=MOST_MEMBERS,
        description="number of marginal networks that predict together",
    )
    opponent: OfOne = Optimisation()
    marginal: OfOne = Optimisation()
    conditional: OfOne = Optimisation()
    people: OfOne = Optimisation()
    strive: OfOne = Optimisation()
    diffscene: OfOne = Optimisation()

    def of(self, network: Network) -> Optimisation:
        """How to train one network; its own settings take precedence."""
        own: Optimisation = getattr(self, network)
        return own.over(self)

    def sources(self) -> list[Data]:
        """The recordings."""
        return [Data(path=entry.path, weight=entry.weight) for entry in self.data or ()]


def load(file: Path | None, sets: Sequence[str] = ()) -> Config:
    """The configuration in a file, to which its paths are relative, with ``key=value`` over it.

    Without a file that of ``sets`` alone, its paths relative to the working folder. Raises
    SpecError for anything wrong, with file, line and key.
    """
    document = read(file) if file else Document(Path("--set"), {"version": 1})
    for assignment in sets:
        document.assign(assignment)
    context = {"folder": str(file.parent if file else ".")}
    config: Config = checked(Config, document.values, (), document, context)
    check_weights(config.sources(), f"{document.place(('data',))}: key 'data'")
    return config


def parsed(text: str) -> Data:
    """``PATH`` or ``PATH=WEIGHT``. Raises UsageError if the weight is not a number above 0."""
    path, equals, weight = text.rpartition("=")
    if not equals or Path(text).exists():
        return Data(path=Path(text))
    try:
        value = float(weight)
    except ValueError:
        value = 0.0
    if not (path and 0 < value < float("inf")):
        raise UsageError(
            f"--data {text}: '{weight}' is not a weight; give PATH=WEIGHT, e.g. {path}=2."
        )
    return Data(path=Path(path), weight=value)


def check_weights(data: list[Data], place: str = "--data") -> None:
    """Raises UsageError if some sources have a weight and others do not."""
    without = [entry.path.name for entry in data if entry.weight is None]
    if 0 < len(without) < len(data):
        raise UsageError(
            f"{place}: {', '.join(without)} has no weight, but other sources have one; give a"
            " weight for all sources or for none."
        )
