from dataclasses import replace

import numpy as np
import pytest
import torch

from deepmf_sumo.deepmf.networks import condition, decode, encode, torch_networks
from deepmf_sumo.deepmf.networks.condition import OnPaths, PathRelation
from deepmf_sumo.deepmf.networks.config import LIGHT, PAPER
from deepmf_sumo.deepmf.networks.densetnt import as_batch
from deepmf_sumo.deepmf.networks.encode import features, lane_arrays
from deepmf_sumo.deepmf.networks.lanes import ROAD_CHANNELS, road_index
from deepmf_sumo.deepmf.networks.predict import Marginal
from deepmf_sumo.deepmf.networks.vgg import unpack
from deepmf_sumo.scene import Futures, RoadMap
from deepmf_sumo.scene.geometry.frames import pose_of

from tests.support.synthetic import lane, scene, straight, view


@pytest.fixture(scope="module")
def predictors():
    return torch_networks.random(LIGHT, 0)


def southern(shift=0.0):
    """The partner's future, in one or more variants."""
    tracks = scene().tracks
    row = tracks.row("south")
    position = tracks.position_m[row, 11:91] + [0.0, shift]
    return Futures(
        agent_id="south",
        position_m=position[None],
        heading_rad=tracks.heading_rad[row, 11:91][None],
    )


def test_columns_stand_where_trained_weights_read_them():
    arrays, _ = features(view(), "av", LIGHT, planner=True)
    assert arrays["agents"][0, -1].tolist() == [0, 0, 1, 0, 10, 0, 1]
    assert arrays["agent_info"][0] == pytest.approx([4.8, 2, 1, 0, 0, 0, 1, 1])
    assert arrays["lane_info"][0].tolist()[:4] == [0, 1, 0, 0]
    assert arrays["lane_info"][0, [4, 9]] == pytest.approx([13.9, 1])
    first, fan = arrays["path_info"][0], arrays["path_info"][2]
    assert first[:4].tolist() == [1, 0, 0, 0]
    assert first[[4, 5, 6]] == pytest.approx([200, 13.9, 40])
    assert first[7:].tolist() == [0, 0, 0, 1, 0, 0, 3]  # its signal is green
    assert fan.tolist() == [1, 1, 0, 0, 0, 0, 200, 1, 0, 0, 0, 0, 0, 0]
    assert arrays["motion"] == pytest.approx([10, 0, 0, 4.8, 2, 1, 1])
    ahead = arrays["path_agents"][0][np.argmax(arrays["path_agents"][0, :, 0])]
    assert ahead == pytest.approx([110, 0, 0, 0, 1, 0, 4.8, 1], abs=1e-4)  # the one that waits


def test_forecasts_have_the_promised_form(predictors):
    found = [predictors.marginal.predict(view(), name).modes(32) for name in ("av", "south")]
    assert [each.futures.agent_id for each in found] == ["av", "south"]
    for each in found:
        assert each.futures.position_m.shape == (32, 80, 2)
        assert each.futures.heading_rad.shape == (32, 80)
        assert each.probability.sum() == pytest.approx(1.0)
        assert (np.diff(each.probability) <= 1e-12).all()


def test_futures_begin_at_the_pose_and_are_smooth(predictors):
    futures = predictors.marginal.predict(view(), "av").modes(16).futures
    first = futures.position_m[:, 0] - [-50.0, 0.0]
    assert np.abs(first - [1.0, 0.0]).max() < 0.5
    step = np.linalg.norm(np.diff(futures.position_m, axis=1), axis=-1)
    assert np.abs(np.diff(step, axis=1)).max() < 0.3
    assert np.abs(futures.heading_rad[:, 0]).max() < 0.3


def test_forecasts_turn_with_the_scene(predictors):
    plain = predictors.marginal.predict(view(), "av").modes(6).futures.position_m
    turned = predictors.marginal.predict(view(scene(turn=0.7)), "av").modes(6).futures.position_m
    rotation = np.array([[np.cos(0.7), np.sin(0.7)], [-np.sin(0.7), np.cos(0.7)]])
    assert turned == pytest.approx(plain @ rotation, abs=0.05)


