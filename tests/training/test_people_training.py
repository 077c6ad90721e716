"""Training and evaluation of the predictor of people."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from deepmf_sumo.deepmf.networks import weights
from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.deepmf.networks.decode import KNOT_STEPS
from deepmf_sumo.deepmf.networks.people import People, untrained
from deepmf_sumo.deepmf.networks.people_net import MOTIONS
from deepmf_sumo.scene import ROLLOUT, readers
from deepmf_sumo.training import run
from deepmf_sumo.training.config import Optimisation
from deepmf_sumo.training.evaluation.recordings import PeopleFigures, densities
from deepmf_sumo.training.evaluation.table import Key
from deepmf_sumo.training.networks.people import PeopleLayers, loss_of, mirrored
from deepmf_sumo.training.samples import windows
from deepmf_sumo.training.samples.feature_cache import Data
from deepmf_sumo.training.samples.people import people_samples

from tests.support.synthetic import scene, view

KNOTS = list(KNOT_STEPS)


def batch_of(samples):
    return {name: torch.from_numpy(np.stack([one[name] for one in samples])) for name in samples[0]}


def test_samples_of_a_scene():
    samples = list(people_samples(scene()))
    assert len(samples) == 6  # one walker, at each window
    assert [int(one["future_valid"].sum()) for one in samples] == [5, 4, 4, 3, 3, 2]
    assert all(one["motion"].shape[0] == MOTIONS for one in samples)
    assert samples[0]["future"][-1] == pytest.approx([10.4, 0.0], abs=1e-3)  # 1.3 m/s for 8 s


def test_an_attack_gives_no_samples():
    attacked = scene()
    assert not list(
        people_samples(replace(attacked, source=replace(attacked.source, dataset=ROLLOUT)))
    )


def test_the_loss_is_the_negative_log_density_of_the_prediction():
    """Before training, torch's mixture is that of numpy, whose density integrates to one."""
    layers = PeopleLayers().eval()
    batch = batch_of(list(people_samples(scene()))[:1])
    found = loss_of(layers)(batch, torch.Generator()).item()
    future = windows.future_of(scene(), "walker", 10)
    plain = untrained(view(), "walker")
    joint = float(plain.log_density(future.position_m[None])[0])
    each = plain.knot_log_density(future.position_m[None, KNOTS]).sum()
    assert found == pytest.approx(-(joint + each) / 10, abs=1e-3)


def test_a_mirrored_batch_has_the_same_loss_before_training_and_is_its_own_inverse():
    layers = PeopleLayers().eval()
    batch = batch_of(list(people_samples(scene())))
    every = torch.ones(len(batch["own"]), dtype=torch.bool)
    other = mirrored(batch, every)
    loss = loss_of(layers)
    assert loss(other, torch.Generator()).item() == pytest.approx(
        loss(batch, torch.Generator()).item(), abs=1e-5
    )
    back = mirrored(other, every)
    assert all(torch.equal(back[name], batch[name]) for name in batch)
    some = mirrored(batch, ~every)
    assert all(torch.equal(some[name], batch[name]) for name in batch)


@pytest.mark.slow_unit
def test_training_learns_and_is_read_back(monkeypatch, tmp_path):
    """People who all walk at 1.3 m/s straight on: their density grows, and errors fall."""
    made = [scene(shift=2.0 * n, av_speed=4.0 + n % 9, turn=0.3 * n) for n in range(20)]
    monkeypatch.setattr(readers, "scenes", lambda _: iter(made))
    file = tmp_path / "recordings.bin"
    file.write_bytes(b"x")
    training = run.Training(
        data=[Data(path=file)],
        folder=tmp_path / "set",
        cache=tmp_path / "cache",
        preset=LIGHT,
        optimisation={"people": Optimisation(steps=60, batch=32, ema=0.0)},
    )
    run.train("people", training, print)
    net = weights.people_net_of(tmp_path / "set")
    future = windows.future_of(made[3], "walker", 10)
    seen = windows.view_at(made[3], 10)
    log = [
        float(People(one).predict(seen, "walker").log_density(future.position_m[None])[0])
        for one in (None, net)
    ]
    assert log[1] > log[0] + 2.0
    card = weights.read_card(tmp_path / "set", "people")
    assert card["samples"] + 6 * 2 >= 20 * 6 - 12
    told = []
    run.train("people", training, told.append)
    assert any("complete" in line for line in told)


@pytest.mark.slow_unit
def test_as_many_outcomes_are_inside_as_the_mass_says():
    """Outcomes drawn from the prediction itself."""
    prediction = untrained(view(), "walker")
    count = 120
    drawn = prediction.drawn(count, np.random.default_rng(5))
    inside = {0.5: 0, 0.9: 0}
    for place in drawn:
        future = windows.future_of(scene(), "walker", 10)
        position = future.position_m.copy()
        position[KNOTS] = place
        found = densities(prediction, replace(future, position_m=position))
        for share in inside:
            inside[share] += found[f"inside_{100 * share:g}", 4.0]
    # three standard deviations of that many draws
    assert inside[0.5] / count == pytest.approx(0.5, abs=0.14)
    assert inside[0.9] / count == pytest.approx(0.9, abs=0.08)


def test_figures_of_a_walker_at_constant_velocity():
    made = PeopleFigures()
    made.add(People(), scene(), view())
    made.add(People(), replace(scene(), source=replace(scene().source, dataset=ROLLOUT)), view())
    found = made.counts | made.samples.figures()
    assert made.counts == {"pedestrian": 1, "moving pedestrian": 1}

    def of(quantity, seconds, modes, condition="network"):
        return found[Key("people", quantity, seconds, modes, condition, "pedestrian")].value

    assert of("min_fde", 8.0, 1, "constant_velocity") == pytest.approx(0.0, abs=1e-3)
    assert of("min_fde", 8.0, 6) < 0.5
    assert of("min_fde_of_horizon", 3.0, 6) < 0.3
    assert of("inside_90", 8.0, None) == 1.0
    plain = untrained(view(), "walker")
    future = windows.future_of(scene(), "walker", 10)
    each = plain.knot_log_density(future.position_m[None, KNOTS])[0]
    assert of("negative_log_density", 2.0, None) == pytest.approx(-each[1], abs=1e-3)


def test_who_comes_closest_to_the_av():
    """The walker crosses the AV's lane; nobody does where it stands 40 m beside it."""
    assert windows.nearest_person(scene(), "av", 10, 15.0).agent_id == "walker"
    away = scene()
    position = away.tracks.position_m.copy()
    position[away.tracks.row("walker")] = [14.0, -60.0]
    away = replace(away, tracks=replace(away.tracks, position_m=position))
    assert windows.nearest_person(away, "av", 10, 15.0) is None
