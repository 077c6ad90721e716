"""A damaged set of weights is refused with one sentence that names the file."""

import json
import shutil
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

import deepmf_sumo
from deepmf_sumo.errors import WeightsError
from deepmf_sumo.predictors import weights

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
    with pytest.raises(WeightsError, match="conditional"):
        weights.load(folder)
