"""Dense goals: where they lie, how they are drawn, and networks that score them."""

import numpy as np
import pytest
import torch

from deepmf_sumo.deepmf.networks import anchors, decode, torch_networks
from deepmf_sumo.deepmf.networks.anchors import placed
from deepmf_sumo.deepmf.networks.config import DENSE
from deepmf_sumo.deepmf.networks.decode import KNOT_STEPS
from deepmf_sumo.deepmf.networks.densetnt import DenseTNT, as_batch, trimmed
from deepmf_sumo.deepmf.networks.encode import features
from deepmf_sumo.errors import WeightsError
from deepmf_sumo.scene import FUTURE_STEPS
from deepmf_sumo.training import onnx_graphs
from deepmf_sumo.training.networks import trajectory

from tests.support.synthetic import view


def straight_paths(*turns):
    """(1, P, 121, 2) straight paths from the origin in some directions, rad."""
    along = torch.arange(121) * 2.0
    return torch.stack(
        [torch.stack([along * np.cos(turn), along * np.sin(turn)], -1) for turn in turns]
    )[None]


def grid_of(paths, speed=10.0):
    exists = torch.ones(paths.shape[:2], dtype=torch.bool)
    return anchors.every(paths, exists, torch.tensor([speed]))


def test_goals_are_a_metre_apart_and_belong_to_one_path():
    paths = straight_paths(0.0, 0.0, 0.5)
    grid = grid_of(paths)
    place, _ = placed(paths, grid.along_m, grid.left_m)
    first = place[0, 0][grid.there[0, 0]]
    apart = torch.cdist(first, first) + 9.0 * torch.eye(len(first))
    assert apart.min() == pytest.approx(1.0, abs=1e-4)
    assert first[:, 0].max() == 140.0  # 8 s at 10 m/s and 60 m
    assert first[:, 1].abs().max() == 2.0
    assert not grid.there[0, 1].any()  # the same path again
    assert not grid.there[0, 2, 0]  # where it begins it is the first path
    assert grid.there[0, 2].any()


def test_a_vehicle_at_rest_has_no_goals_beside_it():
    grid = grid_of(straight_paths(0.0), speed=0.0)
    beside = grid.there & (grid.along_m == 0.0)
    assert beside.sum() == 1
    assert grid.along_m[grid.there].max() == 60.0


def test_goals_are_reached_on_time_and_never_backwards():
    along = torch.tensor([[[0.0, 5.0, 39.9, 40.0, 80.0, 140.0]]])
    for speed in (0.0, 10.0, 30.0):
        driven = anchors.driven(along, torch.tensor([speed]))[0, 0]
        assert driven[:, -1].tolist() == pytest.approx(along.flatten().tolist(), abs=1e-3)
        assert torch.diff(driven, dim=-1).min() > -1e-4
    # constant acceleration from 10 m/s to 80 m in 8 s is no acceleration
    ten = anchors.driven(along, torch.tensor([10.0]))[0, 0, 4]
    assert ten[9::10].tolist() == pytest.approx([10, 20, 30, 40, 50, 60, 70, 80])


def test_the_nearest_goal_is_the_nearest_of_all():
    paths = straight_paths(0.0, 0.4, -0.6)
    grid = grid_of(paths)
    place, _ = placed(paths, grid.along_m, grid.left_m)
    for end in ([57.3, 1.2], [31.0, 13.9], [80.4, -55.0], [0.3, 0.2]):
        found, path = anchors.nearest(paths, grid, torch.tensor([end]))
        off = (place[0] - torch.tensor(end)).norm(dim=-1).masked_fill(~grid.there[0], np.inf)
        row = int(path)
        mine, _ = placed(paths, found.along_m, found.left_m)
        assert (mine[0, row, 0] - torch.tensor(end)).norm() <= off.min() + 0.05
        assert found.there[0, row, 0]


def test_drawn_goals_stand_for_all_of_their_path():
    grid = grid_of(straight_paths(0.0, 0.5))
    drawn = anchors.drawn(grid, 64, torch.Generator().manual_seed(0))
    for path in (0, 1):
        own = grid.there[0, path]
        every = grid.along_m[0, path][own].tolist(), grid.left_m[0, path][own].tolist()
        there = set(zip(*every, strict=True))
        some = zip(drawn.along_m[0, path].tolist(), drawn.left_m[0, path].tolist(), strict=True)
        assert set(some) <= there
        assert drawn.log_count[0, path].exp().sum() == pytest.approx(len(there), rel=1e-5)
    assert drawn.along_m[0, 0].mean() == pytest.approx(70.0, abs=15.0)


@pytest.fixture(scope="module")
def batch():
    return as_batch(features(view(), "av", DENSE)[0])


def network(seed=0, *, conditional=False):
    torch.manual_seed(seed)
    return DenseTNT(DENSE, conditional=conditional).eval()


def test_completed_goals_end_where_they_lie(batch):
    net = network()
    with torch.no_grad():
        goals = net(batch)
    (found,) = goals.sets()
    likely = np.argsort(-found.logits[0].ravel())[:50]
    position, _ = decode.complete(found, likely[None])
    assert position.shape == (1, 50, FUTURE_STEPS, 2)
    assert np.abs(position[0, :, -1] - found.ends()[0, likely]).max() < 1e-3
    assert np.abs(found.knots[0, ..., -1, 0]).max() == 0.0


