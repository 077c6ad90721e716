"""Samples of one or more sources of recordings, mixed by weight."""

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[Any]]
Progress = Callable[[str], None]
HELD_OUT: Final = 10
"""Scenes at one place in ten are kept from training: for early stopping and temperatures."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Source:
    """The samples of one file or folder of recordings.

    Attributes:
        name: of the file or folder.
        arrays: name -> (N, ...) memory-mapped.
        scene: (N) number of the scene, an index of ``scenes``.
        scenes: names of all scenes that were read. places: where each of them is.
        refused: records that could not be used, by name, each with the reason.
        digest: of the files and settings.
        weight: share in training relative to the other sources'; None goes by the samples.
    """

    name: str
    arrays: Arrays
    scene: NDArray[np.int64]
    scenes: Sequence[str]
    places: Sequence[str]
    refused: Mapping[str, str]
    digest: str
    weight: float | None = None

    @property
    def held_out(self) -> NDArray[np.bool_]:
        """(N) samples kept from training: those at one place in ten, the same in all sources.

        A place that was trained on is no test: recordings overlap there. Where this would keep
        none or all of the scenes that have samples, one in ten is kept, the last where there are
        few.
        """
        kept = np.array([zlib.crc32(place.encode()) % HELD_OUT == 0 for place in self.places], bool)
        some, place = np.unique(self.scene, return_inverse=True)  # scenes that have samples
        samples: NDArray[np.bool_] = kept[self.scene]
        if not samples.any() or samples.all():
            tenth = np.arange(len(some)) % HELD_OUT == HELD_OUT - 1
            if not tenth.any() and len(some) > 1:
                tenth[-1] = True
            samples = tenth[place]
        return samples


class Joined:
    """Arrays that differ in length alone, one after the other, read in place."""

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
class Cache:
    """N samples of all sources; make one with `mix`.

    Attributes:
        arrays: name -> (N, ...).
        scene: (N) number of the scene, counted through all sources.
        origin: (N) number of the source. held_out: (N) whether kept from training.
        chosen: (N) samples to use; None takes all.
    """

    sources: tuple[Source, ...]
    arrays: Mapping[str, Joined]
    scene: NDArray[np.int64]
    origin: NDArray[np.int64]
    held_out: NDArray[np.bool_]
    chosen: NDArray[np.bool_] | None = None

    @property
    def scenes(self) -> int:
        """How many scenes there are."""
        return sum(len(source.scenes) for source in self.sources)

    @property
    def refused(self) -> int:
        """How many records could not be used."""
        return sum(len(source.refused) for source in self.sources)

    @property
    def shares(self) -> NDArray[np.float64]:
        """(sources) their shares in training; they add up to 1."""
        counts = np.bincount(self.origin[self.rows(held_out=False)], minlength=len(self.sources))
        weights = [
            (float(count) if source.weight is None else source.weight) * (count > 0)
            for count, source in zip(counts, self.sources, strict=True)
        ]
        shares: NDArray[np.float64] = np.array(weights) / max(sum(weights), 1e-12)
        return shares

    def rows(self, *, held_out: bool, source: int | None = None) -> NDArray[np.int64]:
        """Samples of scenes that are trained on, or that are held out; of one source, or all."""
        wanted = self.held_out == held_out
        if self.chosen is not None:
            wanted &= self.chosen
        if source is not None:
            wanted &= self.origin == source
        return np.flatnonzero(wanted)

    def batch(self, rows: NDArray[np.int64]) -> Arrays:
        """The given samples, in memory."""
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


def mix(sources: Sequence[Source]) -> Cache:
    """All samples of the sources, which must hold the same features."""
    lengths = [len(source.scene) for source in sources]
    firsts = np.cumsum([0, *(len(source.scenes) for source in sources)])
    return Cache(
        sources=tuple(sources),
        arrays={
            name: Joined([source.arrays[name] for source in sources]) for name in sources[0].arrays
        },
        scene=np.concatenate(
            [source.scene + first for source, first in zip(sources, firsts, strict=False)]
        ),
        origin=np.repeat(np.arange(len(sources)), lengths),
        held_out=np.concatenate([source.held_out for source in sources]),
    )
