import itertools

import numpy as np
import pytest
import torch

from deepmf_sumo.deepmf.networks import anchors, condition, decode
from deepmf_sumo.deepmf.networks.condition import GoalRelation, OnPaths, PathRelation
from deepmf_sumo.deepmf.networks.config import LIGHT, PAPER
from deepmf_sumo.deepmf.networks.vgg import draw_future
from deepmf_sumo.errors import RunError


def straight_path():
    line = torch.zeros(1, 1, 121, 2)
    line[..., 0] = torch.arange(121) * 2.0
    return line


def test_points_on_a_circle_are_found_with_its_tangent():
    angle = torch.arange(121) * 2.0 / 50.0
    circle = 50.0 * torch.stack([angle.sin(), 1 - angle.cos()], -1)[None, None]
    along = torch.tensor([[[0.0, 15.0, 41.3]]])
    point, tangent = anchors.look_up(circle, along)
    true = torch.stack([50 * (along / 50).sin(), 50 * (1 - (along / 50).cos())], -1)
    assert (point - true).norm(dim=-1).max() < 0.02
    assert torch.atan2(tangent[..., 1], tangent[..., 0])[0, 0, 1:] == pytest.approx(
        (along / 50)[0, 0, 1:], abs=0.02
    )


def test_paths_go_straight_on_past_their_end():
    point, _ = anchors.look_up(straight_path(), torch.tensor([[[300.0]]]))
    assert point[0, 0, 0].tolist() == pytest.approx([300.0, 0.0])


def test_left_is_left():
    point, _ = anchors.placed(
        straight_path(), torch.full((1, 1, 1, 1), 9.0), torch.full((1, 1, 1, 1), 2.0)
    )
    assert point.flatten().tolist() == pytest.approx([9.0, 2.0])


def test_profiles_between_start_speeds_and_never_backwards():
    table = torch.zeros(13, 24, 80)
    table[:, 0] = -100.0
    distance = anchors.profiles_at(table, torch.tensor([6.0, 40.0]))
    assert distance[0, 1, 79] == pytest.approx(48.0)
    assert distance[1, 1, 79] == pytest.approx(320.0)
    assert distance[0, 0].tolist() == [0.0] * 80


def test_residuals_pass_their_knots_and_start_flat():
    curve = np.array([1.0, 2.0, 4.0, 6.0, 8.0]) @ decode.knot_matrix()
    assert curve[list(decode.KNOT_STEPS)].tolist() == pytest.approx([1, 2, 4, 6, 8], abs=1e-5)
    assert curve[0] < 0.02
    assert np.diff(curve).min() > 0


def test_medoids_cover_and_masses_sum_to_one():
    ends = np.array([[[0.0, 0], [1, 0], [50, 0], [51, 0], [100, 0]]], np.float32)
    weight = np.array([[0.3, 0.25, 0.2, 0.15, 0.1]], np.float32)
    chosen, mass = decode.select(weight[:, None], ends, 3)
    assert chosen.tolist() == [[0, 2, 4]]
    assert mass.flatten().tolist() == pytest.approx([0.55, 0.35, 0.1])


def expected(weight, ends, chosen):
    apart = np.minimum(np.hypot(*(ends[:, None] - ends).T), decode.CAP_M)
    return float((weight * apart[chosen].min(0)).sum())


@pytest.mark.parametrize("seed", range(5))
def test_medoids_are_nearly_the_best_of_all_choices(seed):
    rng = np.random.default_rng(seed)
    ends = rng.random((14, 2), np.float32) * 60
    weight = np.exp(rng.random(14, np.float32))
    weight /= weight.sum()
    chosen, _ = decode.select(weight[None, None], ends[None], 3)
    found = expected(weight, ends, chosen[0])
    every = [list(rows) for rows in itertools.combinations(range(14), 3)]
    assert found < 1.05 * min(expected(weight, ends, rows) for rows in every)


def test_a_first_medoid_between_two_groups_moves_into_one():
    ends = np.array([[[0.0, 0], [10, 0], [20, 0]]], np.float32)
    chosen, mass = decode.select(np.array([[[0.35, 0.3, 0.35]]], np.float32), ends, 2)
    assert sorted(chosen[0].tolist()) == [0, 2]
    assert mass.sum() == pytest.approx(1.0)


