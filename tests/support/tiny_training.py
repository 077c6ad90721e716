"""A regression that trains in milliseconds: what the loop does with any network."""

import numpy as np
import torch
from torch import nn

from deepmf_sumo.training.samples.dataset import SampleSource, mix
from deepmf_sumo.training.samples.places import SceneArea


def source(name, count, *, weight=None, slope=1.0, scenes=20):
    """Samples x -> slope * x, in scenes of equal size."""
    x = np.random.default_rng(len(name) + count).normal(size=(count, 3)).astype(np.float32)
    return SampleSource(
        name=name,
        arrays={"x": x, "y": slope * x.sum(1)},
        scene=np.arange(count) * scenes // count,
        scenes=[f"{name}-{number}" for number in range(scenes)],
        areas=[SceneArea("", ((0, 0),))] * scenes,
        refused={},
        digest=name,
        weight=weight,
    )


def cache(*sources):
    return mix(sources or [source("one", 200)])


def net():
    """With running statistics and dropout, as the networks have."""
    torch.manual_seed(0)
    return nn.Sequential(
        nn.Linear(3, 8), nn.BatchNorm1d(8), nn.ReLU(), nn.Dropout(0.2), nn.Linear(8, 1)
    )


def loss_of(net):
    """Squared error with noise drawn from the generator."""

    def loss(batch, generator):
        noise = torch.randn(len(batch["x"]), 3, generator=generator)
        return ((net(batch["x"] + 0.01 * noise)[:, 0] - batch["y"]) ** 2).mean()

    return loss
