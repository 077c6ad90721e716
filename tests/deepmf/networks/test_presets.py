"""Sizes of networks: read back from cards, and branches that can be left out."""

import json

import pytest
import torch

from deepmf_sumo.deepmf.networks.anchors import BRAKING
from deepmf_sumo.deepmf.networks.condition import Condition
from deepmf_sumo.deepmf.networks.config import LIGHT, PAPER, UNPAIRED, VECTOR, Preset, changed
from deepmf_sumo.deepmf.networks.densetnt import DenseTNT, as_batch
from deepmf_sumo.deepmf.networks.encode import features
from deepmf_sumo.errors import WeightsError

from tests.support.synthetic import view


@pytest.mark.parametrize("preset", [LIGHT, PAPER, VECTOR, UNPAIRED])
def test_a_card_gives_the_preset_back(preset: Preset) -> None:
    assert Preset.from_record(json.loads(json.dumps(preset.record()))) == preset


@pytest.mark.parametrize(
    ("sizes", "named"),
    [
        ({"hidden": "64"}, "hidden"),
        ({"hidden": True}, "hidden"),
        ({"raster": 1}, "raster"),
        ({"raster_signals": 5}, "raster_signals"),
        ({"vgg_widths": 3}, "vgg_widths"),
        ({"depth": 3}, "'depth' is not a size of a network"),
    ],
)
def test_sizes_that_cannot_be_are_named(sizes: dict[str, object], named: str) -> None:
    with pytest.raises(WeightsError, match=named):
        changed(LIGHT, "mine", sizes)


def test_a_card_of_an_earlier_version_has_pairs_and_mixing() -> None:
    record = LIGHT.record()
    del record["pairs"], record["mixing"]
    assert Preset.from_record(record) == LIGHT


def test_missing_sizes_are_named() -> None:
    record = LIGHT.record()
    del record["heads"]
    with pytest.raises(WeightsError, match="heads"):
        Preset.from_record(record)


@pytest.mark.parametrize("sizes", [{"raster": False}, {"vectors": False}, {"profiles": 7}])
@pytest.mark.parametrize("conditional", [False, True])
def test_networks_work_without_a_branch(sizes: dict[str, object], conditional: bool) -> None:
    batch = as_batch(features(view(), "av", LIGHT)[0])
    preset = changed(LIGHT, "ablated", sizes)
    net = DenseTNT(preset, conditional=conditional).eval()
    given = None
    if conditional:
        parts = torch.zeros(1, 3, 80, 2), torch.zeros(1, 3, 80), torch.ones(1, 3)
        given = Condition.of(*parts, preset)
    goals = net(batch, given)
    assert goals.logits.shape[1] == (3 if conditional else 1)
    assert goals.logits.shape[3] == preset.profiles + len(BRAKING) * conditional
    assert torch.isfinite(goals.logits[goals.logits > -torch.inf]).all()
    assert (net.image is None) == (not preset.raster)
    assert (net.vectors is None) == (not preset.vectors)
