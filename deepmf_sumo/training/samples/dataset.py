"""Samples of one or more sources: mixed by weight, filtered for a network, drawn as batches."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo.deepmf.networks.encode import OwnMotion
from deepmf_sumo.deepmf.networks.lanes import PathInfo
from deepmf_sumo.deepmf.networks.weights import Network
from deepmf_sumo.errors import RunError
from deepmf_sumo.training.samples.places import SceneArea, held_out

Arrays = dict[str, NDArray[Any]]
Progress = Callable[[str], None]
_NEAR_M = 15.0
"""The conditional network learns from pairs whose paths come this close, at any two times."""
_SORTED_BATCHES = 8
"""Within this many batches, samples with similar numbers of paths are batched together: the
networks cut a batch to the paths that it uses."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampleSource:
    """The samples of one file or folder of recordings.

    Attributes:
        name: of the file or folder.
        arrays: name -> (N, ...) memory-mapped.
        scene: (N) number of the scene, an index of ``scenes``.
        scenes: names of all scenes. areas: the area of each of them.
        refused: reasons of the records that could not be used, by name.
        digest: of the files and settings.
        weight: share in training relative to the other sources; None is the number of samples.
    """

    name: str
    arrays: Arrays
    scene: NDArray[np.int64]
    scenes: Sequence[str]
    areas: Sequence[SceneArea]
    refused: Mapping[str, str]
    digest: str
    weight: float | None = None


class Joined:
    """The concatenation of arrays that differ only in length, without a copy."""

    def __init__(self, parts: Sequence[NDArray[Any]]) -> None:
        self.parts = tuple(parts)
        self.ends = np.cumsum([len(part) for part in parts])
        self.dtype = parts[0].dtype
        self.shape: tuple[int, ...] = (int(self.ends[-1]), *parts[0].shape[1:])

    def __len__(self) -> int:
        return self.shape[0]

    def __array__(self, dtype: Any = None, copy: Any = None) -> NDArray[Any]:
        return np.concatenate(self.parts).astype(dtype or self.dtype)

    def __getitem__(self, key: Any) -> NDArray[Any]:
        """As numpy's; the first index is a number, a slice, or an array of numbers or flags."""
        if len(self.parts) == 1:
            return np.asarray(self.parts[0][key])
        rows, *rest = key if isinstance(key, tuple) else (key,)
        numbers = np.atleast_1d(np.arange(len(self))[rows])
        owner = np.searchsorted(self.ends, numbers, side="right")
        found = np.asarray(self.parts[0][(numbers[:0], *rest)])
        found = np.empty((len(numbers), *found.shape[1:]), found.dtype)
        for number in np.unique(owner):
            mine = owner == number
            first = self.ends[number] - len(self.parts[number])
            found[mine] = self.parts[number][(numbers[mine] - first, *rest)]
        return np.asarray(found[0]) if isinstance(rows, int | np.integer) else found


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dataset:
    """N samples of all sources, from `mix`.

    Attributes:
        arrays: name -> (N, ...).
        scene: (N) number of the scene, counted over all sources.
        origin: (N) number of the source. held_out: (N) whether the sample is held out.
        is_apart: whether the held-out samples are of other places than those to train on.
        chosen: (N) samples to use; None uses all.
    """

    sources: tuple[SampleSource, ...]
    arrays: Mapping[str, Joined]
    scene: NDArray[np.int64]
    origin: NDArray[np.int64]
    held_out: NDArray[np.bool_]
    is_apart: bool = True
    chosen: NDArray[np.bool_] | None = None

    @property
    def scenes(self) -> int:
        """Number of scenes."""
        return sum(len(source.scenes) for source in self.sources)

    @property
    def refused(self) -> int:
        """Number of records that could not be used."""
        return sum(len(source.refused) for source in self.sources)

    @property
    def shares(self) -> NDArray[np.float64]:
        """(sources) shares in training, with sum 1."""
        counts = np.bincount(self.origin[self.rows(held_out=False)], minlength=len(self.sources))
        weights = [
            (float(count) if source.weight is None else source.weight) * (count > 0)
            for count, source in zip(counts, self.sources, strict=True)
        ]
        shares: NDArray[np.float64] = np.array(weights) / max(sum(weights), 1e-12)
        return shares

    def rows(self, *, held_out: bool, source: int | None = None) -> NDArray[np.int64]:
        """Held-out samples or samples to train on, of one source or of all."""
        wanted = self.held_out == held_out
        if self.chosen is not None:
            wanted &= self.chosen
        if source is not None:
            wanted &= self.origin == source
        return np.flatnonzero(wanted)

    def batch(self, rows: NDArray[np.int64]) -> Arrays:
        """The arrays of the given samples, in memory."""
        order = np.argsort(rows)
        back = np.argsort(order)
        return {name: values[rows[order]][back] for name, values in self.arrays.items()}

    def names(self, rows: NDArray[np.int64]) -> list[str]:
        """``source: scene`` of each sample, without repetition."""
        found: dict[str, None] = {}
        for row in rows:
            source = self.sources[self.origin[row]]
            first = sum(len(each.scenes) for each in self.sources[: self.origin[row]])
            found[f"{source.name}: {source.scenes[self.scene[row] - first]}"] = None
        return list(found)


