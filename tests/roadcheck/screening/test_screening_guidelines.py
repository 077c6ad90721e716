"""Values of the guidelines, against tables and worked examples by hand."""

import math

import pytest

from deepmf_sumo.roadcheck.screening import GUIDELINES
from deepmf_sumo.roadcheck.screening.guidelines import FOOT, KMH, MPH, Clearing

RILSA, ITE = GUIDELINES["rilsa"], GUIDELINES["ite"]


def clearing(**changes):
    values = {"over_m": 14.0, "to_m": 10.0, "straight": True}
    return Clearing(**{**values, "radius_m": math.inf, "limit_mps": 50 * KMH, **changes})


@pytest.mark.parametrize(
    ("limit", "seconds"), [(30, 3), (50, 3), (54.9, 3), (60, 4), (70, 5), (100, 5)]
)
def test_yellow_of_rilsa(limit, seconds):
    assert RILSA.yellow_s(limit * KMH, "straight", own_signal=False).value == seconds


def test_a_turn_with_a_signal_of_its_own_has_three_seconds():
    assert RILSA.yellow_s(70 * KMH, "left", own_signal=True).value == 3
    assert RILSA.yellow_s(70 * KMH, "left", own_signal=False).value == 5
    assert RILSA.yellow_s(70 * KMH, "straight", own_signal=True).value == 5


def test_yellow_of_ite():
    # 35 mph + 7 = 42 mph = 61.6 ft/s: 1 + 61.6 / 20 = 4.08 s; 35 - 5 = 30 mph = 44 ft/s: 3.2 s
    straight = ITE.yellow_s(35 * MPH, "straight", own_signal=False).value
    left = ITE.yellow_s(35 * MPH, "left", own_signal=False).value
    assert (round(straight, 2), round(left, 2)) == (4.08, 3.2)
    assert ITE.yellow_s(10 * MPH, "left", own_signal=False).value == 3, "never less"


def test_intergreen_of_rilsa():
    # 3 + (14 + 6) / 10 - 10 / 11.11 = 4.1 s; turn: 2 + 20 / 7 - 0.9; tight turn: 2 + 20 / 5 - 0.9
    assert RILSA.clearance_s(clearing()).value == pytest.approx(4.1)
    turn = RILSA.clearance_s(clearing(straight=False, radius_m=12.0)).value
    tight = RILSA.clearance_s(clearing(straight=False, radius_m=8.0)).value
    assert (turn, tight) == (pytest.approx(3.957, abs=1e-3), pytest.approx(5.1))
    assert RILSA.clearance_s(clearing(over_m=0.0, to_m=100.0)).value == 0


def test_red_clearance_of_ite():
    # 80 ft + 20 ft at 35 + 7 mph = 61.6 ft/s: 1.62 - 1 = 0.62, at least 1; turn 20 mph = 29.3 ft/s
    wide = clearing(over_m=80 * FOOT, limit_mps=35 * MPH)
    assert ITE.clearance_s(wide).value == 1
    turn = ITE.clearance_s(wide._replace(straight=False)).value
    assert turn == pytest.approx(100 / 29.333 - 1, abs=1e-2)


def test_acceleration_lanes():
    assert RILSA.acceleration_m(70 * KMH, 10) is None
    assert RILSA.acceleration_m(100 * KMH, 10).value == 150
    assert RILSA.acceleration_m(120 * KMH, 10).value == 250
    # (0.8 * 110)^2 - 47^2 (km/h) over 2 * 0.7 m/s^2: 305 m
    assert ITE.acceleration_m(110 * KMH, 47 * KMH).value == pytest.approx(305, abs=1)
    assert ITE.acceleration_m(90 * KMH, 90 * KMH).value == 90


def test_side_friction():
    # 0.925 * (0.241 * 0.25 - 0.721 * 0.5 + 0.708) = 0.377
    assert RILSA.friction(50 * KMH).value == pytest.approx(0.377, abs=1e-3)
    assert ITE.friction(30 * MPH).value == pytest.approx(0.20)
    for book in (RILSA, ITE):
        shares = [book.friction(speed * KMH).value for speed in range(10, 200, 10)]
        assert shares == sorted(shares, reverse=True)
        assert min(shares) > 0
