"""Networks as ONNX graphs: what torch computes, without torch."""

import json
import os
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepmf_sumo.cli import main
from deepmf_sumo.deepmf.networks import torch_networks, weights
from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.errors import WeightsError
from deepmf_sumo.training import cards

from tests.support.synthetic import scene, view

ROOT = Path(__file__).resolve().parents[3]
SMALL = replace(LIGHT, name="small", hidden=16, vgg_widths=(4, 4, 4, 4, 4), profiles=7)
pytest.importorskip("onnxruntime", reason="onnxruntime, an extra, is not installed")


def both(name):
    return weights.load(name, "torch"), weights.load(name, "onnx")


def southern(shifts):
    """The partner's future, shifted along by some metres."""
    tracks = scene().tracks
    row = tracks.row("south")
    position = tracks.position_m[row, 11:91] + np.array(shifts)[:, None, None] * [0.0, 1.0]
    heading = np.repeat(tracks.heading_rad[row, 11:91][None], len(shifts), 0)
    from deepmf_sumo.scene import Futures

    return Futures(agent_id="south", position_m=position, heading_rad=heading)


def same(one, other):
    assert other.futures.position_m == pytest.approx(one.futures.position_m, abs=1e-3)
    assert other.futures.heading_rad == pytest.approx(one.futures.heading_rad, abs=1e-3)
    assert other.probability == pytest.approx(one.probability, abs=1e-4)


def compare(torch_made, onnx_made):
    now = view()
    scores, again = (each.opponent.score(now) for each in (torch_made, onnx_made))
    assert again.ids == scores.ids
    assert again.logits == pytest.approx(scores.logits, abs=1e-4)
    assert again.partner_logits == pytest.approx(scores.partner_logits, abs=1e-4)
    one, other = (each.marginal.predict(now, "south") for each in (torch_made, onnx_made))
    modes = one.modes(16)
    same(modes, other.modes(16))
    ahead = modes.futures.position_m
    assert other.log_density(ahead) == pytest.approx(one.log_density(ahead), abs=1e-3)
    for planner in (False, True):
        for given in (None, southern([0.0]), southern([0.0, -25.0, 8.0])):
            found = [
                each.conditional.predict(now, "av", planner=planner).given(given, 6)
                for each in (torch_made, onnx_made)
            ]
            for first, second in zip(*found, strict=True):
                same(first, second)


