"""A damaged set of weights is refused with one sentence that names the file."""

import json
import os
import random
import shutil
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

import deepmf_sumo
from deepmf_sumo.deepmf.networks import weights
from deepmf_sumo.errors import WeightsError

OPEN = Path(deepmf_sumo.__file__).parent / "weights" / "open"


@pytest.fixture
def folder(tmp_path):
    return Path(shutil.copytree(OPEN, tmp_path / "set"))


@pytest.mark.parametrize("temperature", [None, "warm", 0.0, -1.0, float("nan")])
def test_a_temperature_that_is_none(folder, temperature):
    file = folder / "marginal.json"
    card = json.loads(file.read_text())
    card["temperature"] = temperature
    file.write_text(json.dumps(card))
    with pytest.raises(WeightsError, match=r"marginal\.json"):
        weights.load(folder)


def test_a_card_that_is_a_list(folder):
    (folder / "opponent.json").write_text("[1, 2]")
    with pytest.raises(WeightsError, match=r"opponent\.json"):
        weights.load(folder)


def test_tensors_that_are_not_finite(folder):
    file = folder / "conditional.safetensors"
    tensors = load_file(file)
    name = next(name for name, value in tensors.items() if value.is_floating_point())
    tensors[name] = torch.full_like(tensors[name], float("nan"))
    save_file(tensors, file)
    changed(folder, "conditional", **{weights.DIGEST: weights.digest_of(file.read_bytes())})
    with pytest.raises(WeightsError, match=r"conditional\.safetensors has numbers"):
        weights.load(folder)


def changed(folder, network="marginal", **values):
    file = folder / f"{network}.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | values))
    return folder


def flip(file, rng):
    content = bytearray(file.read_bytes())
    content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    file.write_bytes(content)


@pytest.mark.slow_unit
@pytest.mark.parametrize("network", ["opponent", "marginal", "conditional"])
def test_one_flipped_bit_is_refused(folder, network):
    file = folder / f"{network}.safetensors"
    whole, rng = file.read_bytes(), random.Random(1)
    for _ in range(20):
        flip(file, rng)
        with pytest.raises(
            WeightsError, match=rf"{network}\.safetensors is damaged, or of another training"
        ):
            weights.load(folder)
        file.write_bytes(whole)
    weights.load(folder)


def test_the_cards_of_the_package_have_digests():
    assert weights.unchecked(OPEN) == []


def test_cards_of_earlier_versions_are_loaded_and_counted(folder, capsys):
    weights.load(folder)
    assert capsys.readouterr().err == ""
    for network in ("opponent", "strive"):
        file = folder / f"{network}.json"
        card = json.loads(file.read_text())
        del card[weights.DIGEST]
        file.write_text(json.dumps(card))
    weights.load(folder)
    assert "2 cards without a digest of the tensors" in capsys.readouterr().err


@pytest.mark.parametrize(
    "sizes",
    [
        {"hidden": 10**7}, {"profiles": 10**7}, {"dropout": 1e7}, {"dropout": float("nan")},
        {"hidden": True}, {"raster_pixels": 2**31}, {"vgg_widths": [1, 1, 1, 1, 10**9]},
        {"raster_frames": [0] * 10**5}, {"condition_channels": 10**8}, {"heads": 10**400},
        {"hidden": 0}, {"condition_stage": 9}, {"raster_m": 1e300},
    ],
    ids=str,
)  # fmt: skip
def test_sizes_without_bounds_are_refused(folder, sizes):
    card = json.loads((folder / "marginal.json").read_text())
    changed(folder, sizes=card["sizes"] | sizes)
    with pytest.raises(WeightsError, match=r"marginal\.json: The size '"):
        weights.load(folder)


@pytest.mark.parametrize("value", [10**400, 1e7, float("nan"), float("inf"), "1", None, [1.0]])
@pytest.mark.parametrize("key", ["temperature", "offset"])
def test_numbers_of_a_card_without_bounds_are_refused(folder, key, value):
    changed(folder, "opponent", **{key: value})
    with pytest.raises(WeightsError, match=rf"opponent\.json has {key}"):
        weights.load(folder)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"[" * 200_000, "nested too deeply"),
        (b" " * (2**20 + 1), "it holds more than"),
        (b'{"format_version": ' + b"9" * 9999 + b"}", "is not a card"),
        (b"\xff", "is not a card"),
    ],
)
def test_a_card_that_is_none(folder, content, why):
    (folder / "marginal.json").write_bytes(content)
    with pytest.raises(WeightsError, match=rf"marginal\.json .*{why}"):
        weights.load(folder)


@pytest.mark.parametrize("name", ["marginal.json", "marginal.safetensors"])
def test_devices_and_pipes_in_place_of_files(folder, name):
    (folder / name).unlink()
    (folder / name).symlink_to("/dev/zero")
    with pytest.raises(WeightsError, match="it is a device"):
        weights.load(folder)
    (folder / name).unlink()
    os.mkfifo(folder / name)
    with pytest.raises(WeightsError, match="it is a pipe"):
        weights.load(folder)


@pytest.mark.parametrize("name", ["x" * 5000, "a\0b", "half \ud800"])
def test_names_that_no_folder_can_have(name):
    with pytest.raises(WeightsError, match="There are no weights") as caught:
        weights.find(name)
    assert len(str(caught.value)) < 1000


def test_more_members_than_anybody_trains(folder):
    changed(folder, members=[{"training_digest": "x"}] * 65)
    with pytest.raises(WeightsError, match="a list of 1 to 64 trained networks"):
        weights.load(folder)