def mix(sources: Sequence[SampleSource]) -> Dataset:
    """All samples of sources with the same features."""
    lengths = [len(source.scene) for source in sources]
    firsts = np.cumsum([0, *(len(source.scenes) for source in sources)])
    scene = np.concatenate(
        [source.scene + first for source, first in zip(sources, firsts, strict=False)]
    )
    kept, is_apart = held_out(
        [area for source in sources for area in source.areas],
        np.bincount(scene, minlength=int(firsts[-1])),
    )
    return Dataset(
        sources=tuple(sources),
        arrays={
            name: Joined([source.arrays[name] for source in sources]) for name in sources[0].arrays
        },
        scene=scene,
        origin=np.repeat(np.arange(len(sources)), lengths),
        held_out=kept[scene],
        is_apart=is_apart,
    )


def filter_drivers(network: Network, dataset: Dataset, report: Progress) -> Dataset:
    """Drop samples of drivers that a network does not learn from, and report their number.

    Raises RunError if none is left.
    """
    if network == "opponent":
        without = dataset.scenes - len(np.unique(dataset.scene))
        if without:
            report(
                f"opponent: {without} scenes have no samples: attacks, or no vehicle near the AV"
            )
    if network != "marginal":
        return dataset
    by_people = _by_people(dataset)
    if not by_people.all():
        report(f"marginal: {(~by_people).sum()} samples with a planner as the driver are left out")
    lacks = "The marginal network learns from human drivers, and planners drive in all samples"
    return _chosen(dataset, by_people, lacks)


def filter_pairs(dataset: Dataset) -> Dataset:
    """The samples that the conditional network learns from. Raises RunError if there are none."""
    lacks = "No two vehicles come near each other in these recordings"
    return _chosen(dataset, _interacting(dataset), lacks)


def _chosen(dataset: Dataset, rows: NDArray[np.bool_], lacks: str) -> Dataset:
    dataset = replace(dataset, chosen=rows)
    if not len(dataset.rows(held_out=False)):
        raise RunError(f"{lacks}; give more recordings.")
    return dataset


def _by_people(dataset: Dataset) -> NDArray[np.bool_]:
    """(N) samples of vehicles with a human driver."""
    driver = np.asarray(dataset.arrays["motion"])[:, OwnMotion.PLANNER]
    return np.asarray(driver == 0.0)


def _interacting(dataset: Dataset) -> NDArray[np.bool_]:
    """(N) samples with a partner whose path comes close."""
    near = np.zeros(len(dataset.scene), bool)
    for begin in range(0, len(near), 1024):
        rows = slice(begin, begin + 1024)
        own = np.asarray(dataset.arrays["future"][rows, 4::5])
        other = np.asarray(dataset.arrays["partner"][rows, 4::5, :2])
        apart = np.linalg.norm(own[:, :, None] - other[:, None], axis=-1)  # (., 16, 16)
        unknown = np.asarray(dataset.arrays["future_valid"][rows, 4::5]) == 0
        least = np.where(unknown[:, :, None], np.inf, apart).min(axis=(1, 2))
        near[rows] = (least < _NEAR_M) & (np.asarray(dataset.arrays["partner_known"][rows]) > 0)
    return near


def batches(
    dataset: Dataset, size: int, seed: int, first: int, stop: int
) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """(step, rows) for the steps from ``first`` up to but not including ``stop``.

    An epoch has as many samples as there are to train on. The number from each source is drawn by
    its share; each source cycles through its samples, so that all of them are used equally often.
    """
    size = min(size, len(dataset.rows(held_out=False)))
    an_epoch = len(dataset.rows(held_out=False)) // size
    rounds = [
        _Round(dataset.rows(held_out=False, source=number), [seed, number])
        for number in range(len(dataset.sources))
    ]
    used = _paths_used(dataset)
    for epoch in range(-(-stop // an_epoch)):
        rng = np.random.default_rng([seed, epoch])
        counts = rng.multinomial(an_epoch * size, dataset.shares)
        drawn = [each.take(int(count)) for each, count in zip(rounds, counts, strict=True)]
        begin = epoch * an_epoch
        if begin + an_epoch <= first:
            continue
        order = rng.permutation(np.concatenate(drawn))
        if used is not None:
            chunks = np.array_split(order, max(an_epoch // _SORTED_BATCHES, 1))
            order = np.concatenate([c[np.argsort(used[c], kind="stable")] for c in chunks])
        turns = rng.permutation(an_epoch)
        for step in range(max(first, begin), min(stop, begin + an_epoch)):
            yield step, order.reshape(an_epoch, size)[turns[step - begin]]


class _Round:
    """Cycles through the samples of one source, each time in another random order."""

    def __init__(self, rows: NDArray[np.int64], seed: list[int]) -> None:
        self.rows, self.seed = rows, seed
        self.round = 0
        self.left = rows[:0]

    def take(self, count: int) -> NDArray[np.int64]:
        taken = [self.left[:count]]
        self.left = self.left[count:]
        while count > sum(map(len, taken)):
            rng = np.random.default_rng([*self.seed, 1, self.round])
            order = rng.permutation(self.rows)
            missing = count - sum(map(len, taken))
            taken.append(order[:missing])
            self.left = order[missing:]
            self.round += 1
        return np.concatenate(taken)


def _paths_used(dataset: Dataset) -> NDArray[np.int64] | None:
    paths = dataset.arrays.get("path_info")
    if paths is None:
        return None
    used: NDArray[np.int64] = (paths[:, :, PathInfo.THERE] > 0).sum(1)
    return used
