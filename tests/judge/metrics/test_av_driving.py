"""How the AV drove: worked by hand."""

import dataclasses

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.results.quantities import BY_NAME
from deepmf_sumo.scene import Lane, RoadMap, SignalState
from deepmf_sumo.scene.geometry.road import limit_mps

from tests.support.rollout_doubles import case_of, contact_of, in_traffic, rollout_of, straight

AWAY = straight(0, -500, 10)


def lane(name, points, limit):
    centre = np.array(points, float)
    return Lane(
        id=name, kind="street", centre_m=centre, z_m=np.zeros(len(centre)), width_m=3.5,
        speed_limit_mps=limit,
    )  # fmt: skip


STREET = RoadMap(
    lanes={
        one.id: one
        for one in (
            lane("first", [[-200, 0], [30, 0]], 8.0),
            lane("then", [[30, 0], [400, 0]], 12.0),
            lane("back", [[400, 4], [-200, 4]], 20.0),
            lane("across", [[60, -50], [60, 50]], 30.0),
            lane("unknown", [[0, 100], [50, 100]], None),
        )
    }
)


def measured(name, rollout, case=None):
    return plugins.load("metrics", name).measure(rollout, case or case_of())


def on_the_street(av, **more):
    case = dataclasses.replace(in_traffic(case_of()), road=STREET)
    return dataclasses.replace(rollout_of({"av": av, "b": AWAY}), **more), case


def test_any_agent_counts_and_none_behind():
    """At 10 m/s behind a leader of 6 m/s, 40 m ahead; a fast one comes from behind."""
    paths = {
        "av": straight(0, 0, 10)[:31],
        "b": AWAY[:31],
        "leader": straight(40 + 4.8, 0, 6)[:31],
        "behind": straight(-12, 0, 14)[:31],
    }
    rollout = rollout_of(paths)
    last_gap = 40 - 4 * 2.0
    assert measured("av_ttc_min", rollout).value == pytest.approx(last_gap / 4)
    assert measured("av_time_gap_min", rollout).value == pytest.approx(last_gap / 10)
    needed = 4**2 / (2 * last_gap)
    assert measured("av_required_braking", rollout).value == pytest.approx(needed, rel=0.01)


def test_nothing_ahead_is_at_the_ceiling():
    rollout = rollout_of({"av": straight(0, 0, 10), "b": AWAY})
    assert measured("av_ttc_min", rollout).value == 10.0
    assert measured("av_time_gap_min", rollout).value == 10.0
    assert measured("av_required_braking", rollout).value == 0.0


def test_into_something_that_stands():
    paths = {"av": straight(0, 0, 10), "b": AWAY, "parked": straight(4.8 + 30, 0, 0)}
    hit = contact_of(kind="av_other", step=10 + 30, second="parked")
    rollout = rollout_of(paths, contacts=[hit])
    assert measured("av_ttc_min", rollout).value == pytest.approx(0.0, abs=1e-9)
    assert measured("av_required_braking", rollout).value == 10.0
    # what comes after the contact does not count
    assert measured("av_progress", rollout).value == pytest.approx(10 * 2.9)


def test_limits_of_lanes_of_the_own_direction():
    points = np.array([[0.0, 0], [60, 0], [60, 4], [60, 4], [0, 300], [20, 100]])
    course = np.array([0.0, 0, np.pi, 0, 0, 0])
    expected = [8.0, 12.0, 20.0, np.nan, np.nan, np.nan]
    np.testing.assert_array_equal(limit_mps(STREET, points, course), expected)


def test_above_the_limit():
    """From 8 m/s on it accelerates for 8 s where 8 m/s are allowed.

    At 13 m/s from the start on it should slow down with 1 m/s2: 4.6 s later, when the next lane
    begins, 4.6 m/s are beyond what is allowed.
    """
    faster = measured("av_over_limit", *on_the_street(straight(-120, 0, 8, accel=1.0))).value
    assert faster == pytest.approx(8, abs=0.11)
    keeps = measured("av_over_limit", *on_the_street(straight(-33, 0, 13))).value
    assert keeps == pytest.approx(4.6)
    assert measured("av_over_limit", *on_the_street(straight(40, 0, 11))).value == 0.0
    reason = measured("av_over_limit", *on_the_street(straight(0, 300, 11))).reason
    assert reason == "no limit is known where the AV drove"


@pytest.mark.parametrize(("since", "late_s"), [(0, 0.0), (1, 0.1), (15, 1.5), (100, 2.8)])
def test_over_the_line_after_green(since, late_s):
    """The bumper is at x = 2.4 now and crosses the line at x = 30 in the 28th step of 10 m/s."""
    crossed = 28  # steps after now; lights are those before the step
    lights = (
        tuple(
            {"then": SignalState.CAUTION if step > crossed - 1 - since else SignalState.GO}
            for step in range(crossed)
        )
        + ({"then": SignalState.STOP},) * 52
    )
    rollout, case = on_the_street(straight(0, 0, 10), signals=lights)
    assert measured("av_late_at_signal", rollout, case).value == pytest.approx(late_s)


def test_lights_may_be_unknown():
    assert "lights" in measured("av_late_at_signal", *on_the_street(straight(0, 0, 10))).reason


@pytest.mark.parametrize(("ttc_s", "expected"), [(10.0, 0.1), (2.0, 0.5), (1.0, 1.0), (0.0, 1.0)])
def test_short_times_count_most(ttc_s, expected):
    result = {
        "status": "ok", "adversary": "none", "opponent": "",
        "metrics": {"av_ttc_min": {"value": ttc_s}},
    }  # fmt: skip
    assert BY_NAME["av_inverse_ttc_per_s"].of(result) == pytest.approx(expected)
    assert BY_NAME["av_ttc_s"].of(result) == ttc_s
    assert BY_NAME["av_inverse_time_gap_per_s"].of(result) is None
