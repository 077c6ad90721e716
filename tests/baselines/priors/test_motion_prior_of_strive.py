"""STRIVE's graph, bicycle, costs and network."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from deepmf_sumo.baselines.priors import bicycle, costs, reading
from deepmf_sumo.baselines.priors.graph import MEMBERS, NODES, SPACING_M, graph_of, members
from deepmf_sumo.baselines.priors.strive import LATENT, Gaussian, MotionPrior
from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.errors import WeightsError
from deepmf_sumo.training import cards

from tests.support.synthetic import scene, view


@pytest.fixture(scope="module")
def net():
    torch.manual_seed(3)
    return MotionPrior(LIGHT).eval()


def batch_of(seen, ids=None):
    arrays = graph_of(seen, ids or members(seen))
    return {name: torch.from_numpy(values)[None] for name, values in arrays.items()}


def latents(seed, scale=1.0):
    generator = torch.Generator().manual_seed(seed)
    return scale * torch.randn(1, MEMBERS, LATENT, generator=generator)


def test_the_av_comes_first_then_who_is_wanted_then_the_nearest_that_move():
    near = view(scene(shift=30.0))  # south is a little farther away than the parked car
    ids = members(near, ("far",))
    assert ids[:3] == ("av", "far", "south")
    assert "walker" not in ids
    assert set(ids) == {"av", "far", "south", "parked", "waiting"}
    assert ids.index("south") < ids.index("parked")


def test_an_agent_that_is_not_there_is_an_error():
    with pytest.raises(KeyError):
        members(view(), ("ghost",))


def test_each_vehicle_is_described_in_its_own_frame():
    graph = graph_of(view(), ("av", "south"))
    np.testing.assert_allclose(graph["history"][1, -1], [0, 0, 1, 0, 9, 0, 1], atol=1e-5)
    np.testing.assert_allclose(graph["history"][1, 0, :2], [-9, 0], atol=1e-5)
    np.testing.assert_allclose(graph["pose"][1], [50, -45, np.pi / 2], atol=1e-5)
    np.testing.assert_allclose(graph["motion"][1], [9, 0, 0], atol=1e-5)
    assert graph["kind"][:, 2].tolist() == [1, 1] + [0] * (MEMBERS - 2)
    for values in graph.values():
        assert not values[2:].any()


def test_ways_follow_the_lanes_and_the_last_is_straight_on():
    graph = graph_of(view(), ("av",))
    offered = graph["way_info"][0, :, 0] > 0
    fan = graph["way_info"][0, :, 1] > 0
    assert fan[offered].tolist() == [False] * (offered.sum() - 1) + [True]
    steps = np.linalg.norm(np.diff(graph["ways"][0, offered], axis=1), axis=-1)
    assert np.abs(steps - SPACING_M).max() < 0.3
    ends = graph["ways"][0, offered, NODES // 2]
    assert ends[:, 1].max() > 30  # the left turn
    assert np.abs(ends[:, 1]).min() < 1e-3  # straight through


def test_graphs_do_not_depend_on_the_scenes_frame():
    still = graph_of(view(), members(view()))
    turned_view = view(scene(turn=1.1))
    turned = graph_of(turned_view, members(turned_view))
    for name, values in still.items():
        np.testing.assert_allclose(turned[name], values, atol=2e-3)


def test_constant_controls_drive_a_circle_at_constant_speed():
    speed, curvature = torch.tensor([10.0]), torch.tensor([0.02])
    state = bicycle.BicycleState(
        torch.zeros(1, 2), torch.zeros(1), speed, torch.zeros(1), curvature
    )
    for _ in range(bicycle.CONTROLS):
        state, leg = bicycle.advance(state, torch.zeros(1), curvature)
    angle = 80 * 0.02
    assert state.heading.item() == pytest.approx(angle, rel=1e-4)
    centre = torch.tensor([0.0, 50.0])
    assert (state.position - centre).norm().item() == pytest.approx(50.0, abs=0.02)
    assert leg.speed.squeeze().tolist() == pytest.approx([10.0] * 5)


def test_braking_ends_at_rest_and_stays():
    state = bicycle.start(torch.tensor([[5.0, 0.0, 0.0]]))
    for _ in range(6):
        state, leg = bicycle.advance(state, torch.tensor([-5.0]), torch.zeros(1))
    assert leg.speed.abs().max() == 0
    assert np.ptp(leg.position[0, :, 0].numpy()) == 0


def test_no_control_leaves_what_tyres_can_do(net):
    batch = batch_of(view())
    with torch.no_grad():
        motions = net.decode(batch, net.encode(batch), latents(0, scale=30.0))
    speed = motions.speed[0, :5].double().numpy()
    along = np.diff(speed, axis=-1) / 0.1
    assert along.max() < bicycle.ACCEL_MPS2 + 0.05
    assert along.min() > -bicycle.BRAKE_MPS2 - 0.05
    turn = np.abs(np.diff(motions.heading[0, :5].double().numpy(), axis=-1)) / 0.1
    assert (turn * speed[:, 1:]).max() < bicycle.LATERAL_MPS2 + 0.1


def test_motions_begin_where_the_vehicles_are_and_move_as_they_say(net):
    seen = view()
    batch = batch_of(seen)
    with torch.no_grad():
        motions = net.decode(batch, net.encode(batch), latents(1)).placed(batch)
    row = members(seen).index("south")
    first = motions.position[0, row, 0] - batch["pose"][0, row, :2]
    np.testing.assert_allclose(first, [0, 0.9], atol=0.05)
    moved = motions.position[0, row].diff(dim=0).norm(dim=-1) / 0.1
    np.testing.assert_allclose(moved, motions.speed[0, row, 1:], atol=0.25)


def test_a_latent_of_one_vehicle_moves_another_only_through_messages(net):
    seen = view()
    batch, row = batch_of(seen), members(seen).index("south")
    latent = latents(2).requires_grad_()
    motions = net.decode(batch, net.encode(batch), latent)
    (gradient,) = torch.autograd.grad(motions.position[0, row].sum(), latent)
    assert gradient[0, row].abs().sum() > 0
    assert gradient[0, 0].abs().sum() > 0  # the AV's is heard
    assert gradient[0, 5:].abs().sum() == 0  # nobody is there
    absent = {**batch, "kind": batch["kind"].clone()}
    absent["kind"][0, 0, 2] = 0
    motions = net.decode(absent, net.encode(absent), latent)
    (gradient,) = torch.autograd.grad(motions.position[0, row].sum(), latent)
    assert gradient[0, 0].abs().sum() == 0


def test_divergence_against_torch():
    parts = [
        torch.randn(2, 3, LATENT, generator=torch.Generator().manual_seed(n)) for n in range(4)
    ]
    one, other = Gaussian(parts[0], parts[1]), Gaussian(parts[2], parts[3])
    expected = torch.distributions.kl_divergence(
        torch.distributions.Normal(one.mean, one.log_sigma.exp()),
        torch.distributions.Normal(other.mean, other.log_sigma.exp()),
    ).sum(-1)
    torch.testing.assert_close(one.divergence(other), expected)


def test_boxes_that_meet_overlap_and_others_do_not():
    size = torch.tensor([[[4.8, 2.0], [4.8, 2.0]]])
    there = torch.ones(1, 2, dtype=torch.bool)
    heading = torch.zeros(1, 2, 3)
    offsets = torch.tensor([[4.0, 0.0], [4.0, 3.0], [7.5, 0.0]])
    position = torch.stack([torch.zeros(3, 2), offsets])[None]
    depth = costs.mutual_overlap(position, heading, size, there)
    assert depth[0, 0, 0] > 0.2
    assert depth[0, :, 1:].abs().max() == 0
    assert costs.mutual_overlap(position, heading, size, there & False).max() == 0


def test_metres_off_the_road():
    road = torch.stack([torch.arange(0.0, 50.0), torch.zeros(50)], -1)
    points = torch.tensor([[10.0, 1.0], [10.0, 5.0], [-7.0, 0.0]])
    np.testing.assert_allclose(costs.off_road(points, road, 2.0), [0, 3, 5], atol=1e-5)


def test_a_set_without_the_prior_names_the_command(tmp_path):
    with pytest.raises(WeightsError, match=r"strive\.json is missing.*deepmf-sumo train strive"):
        reading.motion_prior(tmp_path)


def test_weights_go_through_a_file(net, tmp_path):
    card = {"network": "strive", "preset": "light", "sizes": LIGHT.record()}
    cards.write(tmp_path / "set", "strive", net, card)
    assert "## strive" in (tmp_path / "set" / "card.md").read_text()
    again = reading.motion_prior(tmp_path / "set")
    assert not again.training
    batch = batch_of(view())
    with torch.no_grad():
        first = net.decode(batch, net.encode(batch), latents(4)).position
        second = again.decode(batch, again.encode(batch), latents(4)).position
    assert (first - second).abs().max() < 0.1  # stored in half precision


def test_fewer_vehicles_can_be_decoded_than_a_graph_holds(net):
    batch = batch_of(view())
    few = {name: values[:, :5] for name, values in batch.items()}
    with torch.no_grad():
        all_of_them = net.decode(batch, net.encode(batch), latents(5)).position[:, :5]
        some = net.decode(few, net.encode(few), latents(5)[:, :5]).position
    torch.testing.assert_close(some, all_of_them)


def test_a_vehicle_seen_for_one_step_has_no_acceleration():
    seen = view()
    valid = np.zeros_like(seen.history.valid)
    valid[:, -1] = True
    graph = graph_of(replace(seen, history=replace(seen.history, valid=valid)), ("av", "south"))
    np.testing.assert_allclose(graph["motion"][:2], [[10, 0, 0], [9, 0, 0]], atol=1e-5)
