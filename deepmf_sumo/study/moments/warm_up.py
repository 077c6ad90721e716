"""From when on a network is attacked: after its traffic has built up."""

from typing import Final, NamedTuple

import numpy as np

from deepmf_sumo.scene import Floats
from deepmf_sumo.study.moments.moment import WantedMoments, opponents
from deepmf_sumo.sumo.simulation.traffic_survey import EVERY_S, Sightings, growth

_WINDOW_S: Final = 60.0
"""Counts are smoothed over this time, or over a tenth of the traffic's time if that is shorter."""
_REACHED: Final = 0.9
"""The number has settled when it comes to this share of its level."""


class Beginning(NamedTuple):
    """From when on moments are chosen, and why, for the end of a sentence; empty if as asked."""

    time_s: float
    why: str = ""


def beginning(sightings: Sightings, wish: WantedMoments) -> Beginning | None:
    """When attacks may begin; None where nothing was asked for, or there is no traffic."""
    if wish.from_s is None:
        return None
    if wish.from_s != "settled":
        return Beginning(wish.from_s)
    return settled(*counts(sightings))


def counts(sightings: Sightings) -> tuple[Floats, Floats]:
    """(N) times a second apart, from the first vehicle to the last, and (N) vehicles on the road.

    Parked vehicles, bicycles and trains are left out.
    """
    seen = sightings.time_s[opponents(sightings)]
    if not len(seen):
        return np.zeros(0), np.zeros(0)
    first, last = float(seen.min()), float(seen.max())
    time_s: Floats = np.arange(first, last + EVERY_S / 2, EVERY_S)
    ends = np.searchsorted(seen, time_s + 1e-6, "right")
    begins = np.searchsorted(seen, time_s - 1e-6, "left")
    return time_s, (ends - begins).astype(float)


def settled(time_s: Floats, number: Floats) -> Beginning | None:
    """When a number of vehicles (N) at times (N) has settled.

    Its level is the median over the second half; it has settled at the first time from which on
    the mean of a minute is 90 % of that. Where the number still grows, it is the middle of the
    time: see `traffic_survey.growth`.
    """
    if not len(number):
        return None
    change = growth(number)
    if change.goes_on:
        return Beginning(
            float(time_s[len(time_s) // 2]),
            "half of this time: the number of vehicles still grows"
            f" (on average {change.third:.0f} in the third quarter of it, {change.last:.0f} in the"
            " last)",
        )
    level = float(np.median(number[len(number) // 2 :]))
    window = max(1, round(min(_WINDOW_S, len(number) / 10) / EVERY_S))
    mean = np.convolve(number, np.ones(window) / window, "valid")
    reached = np.flatnonzero(mean >= _REACHED * level)
    at = int(reached[0]) if len(reached) else len(number) // 2
    return Beginning(
        float(time_s[at]), f"when the number of vehicles has settled at about {level:.0f}"
    )
