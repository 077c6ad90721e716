"""`examples/train_planner.py`: what its driver sees and does, and the environment it learns in."""

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepmf_sumo import plugins

from tests.support.rollout_doubles import case_of
from tests.support.synthetic import view

pytest.importorskip("gymnasium", reason="Gymnasium, an extra, is not installed")
FILE = Path(__file__).resolve().parents[2] / "examples" / "train_planner.py"


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("train_planner", FILE)
    module = importlib.util.module_from_spec(spec)
    sys.modules["train_planner"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["train_planner"]


def seen(av_speed, other, other_velocity):
    """The AV at the origin heading east, and one other vehicle."""
    history = view().history
    rows = [history.row("av"), history.row("south")]
    tracks = history.select(rows)
    position, velocity = np.zeros((2, 11, 2)), np.zeros((2, 11, 2))
    velocity[0], velocity[1] = (av_speed, 0.0), other_velocity
    position[1] = other
    heading = np.arctan2(velocity[..., 1], velocity[..., 0])
    tracks = replace(
        tracks, position_m=position, velocity_mps=velocity, heading_rad=heading,
        valid=np.ones((2, 11), bool),
    )  # fmt: skip
    return replace(view(), history=tracks)


def test_the_closest_approach_of_crossing_vehicles_is_observed(example):
    """AV at 10 m/s, the other 20 m ahead and 20 m to the right, northwards at 10 m/s: 2 s, 0 m."""
    found = example.observed(seen(10.0, (20.0, -20.0), (0.0, 10.0)))
    assert found.shape == (4 + 9 * example.NEAREST,)
    there, x, y, vx, vy, cos, sin, closest_s, closest_m = found[4:13]
    assert there == 1.0
    assert (30 * x, 10 * y) == pytest.approx((20.0, -20.0))
    assert (10 * vx, 10 * vy) == pytest.approx((-10.0, 10.0))
    assert (cos, sin) == pytest.approx((0.0, 1.0), abs=1e-9)
    assert example.LOOK_AHEAD_S * closest_s == pytest.approx(2.0)
    length = view().history.size_m[view().history.row("av"), 0]
    assert 5 * closest_m == pytest.approx(-length / 2)
    assert not found[13:].any()


def test_the_driver_holds_a_choice_for_two_steps_and_keeps_to_its_limit(example, tmp_path):
    size = 4 + 9 * example.NEAREST
    speed_first = np.zeros((5, size))
    speed_first[0, 0], speed_first[4, 0] = 1.0, -1.0  # brakes above 10 m/s, else accelerates
    np.savez(tmp_path / "one.npz", weight=speed_first, bias=np.array([-1.0, -9, -9, -9, 1.0]))
    module = plugins.load("planners", "train_planner:Driver")
    settings = plugins.settings(
        "planners", "train_planner:Driver", {"policy": str(tmp_path / "one.npz")}
    )
    driver = module.build(settings)
    driver.reset(case_of(), np.random.default_rng(0))
    fast, slow = seen(12.0, (50.0, 9.0), (0.0, 1.0)), seen(5.0, (50.0, 9.0), (0.0, 1.0))
    assert driver.act(fast).speed_mps == pytest.approx(12.0 - 0.8)
    assert driver.act(slow).speed_mps == pytest.approx(5.0 - 0.8)  # the choice of the step before
    assert driver.act(slow).speed_mps == pytest.approx(5.0 + 0.2)
    driver.reset(case_of(), np.random.default_rng(0))
    near = seen(7.9, (50.0, 9.0), (0.0, 1.0))
    assert driver.act(near).speed_mps == pytest.approx(8.0)


@pytest.mark.sumo
def test_the_environment_attacks_and_brakes(example, tmp_path, monkeypatch):
    """A recorded scene under an attack of the first stage, and one without an attack."""
    config = FILE.parents[1] / "sumo_nets" / "four_way" / "four_way.sumocfg"
    assert not example.run(
        "data", "record", config, "--out", tmp_path / "scenes", "--scenes", 1, "--seed", 1
    )
    monkeypatch.setattr(example, "PLAIN_SHARE", 0.0)
    for attacked in (False, True):
        traffic = example.Traffic(tmp_path / "scenes", attacked=attacked, seed=3)
        rewards, speeds, over = [], [], False
        state, _ = traffic.reset()
        while not over:
            state, reward, ended, late, _ = traffic.step(1)  # -4 m/s2
            rewards.append(reward)
            speeds.append(10 * state[0])
            over = ended or late
        assert np.isfinite(rewards).all()
        assert speeds[-1] < 0.5
        assert max(np.diff(speeds)) < 0.1
        assert (traffic._now.attack.rollout.opponent_id is not None) == attacked
