"""Which scenes were recorded at one place, and which places are held out from training.

Two scenes are of one place if a vehicle of the first was ever within 100 m of where a vehicle of
the second ever was, and so are all scenes that are connected in this way. So roads that a network
was trained on cannot be roads that it is tested on, whichever files the scenes came from.

The packaged weights were trained before, with cells of 500 m by the AV's position as places: there,
two scenes at either side of a border could be on both sides.
"""

import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo.scene import Scene

APART_M: Final = 100.0
"""Vehicles of two places are never closer."""
CELL_M: Final = 20.0
"""Positions are kept as cells of this size; places are apart by the cells' diagonal more."""
HELD_OUT: Final = 10
"""One place in ten is held out from training, for early stopping and temperatures,"""
MOST: Final = 0.5
"""with at most this share of the samples."""


@dataclass(frozen=True, slots=True)
class SceneArea:
    """Where the vehicles of a scene were.

    Attributes:
        frame: what its positions refer to: empty for recordings, which share the frame of their
            data set, else the name of the network.
        cells: (column, row) of the cells of `CELL_M` in which a vehicle ever was, sorted.
    """

    frame: str
    cells: tuple[tuple[int, int], ...]

    @classmethod
    def read(cls, record: Mapping[str, Any]) -> Self:
        """From the fields of `dataclasses.asdict`, as JSON holds them."""
        return cls(record["frame"], tuple((int(x), int(y)) for x, y in record["cells"]))


def area_of(scene: Scene) -> SceneArea:
    """The area of a scene.

    Each network has its own frame: scenes of SUMO traffic name a configuration or a generated
    network as their source, others a recorded file.
    """
    vehicles = np.array([kind == "vehicle" for kind in scene.tracks.kinds], bool)
    seen = scene.tracks.valid & vehicles[:, None]
    cells = np.unique(np.floor(scene.tracks.position_m[seen] / CELL_M).astype(int), axis=0)
    source = Path(scene.source.file)
    name = source.name if source.suffix in {"", ".sumocfg"} else ""
    return SceneArea(name, tuple((x, y) for x, y in cells.tolist()))


def numbered(areas: Sequence[SceneArea]) -> NDArray[np.int64]:
    """(S) number of the place of each scene, counted in the order of the scenes."""
    place = np.zeros(len(areas), np.int64)
    first = 0
    for frame in dict.fromkeys(area.frame for area in areas):
        rows = np.array([row for row, area in enumerate(areas) if area.frame == frame])
        place[rows] = first + _connected([areas[row].cells for row in rows.tolist()])
        first = int(place[rows].max()) + 1
    _, start, number = np.unique(place, return_index=True, return_inverse=True)
    order: NDArray[np.int64] = np.argsort(np.argsort(start))[number]
    return order


def _connected(cells: Sequence[Iterable[tuple[int, int]]]) -> NDArray[np.int64]:
    """(S) numbers of the groups of scenes with cells that are near each other."""
    from scipy.sparse import coo_array  # 0.4 s that only training needs
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    owner = np.array([row for row, each in enumerate(cells) for _ in each], int)
    known, cell = np.unique(
        np.array([one for each in cells for one in each], float).reshape(-1, 2),
        axis=0,
        return_inverse=True,
    )
    reach_m = APART_M + np.hypot(CELL_M, CELL_M)
    near = KDTree(known * CELL_M).query_pairs(reach_m, output_type="ndarray").reshape(-1, 2)
    one = np.concatenate([owner, len(cells) + near[:, 0]])
    two = np.concatenate([len(cells) + cell.reshape(-1), len(cells) + near[:, 1]])
    size = len(cells) + len(known)
    joins = coo_array((np.ones(len(one), bool), (one, two)), (size, size))
    groups: NDArray[np.int64] = connected_components(joins, directed=False)[1][: len(cells)]
    return groups


def held_out(
    areas: Sequence[SceneArea], samples: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], bool]:
    """(S) whether each scene is held out, and whether that separates places.

    About one place in ten of those with samples is held out, which ones depends on where they are.
    If all samples are of one place, every tenth scene of it is held out, or the last one of fewer
    than ten.

    Args:
        areas: of all scenes, of all sources.
        samples: (S) number of samples of each scene.
    """
    place = numbered(areas)
    counts = np.bincount(place, weights=samples)
    with_samples = np.flatnonzero(counts)
    if len(with_samples) < 2:
        some = np.flatnonzero(samples)
        tenth = np.arange(len(some)) % HELD_OUT == HELD_OUT - 1
        if not tenth.any() and len(some) > 1:
            tenth[-1] = True
        kept = np.zeros(len(areas), bool)
        kept[some[tenth]] = True
        return kept, False
    draws = _draws(areas, place)
    order = sorted(with_samples.tolist(), key=lambda one: (draws[one], one))
    most = MOST * counts.sum()
    chosen = [one for one in order if draws[one] % HELD_OUT == 0 and counts[one] <= most]
    while counts[chosen].sum() > most:
        chosen.pop()
    if not chosen:
        small = [one for one in order if counts[one] <= most]
        chosen = small[:1]
    return np.isin(place, chosen), True


def _draws(areas: Sequence[SceneArea], place: NDArray[np.int64]) -> list[int]:
    """A number of each place that depends on its first cell alone."""
    first: dict[int, tuple[str, tuple[int, int]]] = {}
    for area, number in zip(areas, place.tolist(), strict=True):
        if area.cells:
            here = (area.frame, area.cells[0])
            first[number] = min(first.get(number, here), here)
    texts = [str(first.get(number, number)) for number in range(int(place.max(initial=-1)) + 1)]
    return [zlib.crc32(text.encode()) for text in texts]
