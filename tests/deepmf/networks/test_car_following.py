"""A driver who follows cars, on every path, behind a vehicle whose future is given."""

import numpy as np
import pytest
import torch

from deepmf_sumo.deepmf.networks import condition
from deepmf_sumo.deepmf.networks.condition import Following, OnPaths, Road
from deepmf_sumo.deepmf.networks.config import VECTOR
from deepmf_sumo.deepmf.networks.encode import span
from deepmf_sumo.scene.car_following import TREIBER, desired_gap_m

STRAIGHT = torch.stack([torch.arange(121) * 2.0, torch.zeros(121)], -1)


def road(speed=10.0, limit=15.0, agents=()):
    """One straight path; ``agents`` are (along, left, speed) of vehicles on it."""
    rows = torch.zeros(1, 1, 8, 8)
    for row, (along, left, pace) in enumerate(agents):
        rows[0, 0, row] = torch.tensor([along, left, pace, 0.0, 1.0, 0.0, 5.0, 1.0])
    return Road(
        paths=STRAIGHT[None, None],
        limit_mps=torch.tensor([[limit]]),
        speed_mps=torch.tensor([speed]),
        agents=rows,
    )


def given(x, y, heading=0.0):
    """One future; x and y are numbers, or of all 80 steps."""
    position = torch.zeros(1, 1, 80, 2)
    position[..., 0] = torch.as_tensor(x, dtype=torch.float32)
    position[..., 1] = torch.as_tensor(y, dtype=torch.float32)
    turned = torch.full((1, 1, 80), heading)
    return condition.Condition.of(position, turned, torch.ones(1, 1), VECTOR)


FAR = given(0.0, 500.0)


def followed(road, futures):
    on_paths = OnPaths.of(road.paths, futures.position_m)
    return condition.followed(road, futures, on_paths)[0, :, 0]


def driven(road, future):
    return followed(road, future)[0].numpy()


def test_with_nobody_ahead_it_gathers_speed_up_to_the_limit():
    along = driven(road(), FAR)
    speed = np.diff(along, prepend=0.0) / 0.5
    assert np.all(np.diff(speed) > 0)
    assert 13.0 < speed[-1] < 15.0
    assert driven(road(limit=0.0), FAR)[-1] < along[-1], "12 m/s where no limit is known"


def test_it_stops_behind_who_stands_in_its_way():
    along = driven(road(), given(60.0, 0.0))
    assert 60.0 - 4.8 - 4.0 < along[-1] < 60.0 - 4.8
    assert np.all(np.diff(along) >= 0)
    aside = driven(road(), given(60.0, 3.5))
    assert aside[-1] == pytest.approx(driven(road(), FAR)[-1], abs=1e-3)
    across = driven(road(), given(60.0, 3.0, heading=np.pi / 2))
    assert across[-1] < 60.0, "a vehicle across reaches farther to its sides"


@pytest.mark.parametrize("pace", [0.0, 4.0])
def test_it_desires_the_gap_of_the_intelligent_driver(pace):
    """Behind one that stands or is slow; steps of a quarter of a second, integrated here.

    The leader's first given step, 0.1 s ahead, stands for now: in the first half second it seems to
    drive a fifth less.
    """
    along, speed, expected, dt_s = 0.0, 10.0, [], 0.25
    seconds = np.append(0.0, np.arange(1, 17) * 0.5 - 0.1)
    for step in range(32):
        since = np.interp(step / 2, np.arange(17), seconds)
        ahead_mps = pace * (0.8 if step < 2 else 1.0)
        gap = 40.0 + pace * since - 4.8 - along
        wanted = desired_gap_m(TREIBER, speed, ahead_mps, lambda keep: max(0.0, keep))
        gain = TREIBER.accel_mps2 * (1 - (speed / 15.0) ** 4 - (wanted / max(gap, 0.1)) ** 2)
        after = max(speed + max(gain, -TREIBER.emergency_mps2) * dt_s, 0.0)
        along, speed = along + (speed + after) / 2 * dt_s, after
        expected += [along] * (step % 2)
    found = driven(road(), given(40.0 + torch.arange(80) * 0.1 * pace, 0.0))
    assert found == pytest.approx(expected, abs=1e-3)


def test_it_brakes_while_somebody_crosses_and_goes_on():
    """From the right at 5 m/s, on the path at about 3 s."""
    crossing = given(50.0, torch.arange(1, 81) * 0.5 - 15.0, heading=np.pi / 2)
    speed = np.diff(driven(road(), crossing), prepend=0.0) / 0.5
    free = np.diff(driven(road(), FAR), prepend=0.0) / 0.5
    assert speed[:4] == pytest.approx(free[:4], abs=0.01), "not before it is there"
    assert speed[7] < free[7] - 3.0
    assert np.all(np.diff(speed[8:]) > 0)


def test_it_follows_who_is_ahead_already_but_the_given_one_only_as_given():
    behind = driven(road(agents=[(40.0, 0.0, 0.0)]), FAR)
    assert behind[-1] < 40.0 - 4.0
    same = driven(road(agents=[(40.0, 0.0, 0.0)]), given(40.0 + torch.arange(80) * 1.5, 0.0))
    assert same[-1] > 60.0, "it does not stand there, as its motion now would say"


def test_who_is_passed_leads_no_more():
    assert driven(road(), given(-20.0, 0.0))[-1] == pytest.approx(driven(road(), FAR)[-1], abs=1e-3)


def test_goals_are_compared_with_it_at_all_times():
    future = given(60.0, 0.0)
    same = torch.from_numpy(driven(road(), future))
    goals = torch.stack([same, same + torch.arange(1, 17)])[None, None]  # (1, 1, 2, 16)
    on_paths = OnPaths.of(STRAIGHT[None, None], future.position_m)
    found = condition.following(road(), goals, future, on_paths)[0, 0, 0]
    assert found.shape == (2, len(Following))
    assert found[0].tolist() == pytest.approx([0, 0, 0, 0, 1, 1], abs=1e-5)
    leads = found[1, span(Following.LEAD_2, Following.LEAD_8)]
    assert leads.tolist() == pytest.approx([0.4, 0.8, 1.2, 1.6], abs=1e-5)
    assert found[1, Following.CLOSE] < found[1, Following.NEAR] < 1.0


def test_each_future_has_a_follower_of_its_own():
    both = condition.Condition.of(
        torch.cat([given(60.0, 0.0).position_m, FAR.position_m], 1),
        torch.zeros(1, 2, 80),
        torch.ones(1, 2),
        VECTOR,
    )
    along = followed(road(), both)
    assert along[0].numpy() == pytest.approx(driven(road(), given(60.0, 0.0)), abs=1e-4)
    assert along[1].numpy() == pytest.approx(driven(road(), FAR), abs=1e-4)
