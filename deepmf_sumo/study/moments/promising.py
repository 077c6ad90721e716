"""Moments that are drawn where conflicts came near: which are next, and how likely each was.

The *pool* is several times as many moments as are attacked, spread over the network. The first
third of the attacks are its first moments: all of them, so that they are spread. The others come in
three batches. Each of their moments is drawn from what is left of the pool, with a chance that is
partly equal for all and partly grows with what attacks at its edge, on its movement and of its kind
(the turn, and how close an encounter it has) have found so far (an epsilon-greedy bandit over
places and movements, in closed form, so that chances are known and no moment has none).

What a batch is drawn from are the results of all batches before it and the seed: neither the number
of workers nor the order in which runs end matters.
"""

from collections import defaultdict
from collections.abc import Hashable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from deepmf_sumo.scene import Floats
from deepmf_sumo.spec.tasks import Draw, How
from deepmf_sumo.study.moments.moment import Moment

POOL: Final = 4
"""Moments in the pool for each one that is attacked."""
BATCHES: Final = 3
_SPREAD: Final = 1 / 3
_EQUAL: Final = 0.25
"""Part of the chance that is equal for all: no attack counts more than four times the mean."""
_USUAL: Final = 2.0
"""Attacks of the usual worth that a place, movement or kind is taken to have had before."""
_RARE: Final = (0.1, 1.0)
"""Before any attack: worth, and the number of attacks that this counts as."""
_CLOSE_S: Final = 1.0
_STEEP: Final = 2.0
"""Power of the expected worth in the chance."""


def spread(pool: int, count: int) -> int:
    """How many moments are spread, of a number that is attacked out of a pool."""
    return pool if pool <= count else max(1, round(count * _SPREAD))


class Promising:
    """Which moments of a pool are attacked.

    Args:
        pool: in the order in which they are spread, the best spread first.
        count: of the moments that are attacked, at most.
        seed: of the draws.
    """

    def __init__(self, pool: Sequence[Moment], count: int, seed: int) -> None:
        self._pool, self._seed = pool, seed
        self.count = min(count, len(pool))
        first = spread(len(pool), count)
        cuts = np.linspace(first, self.count, BATCHES + 1).round().astype(int).tolist()
        self._sizes = [first, *(end - begin for begin, end in pairwise(cuts))]
        self._groups = [tuple(_groups(one)) for one in pool]
        self._batch = 0
        self._left = list(range(len(pool)))

    def draw(self, worth: Mapping[int, float]) -> dict[int, Draw]:
        """The next moments, by place in the pool, in the order of their draws; none at the end.

        ``worth``: of the moments attacked so far, 0 where nothing came near to 1 for a finding;
        those that could not be attacked are left out.
        """
        size = 0
        while not size and self._sizes:
            size = self._sizes.pop(0)
            self._batch += 1
        if self._batch == 1:
            chosen = dict.fromkeys(self._left[:size], 1.0)
            self._left = self._left[size:]
        else:
            chosen = self._drawn(size, worth)
        before = self.count - sum(self._sizes) - size
        how: How = "spread" if self._batch == 1 else "promising"
        return {
            index: Draw(drawn=how, draw=number, probability=chance, pool=len(self._pool))
            for number, (index, chance) in enumerate(chosen.items(), before + 1)
        }

    def _drawn(self, size: int, worth: Mapping[int, float]) -> dict[int, float]:
        rng = np.random.default_rng([self._seed, 0xBAD1, self._batch])
        expected = self._expected(worth)
        chosen: dict[int, float] = {}
        for _ in range(size):
            chances = _EQUAL / len(self._left) + (1 - _EQUAL) * expected / expected.sum()
            at = int(np.searchsorted(chances.cumsum(), rng.random() * chances.sum(), "right"))
            chosen[self._left.pop(at)] = float(chances[at])
            expected = np.delete(expected, at)
        return chosen

    def _expected(self, worth: Mapping[int, float]) -> Floats:
        """(L) of the moments that are left: the usual worth, times what their groups do to it."""
        found: dict[Hashable, list[float]] = defaultdict(list)
        for index, value in worth.items():
            for group in self._groups[index]:
                found[group].append(value)
        rare, many = _RARE
        usual = (rare * many + sum(worth.values())) / (many + len(worth))
        values = np.full(len(self._left), usual)
        for at, index in enumerate(self._left):
            for group in self._groups[index]:
                seen = found.get(group, ())
                values[at] *= (_USUAL + sum(seen) / usual) / (_USUAL + len(seen))
        return values**_STEEP


def _groups(one: Moment) -> Iterator[Hashable]:
    """What attacks are alike in: edge, movement, kind."""
    yield one.edge
    yield one.edge, one.following
    apart_s = one.encounter_s
    met = "none" if apart_s is None else "close" if apart_s <= _CLOSE_S else "far"
    yield one.turn, met, "kind"
