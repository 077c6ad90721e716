import json
from dataclasses import replace

import pytest
import torch

from deepmf_sumo.deepmf.networks import torch_networks
from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.errors import WeightsError
from deepmf_sumo.training import cards, initial_weights

SMALL = replace(LIGHT, name="small", hidden=16, vgg_widths=(4, 4, 4, 4, 4))


@pytest.fixture
def folder(tmp_path):
    """A set with a marginal and a conditional network of small size."""
    made = tmp_path / "before"
    for seed, network in enumerate(("marginal", "conditional")):
        torch.manual_seed(seed)
        card = {"sizes": SMALL.record(), "preset": "small"}
        cards.write(made, network, torch_networks.build(network, SMALL), card)
    return made


def begin(network, folder, begin_from, preset=SMALL):
    lines = []
    file = initial_weights.file_of(network, preset, folder, begin_from, lines.append)
    net = torch_networks.build(network, preset)
    if file is not None:
        initial_weights.load(net, network, file)
    return net.state_dict(), file, lines


def test_a_network_begins_from_the_same_one_of_another_set(folder, tmp_path):
    for network in ("marginal", "conditional"):
        state, file, _ = begin(network, tmp_path / "new", str(folder))
        saved = torch_networks.tensors(folder, network)
        assert state.keys() == saved.keys()
        assert all(torch.equal(state[name], saved[name].to(state[name])) for name in saved)
        assert initial_weights.name_of(file, "before") == "before"


def test_the_conditional_network_begins_from_the_marginal_one_beside_it(folder):
    state, file, _ = begin("conditional", folder, None)
    shared = torch_networks.tensors(folder, "marginal")
    assert state.keys() > shared.keys()
    for name, value in shared.items():
        own = state[name][tuple(slice(size) for size in value.shape)]
        assert torch.equal(own, value.to(own))
    assert initial_weights.name_of(file, None) == "marginal"


def test_without_a_set_to_start_from_weights_are_random(tmp_path):
    _, file, _ = begin("conditional", tmp_path, None)
    assert file is None
    assert initial_weights.name_of(file, None) == ""
    assert begin("marginal", tmp_path, None)[1] is None


def test_a_marginal_network_of_other_sizes_is_not_begun_from_and_named(folder):
    _, file, lines = begin("conditional", folder, None, replace(SMALL, hidden=32))
    assert file is None
    assert "random initial weights" in lines[0]
    assert "hidden 16" in lines[0]


def test_other_sizes_are_refused(folder, tmp_path):
    with pytest.raises(WeightsError, match=r"marginal network of .*before has hidden 16, but"):
        begin("marginal", tmp_path / "new", str(folder), replace(SMALL, hidden=32))


def test_another_version_is_refused(folder, tmp_path):
    file = folder / "marginal.json"
    card = json.loads(file.read_text(encoding="utf-8"))
    file.write_text(json.dumps({**card, "format_version": 99}), encoding="utf-8")
    with pytest.raises(WeightsError, match="format_version 99"):
        begin("marginal", tmp_path / "new", str(folder))


def test_tensors_of_another_architecture_are_refused(folder, tmp_path):
    (folder / "marginal.safetensors").write_bytes((folder / "conditional.safetensors").read_bytes())
    with pytest.raises(WeightsError, match="does not fit the marginal network: it differs in"):
        begin("marginal", tmp_path / "new", str(folder))


def test_damaged_or_missing_tensors_are_refused(folder, tmp_path):
    file = folder / "marginal.safetensors"
    file.write_bytes(file.read_bytes()[:1000])
    with pytest.raises(WeightsError, match="damaged"):
        begin("marginal", tmp_path / "new", str(folder))
    file.unlink()
    with pytest.raises(WeightsError, match="missing"):
        begin("marginal", tmp_path / "new", str(folder))


def test_what_an_older_set_was_not_told_adds_nothing_at_first(folder, tmp_path):
    older = replace(SMALL, reactive=False)
    made = torch_networks.build("conditional", older)
    cards.write(folder, "conditional", made, {"sizes": older.record(), "preset": "small"})
    state, _, _ = begin("conditional", tmp_path / "new", str(folder))
    assert not state["goal_follow.weight"].any()
    assert torch.allclose(state["score.weight"], made.state_dict()["score.weight"], atol=1e-3)


def test_a_set_cannot_begin_from_itself(folder):
    with pytest.raises(WeightsError, match="is the set to be trained"):
        begin("marginal", folder, str(folder))


def test_no_such_set_is_named(tmp_path):
    with pytest.raises(WeightsError, match="There are no weights 'nothing/here'"):
        begin("marginal", tmp_path, "nothing/here")
