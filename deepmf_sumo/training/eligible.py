"""Which samples a network learns from."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from deepmf_sumo.errors import RunError
from deepmf_sumo.predictors.weights import Network
from deepmf_sumo.training.cache import Cache, Progress

_NEAR_M = 15.0
"""The conditional network learns from pairs whose ways come as near as this, at any two times."""


def drivers_for(network: Network, cache: Cache, report: Progress) -> Cache:
    """Without the samples whose drivers a network does not learn from; they are counted.

    Raises RunError where none is left.
    """
    if network == "opponent":
        without = cache.scenes - len(np.unique(cache.scene))
        if without:
            report(f"opponent: {without} scenes have no samples: attacks, or nobody is near the AV")
    if network != "marginal":
        return cache
    by_people = _by_people(cache)
    if not by_people.all():
        report(f"marginal: {(~by_people).sum()} samples left out in which a planner drives")
    lacks = "The marginal network learns from people, and planners drive in all samples"
    return _chosen(cache, by_people, lacks)


def pairs(cache: Cache) -> Cache:
    """The samples that the conditional network learns from. Raises RunError where none is."""
    lacks = "No two vehicles come near each other in these recordings"
    return _chosen(cache, _interacting(cache), lacks)


def _chosen(cache: Cache, rows: NDArray[np.bool_], lacks: str) -> Cache:
    cache = replace(cache, chosen=rows)
    if not len(cache.rows(held_out=False)):
        raise RunError(f"{lacks}; give more recordings.")
    return cache


def _by_people(cache: Cache) -> NDArray[np.bool_]:
    """(N) samples of vehicles that no automated planner drives."""
    driver = np.asarray(cache.arrays["motion"])[:, 6]
    return np.asarray(driver == 0.0)


def _interacting(cache: Cache) -> NDArray[np.bool_]:
    """(N) samples with a partner whose way comes near."""
    near = np.zeros(len(cache.scene), bool)
    for begin in range(0, len(near), 1024):
        rows = slice(begin, begin + 1024)
        own = np.asarray(cache.arrays["future"][rows, 4::5])
        other = np.asarray(cache.arrays["partner"][rows, 4::5, :2])
        apart = np.linalg.norm(own[:, :, None] - other[:, None], axis=-1)  # (., 16, 16)
        unknown = np.asarray(cache.arrays["future_valid"][rows, 4::5]) == 0
        least = np.where(unknown[:, :, None], np.inf, apart).min(axis=(1, 2))
        near[rows] = (least < _NEAR_M) & (np.asarray(cache.arrays["partner_known"][rows]) > 0)
    return near
