"""The values that a network is held against, by guideline, with where each is from.

Speeds are in m/s, lengths in m, times in s. What a guideline leaves open and this project has
chosen is said in docs/reference/screening.md.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

KMH: Final = 1 / 3.6
MPH: Final = 0.44704
FOOT: Final = 0.3048
GRAVITY: Final = 9.81


class Required(NamedTuple):
    """A value, for what it is asked, as the end of a sentence, and the source."""

    value: float
    why: str
    source: str


class Clearing(NamedTuple):
    """Two movements under a light: the first loses its green, then the second gets its own.

    ``over_m``, ``to_m``: from the stop line to the common place, of the one that clears and the
    one that enters. ``radius_m``: of the turn that clears; infinite where it is straight.
    """

    over_m: float
    to_m: float
    straight: bool
    radius_m: float
    limit_mps: float


class Guideline(ABC):
    """A set of rules; ``clearance`` names what `clearance_s` is about."""

    name: str
    title: str
    clearance: str
    yellow_counts: bool
    """Whether the yellow is part of the clearance."""
    oncoming_lanes: int
    oncoming_mps: float
    """Up to these a left turn may look for gaps in oncoming traffic."""
    left_source: str
    signals_mps: float | None = None
    """The highest limit at signals."""
    right_before_left_mps: float = 50 * KMH

    @abstractmethod
    def yellow_s(self, limit_mps: float, turn: str, *, own_signal: bool) -> Required:
        """The least yellow for a movement; ``turn`` is straight, left, right or empty."""

    @abstractmethod
    def clearance_s(self, pair: Clearing) -> Required:
        """The least time from the end of one green (or yellow) to the begin of the other."""

    @abstractmethod
    def acceleration_m(self, limit_mps: float, ramp_mps: float) -> Required | None:
        """The least length of an acceleration lane; None where the guideline has none."""

    @abstractmethod
    def friction(self, speed_mps: float) -> Required:
        """The highest side friction in a curve, as a share of the weight."""


@dataclass(frozen=True)
class Rilsa(Guideline):
    """Germany: RiLSA 2010 and VwV-StVO for signals, RAA 2008 and RAS-L 1995 for roads."""

    name = "rilsa"
    title = "RiLSA 2010"
    clearance = "intergreen"
    yellow_counts = True
    oncoming_lanes = 1
    oncoming_mps = 50 * KMH
    left_source = "RiLSA 2010, RAL 2012"
    signals_mps = 70 * KMH

    def yellow_s(self, limit_mps: float, turn: str, *, own_signal: bool) -> Required:
        """3, 4, 5 s at 50, 60, 70 km/h; 3 s for turns with signals of their own.

        Limits in Germany are multiples of 10 km/h; those of networks are rounded to them.
        """
        source = "RiLSA 2010, VwV-StVO zu § 37"
        if own_signal and turn in {"left", "right", "turnaround"}:
            return Required(3.0, "for a turn with a signal of its own", source)
        limit = 10 * round(limit_mps / KMH / 10)
        value = float(np.clip((limit - 20) / 10, 3, 5))
        return Required(value, f"at {limit_mps / KMH:.0f} km/h", source)

    def clearance_s(self, pair: Clearing) -> Required:
        """Overrun + (way + 6 m) / clearing speed - way of the other / 40 km/h, at least 0."""
        if pair.straight:
            overrun_s, speed_mps = 3.0, 10.0
        else:
            overrun_s, speed_mps = 2.0, 7.0 if pair.radius_m >= 10 else 5.0
        clears_s = (pair.over_m + 6.0) / speed_mps
        enters_s = pair.to_m / (40 * KMH)
        value = max(0.0, overrun_s + clears_s - enters_s)
        why = (
            f"= {overrun_s:g} + ({pair.over_m:.1f} + 6) m / {speed_mps:g} m/s"
            f" - {pair.to_m:.1f} m / 11.1 m/s"
        )
        return Required(value, why, "RiLSA 2010, intergreen times")

    def acceleration_m(self, limit_mps: float, ramp_mps: float) -> Required | None:  # noqa: ARG002
        """250 m, on urban motorways 150 m; told apart by the limit: above 100 km/h or not."""
        if limit_mps <= 72 * KMH:  # 70 km/h, rounded
            return None
        value = 250.0 if limit_mps > 102 * KMH else 150.0
        return Required(value, f"at {limit_mps / KMH:.0f} km/h", "RAA 2008, acceleration lanes")

    def friction(self, speed_mps: float) -> Required:
        """0.925 of the tangential 0.241 (V/100)^2 - 0.721 (V/100) + 0.708, V in km/h."""
        share = min(speed_mps / KMH, 149.0) / 100  # the parabola's lowest point
        value = 0.925 * (0.241 * share**2 - 0.721 * share + 0.708)
        return Required(value, f"at {speed_mps / KMH:.0f} km/h", "RAS-L 1995, side friction")


@dataclass(frozen=True)
class Ite(Guideline):
    """USA: ITE's kinematic formula with the values of NCHRP 731; AASHTO's Green Book for roads."""

    name = "ite"
    title = "ITE kinematic formula (NCHRP 731)"
    clearance = "red clearance"
    yellow_counts = False
    oncoming_lanes = 3
    oncoming_mps = 45 * MPH
    left_source = "NCHRP 812, exhibit on left-turn phasing"

    def yellow_s(self, limit_mps: float, turn: str, *, own_signal: bool) -> Required:  # noqa: ARG002
        """1 s + v / (2 * 10 ft/s^2), 3 to 7 s; v: limit + 7 mph, left turns limit - 5 mph."""
        more = -5 * MPH if turn == "left" else 7 * MPH
        speed = max(0.0, limit_mps + more)
        value = float(np.clip(1.0 + speed / (2 * 10 * FOOT), 3, 7))
        return Required(value, f"at {limit_mps / MPH:.0f} mph", "ITE, NCHRP 731")

    def clearance_s(self, pair: Clearing) -> Required:
        """(W + 20 ft) / v - 1 s, at least 1 s; v: limit + 7 mph, turns 20 mph."""
        speed = pair.limit_mps + 7 * MPH if pair.straight else 20 * MPH
        value = max(1.0, (pair.over_m + 20 * FOOT) / speed - 1.0)
        why = f"for {pair.over_m:.1f} m and a vehicle of 20 ft at {speed / MPH:.0f} mph"
        return Required(value, why, "ITE, NCHRP 731")

    def acceleration_m(self, limit_mps: float, ramp_mps: float) -> Required | None:
        """From the ramp's limit to 0.8 of the road's at 0.7 m/s^2, at least 90 m (300 ft).

        The two numbers fit the lengths of the Green Book's table for flat grades.
        """
        if limit_mps <= 45 * MPH:
            return None
        merging = 0.8 * limit_mps
        value = max(90.0, (merging**2 - ramp_mps**2) / (2 * 0.7))
        why = f"from {ramp_mps / MPH:.0f} mph on the ramp to a road with {limit_mps / MPH:.0f} mph"
        return Required(value, why, "AASHTO Green Book, acceleration lengths (approximation)")

    def friction(self, speed_mps: float) -> Required:
        """The Green Book's table for streets, by interpolation."""
        mph = (10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80)
        share = (
            0.38, 0.32, 0.27, 0.23, 0.20, 0.18, 0.16, 0.15, 0.14, 0.13, 0.12, 0.11, 0.10, 0.09,
            0.08,
        )  # fmt: skip
        value = float(np.interp(speed_mps / MPH, mph, share))
        return Required(value, f"at {speed_mps / MPH:.0f} mph", "AASHTO Green Book, side friction")


GUIDELINES: Final[dict[str, Guideline]] = {one.name: one for one in (Rilsa(), Ite())}
"""By the name that ``--guideline`` takes."""
