"""What is made once for all given futures is what each future alone would give."""

import numpy as np
import pytest
import torch

from deepmf_sumo.deepmf.networks import anchors, condition, decode
from deepmf_sumo.deepmf.networks.condition import GoalRelation, OnPaths
from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.deepmf.networks.densetnt import Attention
from deepmf_sumo.deepmf.networks.encode import span
from deepmf_sumo.deepmf.networks.vgg import VGG16


@pytest.mark.slow_unit
def test_attention_with_own_elements_is_attention_to_all_of_them():
    torch.manual_seed(0)
    attention = Attention(16, 2)
    query, shared, own = torch.randn(3, 1, 16), torch.randn(3, 7, 16), torch.randn(3, 4, 16)
    there = torch.rand(3, 7) > 0.3
    own_there = torch.tensor([[True, False, True, True]] * 3)
    found = attention.with_own(query, shared, there, own, own_there)
    for future in range(4):
        elements = torch.cat([shared, own[:, future : future + 1]], 1)
        mask = torch.cat([there, own_there[:, future : future + 1]], 1)
        alone = attention(query, elements, mask)[:, 0]
        torch.testing.assert_close(found[:, future], alone, atol=1e-6, rtol=0)


def test_own_elements_that_are_not_there_do_not_act():
    torch.manual_seed(0)
    attention = Attention(16, 2)
    query, shared, own = torch.randn(1, 1, 16), torch.randn(1, 7, 16), torch.randn(1, 2, 16)
    there = torch.ones(1, 7) > 0
    found = attention.with_own(query, shared, there, own, torch.zeros(1, 2) > 0)
    expected = attention(query, shared, there).expand(-1, 2, -1)
    torch.testing.assert_close(found, expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("stage", [0, 3])
def test_images_of_futures_are_those_of_scene_and_future_together(stage):
    torch.manual_seed(0)
    preset = LIGHT if stage == 3 else type(LIGHT)(**{**LIGHT.record(), "condition_stage": 0})
    net = VGG16(preset, conditional=True).eval()
    shared = net.shared(torch.rand(2, LIGHT.raster_channels, 56, 56))
    side = shared.shape[-1]
    future = torch.rand(6, LIGHT.condition_channels, side, side)
    image = torch.cat([shared.repeat_interleave(3, 0), future], 1)
    for block in net.blocks[stage:]:
        image = block(image)
    expected = net.out(image.mean((2, 3)))
    torch.testing.assert_close(net(shared, future), expected, atol=1e-5, rtol=1e-5)


def test_paths_of_no_length_have_a_gradient():
    along = torch.rand(1, 2, 5, requires_grad=True)
    paths = torch.zeros(1, 2, 121, 2)
    paths[0, 0, :, 0] = torch.arange(121.0) * 2
    point, tangent = anchors.look_up(paths, along * 100)
    (point.sum() + tangent.sum()).backward()
    assert torch.isfinite(along.grad).all()
    assert (along.grad[0, 0] > 0).all()


def test_points_on_numbered_paths_are_those_of_each_path():
    torch.manual_seed(0)
    paths = torch.randn(1, 3, 121, 2).cumsum(2)
    path = torch.tensor([2, 0, 2, 1])
    along, left = torch.rand(4, 6) * 260, torch.randn(4, 6)
    point, tangent = anchors.placed_on(paths[0], path[:, None], along, left)
    arrays = (each.numpy() for each in (paths[0], path[:, None], along, left))
    for one, same in zip(decode.placed_on(*arrays), (point, tangent), strict=True):
        np.testing.assert_allclose(one, same, atol=1e-4)
    for row, number in enumerate(path.tolist()):
        one = anchors.placed(
            paths[:, number : number + 1], along[row][None, None], left[row][None, None]
        )
        torch.testing.assert_close(point[row], one[0][0, 0])
        torch.testing.assert_close(tangent[row], one[1][0, 0])


def test_relations_at_equal_times_are_those_of_plain_distances():
    torch.manual_seed(0)
    paths = torch.zeros(1, 2, 121, 2)
    paths[0, 0, :, 0] = paths[0, 1, :, 1] = torch.arange(121.0) * 2
    along = torch.rand(1, 2, 3, 16).cumsum(-1) * 6
    other = torch.randn(1, 4, 80, 2).cumsum(2) + 20
    _, goal = condition.relations(paths, along, other, OnPaths.of(paths, other))
    place = torch.zeros(1, 2, 3, 16, 2)
    place[:, 0, ..., 0], place[:, 1, ..., 1] = along[:, 0], along[:, 1]
    apart = (place[:, None] - other[:, :, None, None, 4::5]).norm(dim=-1)
    least = apart.min(-1)
    close = span(GoalRelation.CLOSE_2, GoalRelation.CLOSE_8)
    torch.testing.assert_close(goal[..., close], torch.exp(-apart[..., 3::4] / 12))
    torch.testing.assert_close(goal[..., GoalRelation.LEAST], (least.values / 10).clamp_max(3))
    torch.testing.assert_close(goal[..., GoalRelation.CLOSEST], torch.exp(-least.values / 3))
    torch.testing.assert_close(goal[..., GoalRelation.CLOSEST_TIME], least.indices / 16)
