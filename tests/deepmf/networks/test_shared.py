"""Weights are read once a process, and again where they have changed."""

import os

import pytest

from deepmf_sumo.deepmf.networks import weights
from deepmf_sumo.errors import WeightsError


def test_one_copy_until_a_file_changes(tmp_path, monkeypatch):
    loaded = []
    monkeypatch.setattr(weights, "load", lambda folder, _: loaded.append(folder) or object())
    file = tmp_path / "marginal.safetensors"
    file.write_bytes(b"")
    first = weights.cached_predictors(tmp_path)
    assert weights.cached_predictors(str(tmp_path)) is first
    os.utime(file, ns=(1, 1))
    assert weights.cached_predictors(tmp_path) is not first
    assert loaded == [tmp_path.resolve()] * 2


def test_missing_weights_are_named():
    with pytest.raises(WeightsError, match="no weights 'nowhere'"):
        weights.cached_predictors("nowhere")