def test_graphs_of_the_packaged_set_compute_what_torch_computes():
    compare(*both("open"))


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A set of small networks with images and two members, and its graphs."""
    pytest.importorskip("onnxscript", reason="onnxscript, an extra, is not installed")
    folder, made = tmp_path_factory.mktemp("sets") / "mine", torch_networks.random(SMALL, 1)
    second = torch_networks.random(SMALL, 2).marginal.net
    for net in (made.marginal.net, second, made.conditional.net):
        net.score.weight.data *= 20.0
    card = {"sizes": SMALL.record(), "temperature": 1.3, "partner_temperature": 1.1}
    cards.write(folder, "marginal-2", second, card | {"training_digest": "b"})
    for network in weights.NETWORKS:
        cards.write(folder, network, getattr(made, network).net, card)
    listed = [{"name": "marginal"}, {"name": "marginal-2", "training_digest": "b"}]
    read = weights.read_card(folder, "marginal")
    cards.write_card(folder, "marginal", read | {"members": listed})
    assert main.run(["train", "onnx", "--out", str(folder)]) == 0
    return folder


@pytest.mark.slow
def test_graphs_with_images_and_members_compute_what_torch_computes(small, tmp_path):
    compare(*both(small))
    graph = small / "marginal-2.decode.onnx"
    kept = graph.read_bytes()
    for content, what in (
        (None, r"marginal-2\.decode\.onnx is missing; where torch is installed, write it with"),
        (kept[:100], r"marginal-2\.decode\.onnx is damaged"),
        ((small / "marginal.decode.onnx").read_bytes(), "was made of other tensors than marginal-"),
    ):
        graph.unlink() if content is None else graph.write_bytes(content)
        with pytest.raises(WeightsError, match=what):
            weights.load(small, "onnx")
    graph.write_bytes(kept)
    weights.load(small, "onnx")


@pytest.mark.sumo  # it starts a process
@pytest.mark.skipif(sys.platform != "linux", reason="threads are counted in /proc")
def test_a_process_with_the_graphs_has_one_thread_so_that_workers_can_be_copied():
    code = (
        "from pathlib import Path; from deepmf_sumo.deepmf.networks import weights;"
        "weights.load('open', 'onnx'); print(sum(1 for _ in Path('/proc/self/task').iterdir()))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=100,
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.stdout.strip() == "1"


def test_a_set_without_graphs_says_how_to_write_them(tmp_path):
    made = torch_networks.random(SMALL, 1)
    card = {"sizes": SMALL.record(), "temperature": 1.3, "partner_temperature": 1.1}
    for network in weights.NETWORKS:
        cards.write(tmp_path / "mine", network, getattr(made, network).net, card)
    with pytest.raises(WeightsError, match=r"`deepmf-sumo train onnx --name mine`\.$"):
        weights.load(tmp_path / "mine", "onnx")


def test_a_runtime_that_does_not_exist_is_named(monkeypatch):
    monkeypatch.setenv(weights.RUNTIME, "tensorflow")
    with pytest.raises(WeightsError, match="is 'tensorflow'; set it to torch or onnx"):
        weights.load("open")


def test_training_options_beside_onnx_are_refused(capsys):
    assert main.run(["train", "onnx", "--name", "open", "--set", "steps=5"]) == 2
    assert "--set is for training; onnx takes --name and --out." in capsys.readouterr().err


@pytest.mark.sumo
def test_without_torch_an_attack_hits_as_with_it(tmp_path):
    """A sweep in a process that cannot import torch or safetensors, and one in this process."""
    blocked = tmp_path / "blocked"
    for package in ("torch", "safetensors"):
        (blocked / package).mkdir(parents=True)
        (blocked / package / "__init__.py").write_text("raise ModuleNotFoundError('blocked')")
    spec = [str(ROOT / "scenarios" / "left_turn_across_path.yaml"), "--no-pictures", "--out"]
    done = subprocess.run(
        [sys.executable, "-m", "deepmf_sumo.cli.main", "run", *spec, str(tmp_path / "onnx")],
        check=False, capture_output=True, text=True, timeout=250,
        env={**os.environ, "PYTHONPATH": f"{blocked}:{ROOT}", weights.RUNTIME: "onnx"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert main.run(["run", *spec, str(tmp_path / "torch")]) == 0
    one, other = (
        json.loads(next((tmp_path / name / "runs").glob("*/result.json")).read_text())
        for name in ("torch", "onnx")
    )
    assert one["outcome"] == other["outcome"] == "av_opponent"
    manifest = json.loads((tmp_path / "onnx" / "manifest.json").read_text())
    assert (manifest["networks"], manifest["packages"]["torch"] is None) == ("onnx", False)


def test_the_light_installation_lays_out_the_same_starter():
    included = [
        tomllib.loads((ROOT / folder / "pyproject.toml").read_text())["tool"]["hatch"]["build"][
            "targets"
        ]["wheel"]["force-include"]
        for folder in (".", "light")
    ]
    assert {f"../{path}": place for path, place in included[0].items()} == {
        path: place for path, place in included[1].items() if path != "../deepmf_sumo"
    }


def test_the_light_installation_asks_for_the_same_packages_without_torch():
    whole, light = (
        tomllib.loads((ROOT / folder / "pyproject.toml").read_text())["project"]
        for folder in (".", "light")
    )
    added, left_out = ["onnxruntime>=1.20"], ("safetensors", "torch")
    kept = [one for one in whole["dependencies"] if not one.startswith(left_out)]
    assert sorted(light["dependencies"]) == sorted(kept + added)
    extras = whole["optional-dependencies"]
    for name, packages in light["optional-dependencies"].items():
        assert packages == extras[name]
    assert set(extras) - set(light["optional-dependencies"]) == {"train", "onnx", "metadrive"}
    assert light["scripts"] == whole["scripts"]