@pytest.fixture(scope="module")
def opinionated():
    """Scores that differ, so that few goals have most of the mass."""
    net = torch_networks.random(LIGHT, 0).marginal.net
    net.score.weight.data *= 30.0
    return net


def test_modes_spread_wider_where_the_temperature_says_that_tails_are_likelier(opinionated):
    def spread(temperature):
        ends = (
            Marginal([opinionated], temperature)
            .predict(view(), "av")
            .modes(6)
            .futures.position_m[:, -1]
        )
        return np.linalg.norm(ends[:, None] - ends, axis=-1).mean()

    assert spread(20.0) > spread(1.0) + 1.0


def test_modes_chosen_at_a_step_are_nearer_there_to_what_may_happen(opinionated):
    marginal = Marginal([opinionated], 1.0)
    goals = opinionated.goals_of(opinionated.scene_of(features(view(), "av", LIGHT)[0]))
    probability = np.exp(decode.log_softmax(goals.logits.ravel()))
    every = decode.complete(goals, np.arange(len(probability))[None])
    all_m = decode.to_scene(pose_of(view(), "av"), *every)[0][0, :, 29]

    def expected_error(chosen_at):
        found = marginal.predict(view(), "av").modes(6, chosen_at=chosen_at)
        apart = np.linalg.norm(all_m[:, None] - found.futures.position_m[:, 29], axis=-1)
        return float(apart.min(1) @ probability)

    assert expected_error(29) < expected_error(None)


def test_prediction_is_repeatable(predictors):
    first, second = (predictors.marginal.predict(view(), "av").modes(6) for _ in range(2))
    assert np.array_equal(first.futures.position_m, second.futures.position_m)
    assert np.array_equal(first.probability, second.probability)


def test_density_is_higher_near_the_modes(predictors):
    modes = predictors.marginal.predict(view(), "av").modes(6).futures.position_m
    density = predictors.marginal.predict(view(), "av").log_density(
        np.concatenate([modes, modes + 40.0])
    )
    assert density.shape == (12,)
    assert density[:6].min() > density[6:].max()


def test_one_forecast_per_given_future(predictors):
    given = southern()
    many = Futures(
        agent_id="south",
        position_m=np.repeat(given.position_m, 3, 0) + np.arange(3)[:, None, None],
        heading_rad=np.repeat(given.heading_rad, 3, 0),
    )
    found = predictors.conditional.predict(view(), "av").given(many, 6)
    assert len(found) == 3
    alone = predictors.conditional.predict(view(), "av").given(given, 6)[0]
    assert alone.futures.position_m == pytest.approx(found[0].futures.position_m, abs=1e-3)
    assert alone.probability == pytest.approx(found[0].probability, abs=1e-4)


@pytest.mark.parametrize("path", ["tokens", "image", "position_m"])
def test_the_given_future_acts_through_each_path_alone(predictors, path):
    net = predictors.conditional.net
    arrays, _ = features(view(), "av", LIGHT)
    pose = pose_of(view(), "av")

    def encoded(futures):
        local = decode.to_pose(pose, futures)
        position, heading = (torch.from_numpy(one)[None] for one in local)
        return condition.Condition.of(position, heading, torch.ones(1, 1), LIGHT)

    with torch.inference_mode():
        base = encoded(southern())
        other = encoded(southern(-25.0))
        mixed = replace(base, **{path: getattr(other, path)})
        plain = net(as_batch(arrays), base).logits
        changed = net(as_batch(arrays), mixed).logits
    there = torch.isfinite(plain)
    assert (plain[there] - changed[there]).abs().max() > 1e-5


def test_without_a_condition_the_conditional_is_marginal(predictors):
    arrays, _ = features(view(), "av", LIGHT)
    pose = pose_of(view(), "av")
    net = predictors.conditional.net
    with torch.inference_mode():
        local = decode.to_pose(pose, southern())
        position, heading = (torch.from_numpy(one)[None] for one in local)
        off = condition.Condition.of(position, heading, torch.zeros(1, 1), LIGHT)
        dropped = net(as_batch(arrays), off).logits
        none = net(as_batch(arrays)).logits
    assert torch.equal(dropped, none)


