"""`with_traffic`: more than a second against the traffic, counted by hand in steps of 0.1 s."""

from types import SimpleNamespace

import numpy as np
import pytest

from deepmf_sumo.deepmf.candidates import against_traffic
from deepmf_sumo.deepmf.constraints import WithTraffic
from deepmf_sumo.deepmf.settings import Settings
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.scene import Forecast, Futures, Lane, RoadMap, Tracks, View
from deepmf_sumo.scene.road_users import MotionLimits

EAST_Y, WEST_Y = 0.0, 3.5
"""Of the two lanes of a street; all drive to the east, so that WEST_Y is the wrong side."""


def lane(name, y, *, reverse=False):
    x = np.arange(0.0, 401.0, 5.0)
    centre = np.column_stack([x, np.full(len(x), y)])
    return Lane(
        id=name,
        kind="street",
        centre_m=centre[::-1] if reverse else centre,
        z_m=np.zeros(len(x)),
        width_m=3.5,
    )


ROAD = RoadMap(lanes={"east": lane("east", EAST_Y), "west": lane("west", WEST_Y, reverse=True)})


def situation(wrong_before, step=10):
    """The opponent "b" was on the wrong side in the last ``wrong_before`` steps, now included."""
    y = np.full(11, EAST_Y)
    y[11 - wrong_before :] = WEST_Y
    position = np.zeros((2, 11, 2))
    position[0] = np.column_stack([200.0 + np.arange(11), np.full(11, EAST_Y)])
    position[1] = np.column_stack([40.0 + np.arange(11), y])
    history = Tracks(
        ids=("av", "b"),
        kinds=("vehicle",) * 2,
        size_m=np.array([[4.8, 2.0, 1.5]] * 2),
        position_m=position,
        z_m=np.zeros((2, 11)),
        heading_rad=np.zeros((2, 11)),
        velocity_mps=np.tile([10.0, 0.0], (2, 11, 1)),
        valid=np.ones((2, 11), bool),
    )
    view = View(
        step=step, dt_s=0.1, av_id="av", history=history, road=ROAD, signals={}, steps_left=80
    )
    return Situation.of(view, "b", MotionLimits(accel=3.5, brake=5.0, lateral=3.5))


def candidates(*wrong_ahead):
    """One for each number of steps on the wrong side, from the next one on."""
    steps = np.arange(80)
    position = np.zeros((len(wrong_ahead), 80, 2))
    position[..., 0] = 51.0 + steps
    position[..., 1] = np.where(steps < np.array(wrong_ahead)[:, None], WEST_Y, EAST_Y)
    futures = Futures(agent_id="b", position_m=position, heading_rad=np.zeros(position.shape[:2]))
    shares = np.full(len(wrong_ahead), 1.0 / len(wrong_ahead))
    return SimpleNamespace(forecast=Forecast(futures=futures, probability=shares))


def forbidden(before, *ahead, until=80.0, since=None):
    found = against_traffic(
        situation(before), candidates(*ahead), np.full(len(ahead), until), since
    )
    return found.tolist()


def test_a_second_is_ten_steps_and_no_fewer():
    assert forbidden(0, 0, 9, 10, 11, 80) == [False, False, False, True, True]


@pytest.mark.parametrize("before", [1, 4, 9])
def test_the_last_second_counts_step_by_step(before):
    left = 10 - before
    assert forbidden(before, left - 1, left, left + 1) == [False, False, True]


@pytest.mark.parametrize("before", [9, 10, 11])
def test_the_past_alone_forbids_no_candidate(before):
    assert forbidden(before, 0, 0, 0, 0, 0) == [False] * 5
    assert forbidden(before, 2) == [True]


def test_what_comes_after_the_contact_does_not_count():
    assert forbidden(0, 80, until=9.0) == [False]
    assert forbidden(0, 80, until=10.0) == [True]


@pytest.mark.parametrize(("since", "expected"), [(None, True), (0, True), (5, False), (10, False)])
def test_only_what_the_attack_itself_drove_counts(since, expected):
    """Ten steps before now (step 10) were on the wrong side; five more are to come."""
    assert forbidden(10, 5, since=since) == [expected]


def test_a_vehicle_that_passes_a_parked_car_may_attack():
    """Before its first plan SUMO or the log drove it; from then on the attack has one second."""
    constraint, own = WithTraffic(Settings()), candidates(0, 8, 10, 11)
    pairs = SimpleNamespace(collision_step=np.full((4, 1), 80.0))

    def allowed(step, before):
        return constraint.allowed(situation(before, step), own, [], pairs).tolist()

    assert allowed(10, 11) == [True, True, True, False]
    assert allowed(15, 11) == [True, False, False, False]  # five steps of its own
    assert allowed(20, 11) == [True, False, False, False]