def test_too_many_modes_are_refused():
    with pytest.raises(RunError, match="9 modes"):
        decode.select(np.ones((1, 1, 4)) / 4, np.zeros((1, 4, 2)), 9)


@pytest.mark.parametrize("preset", [LIGHT, PAPER])
def test_a_future_is_drawn_where_it_goes(preset):
    future = torch.zeros(1, 2, 80, 2)
    future[0, 0, :, 0] = torch.linspace(1.0, 80.0, 80)
    image = draw_future(future, preset)
    assert image.shape[:2] == (2, preset.condition_channels)
    assert image.sum((1, 2, 3)).tolist() == pytest.approx([preset.condition_channels] * 2, rel=1e-4)
    row = image[0].sum((0, 2))
    assert row.nonzero().min() >= image.shape[2] // 4 - 1
    moved = future.clone()
    moved[0, 0, :, 1] += 1.0
    assert not torch.equal(draw_future(moved, preset)[0], image[0])


def relations(paths, along, other):
    return condition.relations(paths, along, other, OnPaths.of(paths, other))


def test_relations_know_who_comes_first():
    along = torch.zeros(1, 1, 2, 16)
    along[0, 0, 0] = torch.arange(1, 17) * 5.0  # fast: at 40 m after 4 s
    along[0, 0, 1] = torch.arange(1, 17) * 1.0  # slow: never there
    other = torch.zeros(1, 1, 80, 2)
    other[..., 0] = 40.0
    other[..., 1] = torch.linspace(-29.0, 50.0, 80)  # crosses at 3 s
    path, goal = relations(straight_path(), along, other)
    assert path[0, 0, 0, PathRelation.MET] == 1.0  # they meet
    assert path[0, 0, 0, PathRelation.PLACE] == pytest.approx(40 / 50, abs=0.05)
    assert abs(float(path[0, 0, 0, PathRelation.COS])) < 0.01  # at a right angle
    fast, slow = goal[0, 0, 0]
    assert fast[GoalRelation.REACHES] == 1.0
    assert slow[GoalRelation.REACHES] == 0.0
    assert fast[GoalRelation.AFTER] > 0  # arrives after the other entered
    assert slow[GoalRelation.AFTER] > fast[GoalRelation.AFTER]


def test_a_leader_is_ahead_and_who_is_beside_the_path_is_not_on_it():
    along = (torch.arange(1, 17) * 5.0).expand(1, 1, 1, 16)  # 10 m/s
    other = torch.zeros(1, 2, 80, 2)
    other[0, 0, :, 0] = 30.0 + torch.arange(1, 81)  # the same speed, 30 m ahead
    other[0, 1] = other[0, 0] + torch.tensor([0.0, 8.0])
    _, goal = relations(straight_path(), along, other)
    assert goal[0, 0, 0, 0, GoalRelation.LEAD_2 :].tolist() == pytest.approx([1.5] * 4, abs=0.06)
    assert goal[0, 1, 0, 0, GoalRelation.LEAD_2 :].tolist() == [0.0] * 4


def test_numbers_are_finite_for_a_standing_other():
    along = torch.ones(1, 1, 2, 16)
    path, goal = relations(straight_path(), along, torch.zeros(1, 3, 80, 2))
    assert bool(torch.isfinite(path).all())
    assert bool(torch.isfinite(goal).all())
    assert np.prod(goal.shape) == 3 * 2 * len(GoalRelation)


def test_braking_profiles_stop_and_hold():
    speeds = torch.tensor([0.0, 10.0, 30.0])
    driven = anchors.braking(speeds) + speeds.view(-1, 1, 1) * torch.arange(1, 81) * 0.1
    assert (driven[0] == 0).all()
    assert (torch.diff(driven, dim=-1) >= -1e-4).all()
    hard_stop, brief = driven[1, 2], driven[1, 3]
    assert hard_stop[-1] == pytest.approx(10.0**2 / (2 * 8.0), abs=0.05)
    assert brief[-1] - brief[-2] == pytest.approx((10.0 - 3.0 * 1.5) * 0.1, abs=0.01)
    assert driven[2, 2, 9] == pytest.approx(30.0 - 4.0, abs=0.05)
