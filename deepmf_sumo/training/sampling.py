"""Which samples make up each batch: a function of seed and step, so that a run can go on."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo.training.cache import Cache

_SORTED_BATCHES = 8
"""Within so many batches, samples with similar numbers of paths go together: the networks cut a
batch to the paths that it uses."""


def batches(
    cache: Cache, size: int, seed: int, first: int, stop: int
) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """(step, rows) for the steps from ``first`` to before ``stop``.

    An epoch has as many samples as are trained on. How many of them each source gives is drawn by
    its share; which ones goes round the source, so that each of its samples is seen equally often.
    """
    size = min(size, len(cache.rows(held_out=False)))
    an_epoch = len(cache.rows(held_out=False)) // size
    rounds = [
        _Round(cache.rows(held_out=False, source=number), [seed, number])
        for number in range(len(cache.sources))
    ]
    used = _paths_used(cache)
    for epoch in range(-(-stop // an_epoch)):
        rng = np.random.default_rng([seed, epoch])
        counts = rng.multinomial(an_epoch * size, cache.shares)
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
    """The samples of one source in random order, again and again, each time in another one."""

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


def _paths_used(cache: Cache) -> NDArray[np.int64] | None:
    paths = cache.arrays.get("path_info")
    if paths is None:
        return None
    used: NDArray[np.int64] = (paths[:, :, 0] > 0).sum(1)
    return used