def test_completed_goals_end_where_they_lie_whatever_the_residuals(batch):
    net = network()
    torch.nn.init.normal_(net.complete.weight, std=0.5)
    with torch.no_grad():
        (found,) = net(batch).sets()
    every = np.flatnonzero(np.isfinite(found.logits[0].ravel()))
    position, _ = decode.complete(found, every[None])
    assert np.abs(position[0, :, -1] - found.ends()[0, every]).max() < 1e-3


def test_other_vehicles_of_a_batch_do_not_matter(batch):
    net = network()
    fast = {name: values.clone() for name, values in batch.items()}
    fast["motion"][:, 0] = 25.0
    with torch.no_grad():
        (alone,) = net(batch).sets()
        beside, _ = net({name: torch.cat([batch[name], fast[name]]) for name in batch}).sets()
    assert (alone.block, alone.logits.shape) == (beside.block, beside.logits.shape)
    assert np.allclose(alone.logits, beside.logits, atol=1e-5)


def test_modes_are_spread_over_blocks_of_goals(batch):
    predictors = torch_networks.random(DENSE, 0)
    prediction = predictors.marginal.predict(view(), "av")
    modes = prediction.modes(32)
    ends = modes.futures.position_m[:, -1]
    apart = np.hypot(*(ends[:, None] - ends).T) + 99.0 * np.eye(32)
    assert modes.probability.sum() == pytest.approx(1.0)
    assert apart.min() > 1.5
    assert predictors.conditional.marginal is None  # its goals lie on other paths


def test_a_heat_map_is_the_likeliest_goals():
    predictors = torch_networks.random(DENSE, 0)
    heat = predictors.marginal.predict(view(), "av").heat()
    assert heat is not None
    assert 0.95 <= heat.probability.sum() < 0.96
    assert (np.diff(heat.probability) <= 0.0).all()


def test_the_loss_agrees_with_all_goals(batch):
    """Drawn goals estimate what all goals give; a path of its own is the hand calculation."""
    net = network()
    future = torch.zeros(1, FUTURE_STEPS, 2)
    future[0, :, 0] = torch.arange(1, FUTURE_STEPS + 1) * 0.05
    known = {**batch, "future": future, "future_valid": torch.ones(1, FUTURE_STEPS)}
    with torch.no_grad():
        paths, exists = batch["paths"], batch["path_info"][..., 0] > 0
        cut = trimmed(known)
        paths, exists = cut["paths"], cut["path_info"][..., 0] > 0
        grid = anchors.every(paths, exists, batch["motion"][:, 0])
        goals = net(batch, None, grid)
        true, path = anchors.nearest(paths, grid, future[:, -1])
        slot = (grid.along_m[0, path] == true.along_m[0, path]) & (
            grid.left_m[0, path] == true.left_m[0, path]
        )
        knots = list(KNOT_STEPS)
        density = net.log_density(goals, future[:, None, knots], torch.ones(1, 1, 5))
        exact = -float(density[0, 0, path][slot])
        drawn = [
            float(trajectory.dense_loss(net, known, None, torch.Generator().manual_seed(seed)))
            for seed in range(20)
        ]
    assert np.mean(drawn) == pytest.approx(exact, abs=0.1)


def test_training_learns_where_a_vehicle_goes(batch):
    net = network(1)
    future = torch.zeros(1, FUTURE_STEPS, 2)
    future[0, :, 0] = torch.arange(1, FUTURE_STEPS + 1) * 1.0
    known = {**batch, "future": future, "future_valid": torch.ones(1, FUTURE_STEPS)}

    def near() -> float:
        with torch.no_grad():
            (found,) = net.eval()(batch).sets()
        off = np.hypot(*(found.ends()[0] - future[0, -1].numpy()).T)
        return float(np.exp(decode.log_softmax(found.logits[0].ravel()))[off < 15.0].sum())

    before = near()
    optimiser = torch.optim.AdamW(net.train().parameters(), 3e-3)
    for step in range(40):
        loss = trajectory.dense_loss(net, known, None, torch.Generator().manual_seed(step)).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    assert near() > 3.0 * before


def test_partly_known_motion_counts_all_goals_that_fit(batch):
    net = network()
    future = torch.zeros(1, FUTURE_STEPS, 2)
    future[0, :, 0] = torch.arange(1, FUTURE_STEPS + 1) * 0.5
    valid = torch.ones(1, FUTURE_STEPS)
    valid[:, 45:] = 0.0
    known = {**batch, "future": future * valid[..., None], "future_valid": valid}
    loss = trajectory.dense_loss(net, known, None, torch.Generator().manual_seed(0))
    assert torch.isfinite(loss).all()
    loss.sum().backward()
    assert all(torch.isfinite(one.grad).all() for one in net.parameters() if one.grad is not None)


def test_dense_networks_have_no_graphs():
    with pytest.raises(WeightsError, match="no ONNX graphs"):
        list(onnx_graphs._graphs(network()))
