"""A set of weights with several members of the marginal network."""

import json
from dataclasses import replace

import pytest
import torch

from deepmf_sumo.deepmf.networks import torch_networks, weights
from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.errors import WeightsError
from deepmf_sumo.training import cards

from tests.support.synthetic import view

SMALL = replace(LIGHT, name="small", hidden=16, vgg_widths=(4, 4, 4, 4, 4), profiles=7)


def member(seed, preset=SMALL):
    return torch_networks.random(preset, seed).marginal.net


@pytest.fixture
def folder(tmp_path):
    """A set with two members."""
    made, place = torch_networks.random(SMALL, 1), tmp_path / "mine"
    card = {"sizes": SMALL.record(), "temperature": 1.3, "partner_temperature": 1.1}
    cards.write(place, "marginal-2", member(2), card | {"training_digest": "b"})
    for network in weights.NETWORKS:
        cards.write(place, network, getattr(made, network).net, card)
    listed = [{"name": "marginal"}, {"name": "marginal-2", "training_digest": "b"}]
    cards.write_card(place, "marginal", card | {"members": listed})
    return place


def change(folder, name, **values):
    file = folder / f"{name}.json"
    card = json.loads(file.read_text(encoding="utf-8")) | values
    file.write_text(json.dumps(card), encoding="utf-8")


def test_all_members_are_loaded_and_listed(folder):
    found = weights.load(folder).marginal
    assert len(found.nets) == 2
    for net, seed in zip(found.nets, (1, 2), strict=True):
        assert not net.training
        assert torch.allclose(net.score.weight, member(seed).score.weight, atol=1e-3)
    assert found.predict(view(), "av").modes(32).probability.sum() == pytest.approx(1.0)
    names = ["opponent", "marginal", "marginal-2", "conditional"]
    assert weights.listed(folder) == names
    page = (folder / "card.md").read_text(encoding="utf-8")
    assert [line[3:] for line in page.splitlines() if line.startswith("## ")] == names


def test_a_card_without_a_list_is_that_of_one_network(folder):
    card = weights.read_card(folder, "marginal")
    del card["members"]
    (folder / "marginal.json").write_text(json.dumps(card), encoding="utf-8")
    assert len(weights.load(folder).marginal.nets) == 1
    assert "marginal-2" not in weights.listed(folder)


@pytest.mark.parametrize("suffix", ["safetensors", "json"])
def test_a_missing_member_is_named(folder, suffix):
    (folder / f"marginal-2.{suffix}").unlink()
    expected = (
        rf"incomplete: marginal-2\.{suffix} is missing; make it with `deepmf-sumo train marginal"
        r" --set members=2 --data RECORDINGS --name mine`\.$"
    )
    with pytest.raises(WeightsError, match=expected):
        weights.load(folder)


def test_a_damaged_member_is_named(folder):
    file = folder / "marginal-2.safetensors"
    file.write_bytes(file.read_bytes()[:3000])
    with pytest.raises(WeightsError, match=r"marginal-2\.safetensors is damaged.*--set members=2"):
        weights.load(folder)


def test_a_member_of_other_sizes_is_refused(folder):
    other = replace(SMALL, hidden=24)
    card = {"sizes": other.record(), "temperature": 1.0, "training_digest": "b"}
    cards.write(folder, "marginal-2", member(2, other), card)
    with pytest.raises(WeightsError, match=r"marginal-2\.json has other sizes than marginal\.json"):
        weights.load(folder)


def test_a_member_that_was_trained_anew_is_refused(folder):
    change(folder, "marginal-2", training_digest="c")
    with pytest.raises(WeightsError, match=r"not the member that marginal\.json lists"):
        weights.load(folder)


@pytest.mark.parametrize("listed", [[], 2, "two", [1, 2], {}])
def test_a_list_of_members_that_is_none(folder, listed):
    change(folder, "marginal", members=listed)
    with pytest.raises(WeightsError, match=r"marginal\.json has members .* must be a list"):
        weights.load(folder)


def test_a_set_is_read_again_when_its_members_change(folder):
    first = weights.cached_predictors(folder)
    assert weights.cached_predictors(folder) is first
    change(folder, "marginal", temperature=1.25)
    second = weights.cached_predictors(folder)
    assert second.marginal.temperature == 1.25
    (folder / "marginal-2.safetensors").touch()
    assert weights.cached_predictors(folder) is not second
