import json
import math

import pytest

from deepmf_sumo.deepmf.networks import torch_networks, weights
from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.errors import WeightsError
from deepmf_sumo.training import cards

from tests.support.synthetic import view


@pytest.fixture
def folder(tmp_path):
    made = torch_networks.random(LIGHT, 1)
    for network in weights.NETWORKS:
        net = getattr(made, network).net
        card = {
            "sizes": LIGHT.record(),
            "preset": "light",
            "temperature": 1.3,
            "partner_temperature": 1.1,
        }
        cards.write(tmp_path / "mine", network, net, card)
    return tmp_path / "mine"


def test_what_is_written_is_loaded(folder):
    found = weights.load(folder)
    made = torch_networks.random(LIGHT, 1)
    ends = view().history.position_m[:, -1]
    one, other = (
        each.marginal.predict(view(), "av").end_density(ends, 2.0) for each in (found, made)
    )
    assert one == pytest.approx(other, rel=1e-3)
    assert (folder / "conditional.safetensors").stat().st_size < 1_000_000
    assert found.marginal.temperature == 1.3
    assert "## conditional" in (folder / "card.md").read_text(encoding="utf-8")


DAMAGES = {
    "opponent.safetensors": None,
    "conditional.json": None,
    "marginal.safetensors": b"short",
    "opponent.json": b"{",
    "marginal.json": b'{"format_version": 99}',
    "conditional.safetensors": b"of another training",
}


@pytest.mark.parametrize("file", DAMAGES)
def test_the_check_without_torch_says_what_loading_says(folder, file):
    weights.check(folder)
    if DAMAGES[file] is None:
        (folder / file).unlink()
    else:
        (folder / file).write_bytes(DAMAGES[file])
    said = []
    for read in (weights.check, weights.load):
        with pytest.raises(WeightsError) as error:
            read(folder)
        said.append(str(error.value))
    assert said[0] == said[1]


def test_a_name_is_found_in_the_home(folder, monkeypatch):
    monkeypatch.setenv("DEEPMF_SUMO_HOME", str(folder.parent.parent))
    folder.parent.rename(folder.parent.parent / "weights")
    try:
        assert weights.find("mine").name == "mine"
    finally:
        (folder.parent.parent / "weights").rename(folder.parent)


def test_unknown_name_lists_the_places(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(WeightsError, match=r"no weights 'nothing'.*train all"):
        weights.load("nothing")


@pytest.mark.parametrize("network", weights.NETWORKS)
@pytest.mark.parametrize("suffix", ["safetensors", "json"])
def test_a_missing_file_is_named(folder, network, suffix):
    (folder / f"{network}.{suffix}").unlink()
    with pytest.raises(WeightsError, match=rf"{network}\.{suffix} is missing; make it with"):
        weights.load(folder)


def test_a_damaged_file_is_named(folder):
    file = folder / "marginal.safetensors"
    file.write_bytes(file.read_bytes()[:5000])
    with pytest.raises(WeightsError, match=r"marginal\.safetensors is damaged"):
        weights.load(folder)


def test_tensors_of_another_network_are_refused(folder):
    content = (folder / "opponent.safetensors").read_bytes()
    (folder / "marginal.safetensors").write_bytes(content)
    with pytest.raises(WeightsError, match="of another training than its card"):
        weights.load(folder)
    card = json.loads((folder / "marginal.json").read_text())
    card[weights.DIGEST] = weights.digest_of(content)
    (folder / "marginal.json").write_text(json.dumps(card))
    with pytest.raises(WeightsError, match="does not fit the marginal network"):
        weights.load(folder)


def test_an_offset_that_is_no_number_is_named(folder):
    card = json.loads((folder / "opponent.json").read_text(encoding="utf-8"))
    for offset in (-1.5, math.inf):
        text = json.dumps({**card, "offset": offset})
        (folder / "opponent.json").write_text(text, encoding="utf-8")
        if offset == -1.5:
            assert weights.load(folder).opponent.offset == -1.5
    with pytest.raises(WeightsError, match=r"opponent\.json has offset inf; it must be a number"):
        weights.load(folder)


def test_a_card_that_is_no_json_is_named(folder):
    (folder / "opponent.json").write_text("{", encoding="utf-8")
    with pytest.raises(WeightsError, match=r"opponent\.json is not a card"):
        weights.load(folder)


def test_a_card_of_another_version_is_refused(folder):
    (folder / "opponent.json").write_text('{"format_version": 99}', encoding="utf-8")
    with pytest.raises(WeightsError, match="format_version 99, not 1"):
        weights.load(folder)
