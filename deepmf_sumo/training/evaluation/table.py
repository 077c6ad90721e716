"""The table of an evaluation: values of single objects -> figures.

A `Key` names what is measured, a `Figure` is the result. The screen, the cards of the weights, the
row of an ablation and the JSON are views of this one table.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, NamedTuple, Self

import numpy as np

from deepmf_sumo.deepmf.networks.weights import Network
from deepmf_sumo.scene import Floats
from deepmf_sumo.training.evaluation.measures import (
    Measured,
    difference,
    error_if_right,
    expected_error,
    mean,
    standard_error,
)

NETWORK: Final = "network"
"""Condition of the marginal network's own forecasts."""
ALL: Final = "all"
OF_MODES: Final = ("overlap_free", "on_road")
"""Shares of modes: those of one object depend on each other, so there is no standard error."""


class Key(NamedTuple):
    """What a figure is of.

    Attributes:
        condition: a network, a head of it, a baseline, or what the conditional network is given.
        horizon_s: None for figures without a horizon.
        modes: number of modes; 1 is the most probable one. None for figures without modes.
        group: of objects (``all``, ``av``, ``partner``, ``attacked``) or of the opponent's
            candidates (``all``, ``attackable``).
    """

    network: Network
    quantity: str
    horizon_s: float | None = None
    modes: int | None = None
    condition: str = NETWORK
    group: str = ALL


class Figure(NamedTuple):
    """A value; None where nothing was measured.

    Attributes:
        standard_error: of a mean over objects. objects: values that it is the mean of.
    """

    value: float | None = None
    standard_error: float | None = None
    objects: int | None = None


Figures = dict[Key, Figure]


class ObjectValues:
    """Values of single objects, in the same order under all conditions."""

    def __init__(self, network: Network) -> None:
        self.network: Network = network
        self.values: dict[Key, list[float]] = defaultdict(list)

    def add(
        self,
        measured: Mapping[Measured, float | Floats],
        modes: int | None = None,
        condition: str = NETWORK,
        groups: Iterable[str] = (ALL,),
    ) -> None:
        """One object, or several values (M) of its modes."""
        for (quantity, horizon_s), value in measured.items():
            for group in groups:
                key = Key(self.network, quantity, horizon_s, modes, condition, group)
                self.values[key].extend(np.ravel(value).tolist())

    def figures(self) -> Figures:
        """Means of all quantities, and calibration errors of the probabilities."""
        found: Figures = {}
        for key, values in self.values.items():
            if key.quantity.startswith("probability"):
                found |= self._calibration(key, np.array(values))
            elif key.quantity in OF_MODES:
                found[key] = Figure(mean(values))
            elif not key.quantity.startswith("nearest"):
                found[key] = Figure(mean(values), standard_error(values), len(values))
            if key.quantity == "log_likelihood":
                negative = found[key]._replace(value=mean([-value for value in values]))
                found[key._replace(quantity="negative_log_likelihood")] = negative
        return found

    def gains(self, quantity: str, sign: int, name: str, against: str) -> Figures:
        """Means of the paired differences of all conditions to one, times ``sign``."""
        found: Figures = {}
        for key, values in self.values.items():
            if key.quantity == quantity and key.condition != against:
                others = self.values.get(key._replace(condition=against), [])
                gain = difference(*((sign * np.array(each)).tolist() for each in (values, others)))
                found[key._replace(quantity=name)] = Figure(*gain, len(values))
        return found

    def _calibration(self, key: Key, probability: Floats) -> Figures:
        kind = key.quantity.removeprefix("probability")
        nearest = np.array(self.values[key._replace(quantity=f"nearest{kind}")], bool)
        found = {f"ece{kind}": expected_error(probability, nearest)}
        if not kind:
            modes = key.modes or 1
            right = error_if_right(probability, [modes] * (len(probability) // modes))
            found["ece_if_right"], found["ece_if_right_95"] = right or (None, None)
        return {
            key._replace(quantity=name, modes=None): Figure(value) for name, value in found.items()
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """The figures of a set of weights.

    Attributes:
        data: names of the recordings. scenes: that were used.
        attacked_scenes: simulated attacks among them.
        refused: number of records that could not be used. refusals: reasons of the first ones.
        modes: numbers of modes that were measured.
        clusters: what the baseline of clusters was fitted on.
    """

    data: Sequence[str]
    weights: str
    scenes: int
    attacked_scenes: int
    refused: int
    refusals: Sequence[str]
    labelled_objects: int
    modes: Sequence[int]
    clusters: str
    figures: Figures

    def of(self, network: Network, quantity: str, *place: Any, **names: Any) -> Figure:
        """The figure of a `Key`, or one without a value."""
        return self.figures.get(Key(network, quantity, *place, **names), Figure())

    def pivot(
        self, network: Network, quantity: str, condition: str = NETWORK, group: str = ALL
    ) -> dict[int | None, dict[float | None, Figure]]:
        """Figures by number of modes and by horizon."""
        found: dict[int | None, dict[float | None, Figure]] = {}
        for key, figure in self.figures.items():
            if (key.network, key.quantity, key.condition, key.group) == (
                network, quantity, condition, group,
            ):  # fmt: skip
                found.setdefault(key.modes, {})[key.horizon_s] = figure
        return found

    def record(self) -> dict[str, Any]:
        """For JSON: the figures as a list of rows."""
        rows = [{**key._asdict(), **figure._asdict()} for key, figure in self.figures.items()]
        return asdict(replace(self, figures={})) | {"figures": rows}

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> Self:
        """What `record` gave."""
        figures = {
            Key(*(row[name] for name in Key._fields)): Figure(
                *(row[name] for name in Figure._fields)
            )
            for row in record["figures"]
        }
        return cls(**{**record, "figures": figures})
