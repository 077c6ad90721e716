"""Augmented samples stay true."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.deepmf.networks.vgg import repack, unpack
from deepmf_sumo.training.networks import trajectory
from deepmf_sumo.training.samples.trajectory import trajectory_samples

from tests.support.synthetic import rotated, scene

FLIP = np.array([[1.0, 0.0], [0.0, -1.0]])


def flipped(given):
    """The scene with left and right exchanged."""
    tracks = given.tracks
    return replace(
        given,
        tracks=replace(
            tracks,
            position_m=tracks.position_m @ FLIP,
            heading_rad=-tracks.heading_rad,
            velocity_mps=tracks.velocity_mps @ FLIP,
        ),
        road=rotated(given.road, FLIP),
    )


def first_batch(given):
    sample = next(trajectory_samples(given, LIGHT))
    return {name: torch.from_numpy(np.asarray(values)[None]) for name, values in sample.items()}


@pytest.fixture(scope="module")
def batch():
    return first_batch(scene(shift=1.3))


def test_a_mirrored_sample_is_the_sample_of_the_mirrored_scene(batch):
    found = trajectory.mirrored(batch, torch.tensor([True]), LIGHT)
    wanted = first_batch(flipped(scene(shift=1.3)))
    for name in ("agents", "agent_info", "lanes", "motion", "future", "partner"):
        assert found[name].numpy() == pytest.approx(wanted[name].numpy(), abs=1e-4), name
    ends = (each["paths"][0, :, -1].numpy() for each in (found, wanted))
    first, second = (points[np.lexsort(points.round(1).T)] for points in ends)
    assert first == pytest.approx(second, abs=0.1)


def test_mirroring_twice_changes_nothing(batch):
    rows = torch.tensor([True])
    twice = trajectory.mirrored(trajectory.mirrored(batch, rows, LIGHT), rows, LIGHT)
    assert all(torch.equal(twice[name], batch[name]) for name in batch)


def test_rows_that_are_not_named_stay(batch):
    same = trajectory.mirrored(batch, torch.tensor([False]), LIGHT)
    assert all(torch.equal(same[name], batch[name]) for name in batch)


def test_an_image_survives_packing(batch):
    image = unpack(batch["raster"], LIGHT)
    assert torch.equal(repack(image), batch["raster"])
    assert image.sum() > 0


def test_the_target_and_what_it_will_do_are_kept(batch):
    many = {name: values.repeat(64, *[1] * (values.ndim - 1)) for name, values in batch.items()}
    found = trajectory._noisy(
        trajectory._dropped(dict(many), torch.Generator().manual_seed(0)),
        torch.Generator().manual_seed(1),
    )
    for name in ("future", "partner", "paths", "path_info", "motion"):
        assert torch.equal(found[name], many[name])
    assert torch.equal(found["agents"][:, 0], many["agents"][:, 0])
    there = many["agent_info"][:, 1:, 7] > 0
    share = float((found["agent_info"][:, 1:, 7][there] == 0).float().mean())
    assert 0.03 < share < 0.2
    moved = (found["agents"] - many["agents"])[:, 1:, :, :2][found["agents"][:, 1:, :, 6] > 0]
    assert 0.01 < float(moved.std()) < 0.06


def test_the_same_generator_gives_the_same_batch(batch):
    one, other = (
        trajectory.augmented(batch, LIGHT, torch.Generator().manual_seed(5)) for _ in range(2)
    )
    assert all(torch.equal(one[name], other[name]) for name in batch)