def test_relations_are_those_of_full_precision_where_the_rest_is_computed_in_bf16():
    along = torch.linspace(0.0, 240.0, 121)
    beside = torch.arange(4.0) * 3.5
    line = torch.stack(torch.broadcast_tensors(along, beside[:, None]), -1)
    profiles = torch.linspace(0.0, 100.0, 16).expand(1, 4, 6, 16)
    position = torch.stack([torch.linspace(5.0, 105.0, 80), torch.ones(80)], -1)
    arguments = line[None], profiles, position[None, None]

    def relations():
        on_paths = OnPaths.of(line[None], position[None, None])
        return condition.relations(*arguments, on_paths)

    path, goal = relations()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        half_path, half_goal = relations()
    assert torch.equal(path, half_path)
    assert torch.equal(goal, half_goal)
    met = path[0, 0, :, PathRelation.MET]
    assert met.tolist() == [1.0, 1.0, 0.0, 0.0]  # within 3.5 m of the first two


def test_candidates_are_vehicles_near_by_that_are_not_parked(predictors):
    found = predictors.opponent.score(view())
    assert found.ids == ("south",)  # waiting and far are beyond 80 m
    near = predictors.opponent.score(view(scene(av_speed=10.0), step=60))
    assert set(near.ids) == {"south", "waiting"}
    assert len(near.logits) == len(near.partner_logits) == 2


def test_there_may_be_nobody_to_attack(predictors):
    alone = view()
    alone = replace(alone, history=alone.history.select([0]))
    assert predictors.opponent.score(alone).ids == ()
    assert predictors.marginal.predict(alone, "av").modes(6).probability.sum() == pytest.approx(1.0)


def test_an_agent_that_is_not_there_is_an_error(predictors):
    with pytest.raises(KeyError, match="nobody"):
        predictors.marginal.predict(view(), "nobody")


def test_the_image_shows_what_is_where():
    seen = view()
    image = encode.draw(seen, road_index(seen.road), LIGHT, pose_of(seen, "av"))
    assert image.shape == (20, 56, 56)
    assert image[1, 14, 28] == 1  # the target, now, at a quarter of the height
    street = 8 + ROAD_CHANNELS.index("street")
    assert image[street, 14:40, 28].all()
    bits = torch.from_numpy(encode.pack(image))[None]
    assert np.array_equal(unpack(bits, LIGHT)[0].numpy(), image)


def test_paper_preset_has_the_published_sizes():
    net = torch_networks.build("conditional", PAPER)
    assert PAPER.raster_channels == 60
    assert net.image.blocks[0][0].weight.shape == (64, 140, 3, 3)
    kernels = [m for m in net.image.modules() if isinstance(m, torch.nn.Conv2d)]
    assert len(kernels) == 13
    assert sum(k.weight.numel() for k in kernels) == pytest.approx(14.8e6, rel=0.01)


def test_the_pieces_of_lanes_are_the_nearest_in_order():
    """Of equally near pieces the first ones of the road: as if all were sorted."""
    lanes = [lane(f"{y}", straight((-90, 3.0 * y), (90, 3.0 * y))) for y in range(-9, 10)]
    seen = replace(view(), road=RoadMap(lanes={one.id: one for one in lanes}))
    index, pose = road_index(seen.road), pose_of(seen, "av")
    pieces, info = lane_arrays(seen, index, 48, pose)
    ahead = pose.position_m + 2 * pose.speed_mps * np.array([1.0, 0.0])
    square = ((index.piece_m[:, 5] - ahead) ** 2).sum(-1)
    rows = np.argsort(square, kind="stable")[:48]
    assert len(square) > 100
    assert np.array_equal(pieces, pose.to_local(index.piece_m[rows]))
    assert info[:, 9].all()
