"""Training several members of the marginal network."""

import json
import shutil
from dataclasses import replace

import pytest
import torch

from deepmf_sumo.deepmf.networks import torch_networks, weights
from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.errors import OutputError, RunError
from deepmf_sumo.scene import readers
from deepmf_sumo.training import cards, command, initial_weights, run
from deepmf_sumo.training.config import Optimisation
from deepmf_sumo.training.fit import checkpoints, loop
from deepmf_sumo.training.samples import trajectory
from deepmf_sumo.training.samples.feature_cache import Data

from tests.support.synthetic import scene, view

pytestmark = pytest.mark.slow_unit

SMALL = replace(LIGHT, name="small", hidden=16, vgg_widths=(4, 4, 4, 4, 4), profiles=7)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Recordings, and a cache of their features."""
    folder = tmp_path_factory.mktemp("data")
    file = folder / "recordings.bin"
    file.write_bytes(b"x")
    made = [
        scene(shift=2.0 * number - 30, av_speed=4.0 + number % 9, turn=0.3 * number)
        for number in range(20)
    ]
    training = run.Training(data=[Data(path=file)], folder=folder, cache=folder, preset=SMALL)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(readers, "scenes", lambda _: iter(made))
        patch.setattr(trajectory, "WINDOW_STEPS", (10,))
        run.open_dataset("marginal", training, print)
    return file


def training_of(data, folder):
    return run.Training(
        data=[Data(path=data)],
        folder=folder,
        cache=data.parent,
        preset=SMALL,
        optimisation={"marginal": Optimisation(steps=2, batch=4)},
        seed=5,
        members=2,
    )


@pytest.fixture(scope="module")
def made(data):
    """A set with two members, and what was said while it was trained."""
    lines, folder = [], data.parent / "made"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trajectory, "WINDOW_STEPS", (10,))
        command.train_members(training_of(data, folder), lines.append)
    return folder, lines


@pytest.fixture
def training(data, tmp_path, monkeypatch):
    """Into an empty folder."""
    monkeypatch.setattr(trajectory, "WINDOW_STEPS", (10,))
    return training_of(data, tmp_path / "set")


@pytest.fixture
def trained(training, made):
    """Into a copy of the set that it made before."""
    shutil.copytree(made[0], training.folder)
    return training


def card(training, name="marginal"):
    return json.loads((training.folder / f"{name}.json").read_text(encoding="utf-8"))


def contents(folder):
    """Bytes of the tensors, and what the cards say but for hours."""
    found = {file.name: file.read_bytes() for file in folder.glob("*.safetensors")}
    for name in ("marginal", "marginal-2"):
        values = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
        for each in (values, *values.get("members", ())):
            del each["hours"]
        found[name] = values
    return found


def test_members_differ_by_seed_and_the_first_card_lists_them(trained, made):
    first, second = card(trained), card(trained, "marginal-2")
    assert (first["seed"], second["seed"]) == (5, 6)
    assert [one["name"] for one in first["members"]] == ["marginal", "marginal-2"]
    assert [one["seed"] for one in first["members"]] == [5, 6]
    assert [one["training_digest"] for one in first["members"]] == [
        first["training_digest"], second["training_digest"],
    ]  # fmt: skip
    mixture = first["mixture"]
    assert mixture["samples"] > 0
    assert mixture["min_fde_32"] < mixture["min_fde_16"] < mixture["min_fde_6"]
    assert "marginal: 2 member(s), temperature" in made[1][-1]
    assert (trained.folder / "curves" / "marginal-2.csv").is_file()
    assert not list(trained.folder.glob("*.checkpoint*"))
    one, other = (
        torch_networks.tensors(trained.folder, name)["score.weight"]
        for name in ("marginal", "marginal-2")
    )
    assert (one - other).abs().max() > 0.01


def test_what_has_been_made_stays(trained):
    before = {file: file.stat().st_mtime_ns for file in trained.folder.glob("*.*")}
    lines = []
    command.train_members(trained, lines.append)
    assert before == {file: file.stat().st_mtime_ns for file in trained.folder.glob("*.*")}
    assert [line.split(":")[0] for line in lines] == ["marginal", "marginal-2"]


def test_a_run_interrupted_in_the_second_member_gives_the_same_bytes(training, made, monkeypatch):
    step, steps = loop._Run.step, []

    def cut(self, number, *rest):
        steps.append(number)
        if len(steps) == 4:  # the second step of the second member
            raise RunError("cut off")
        step(self, number, *rest)

    lines = []
    with monkeypatch.context() as patch:
        patch.setattr(loop._Run, "step", cut)
        with pytest.raises(RunError, match="cut off"):
            command.train_members(training, lines.append)
    assert "members" not in card(training)  # a set of one network until the second is there
    command.train_members(training, lines.append)
    assert any("resuming from step 1" in line for line in lines)
    assert any(line.startswith("marginal: this training is complete") for line in lines)
    assert contents(training.folder) == contents(made[0])


def test_fewer_members_take_the_first_ones_own_temperature(trained):
    alone = card(trained)["members"][0]["temperature"]
    command.train_members(replace(trained, members=1), print)
    assert card(trained)["temperature"] == alone
    assert "members" not in card(trained)
    assert "mixture" not in card(trained)
    lines = []
    command.train_members(trained, lines.append)  # both are there: nothing is trained
    assert not any(line.startswith("step") for line in lines)
    assert len(card(trained)["members"]) == 2


def test_other_members_need_another_temperature(trained):
    cards.add_results(trained.folder, {"data": ["val"], "marginal": {"objects": 1}})
    assert "results" in card(trained)
    listed = card(trained)["members"]
    command.train_members(replace(trained, seed=6), print)
    assert [one["seed"] for one in card(trained)["members"]] == [6, 7]
    assert card(trained)["members"] != listed
    assert "results" not in card(trained)


def test_members_begin_from_those_of_another_set(trained, tmp_path):
    names = [
        initial_weights.file_of(
            "marginal", SMALL, tmp_path / "fine", str(trained.folder), print, member
        ).stem
        for member in (1, 2, 3)
    ]
    assert names == ["marginal", "marginal-2", "marginal"]
    net = torch_networks.build("marginal", SMALL)
    initial_weights.load(net, "marginal", trained.folder / "marginal-2.safetensors")
    own = torch_networks.tensors(trained.folder, "marginal-2")["score.weight"]
    assert torch.equal(net.score.weight, own.float())


def test_a_card_that_cannot_be_written_leaves_the_members(trained, monkeypatch):
    before = {key: value for key, value in card(trained).items() if key != "members"}
    cards.write_card(trained.folder, "marginal", before)

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoints, "write", full)
    with pytest.raises(OutputError, match="No space left on device"):
        command.train_members(trained, print)
    assert card(trained) == before


def test_the_mixture_predicts(trained):
    for network in ("opponent", "conditional"):
        net = getattr(torch_networks.random(SMALL, 0), network).net
        values = {"sizes": SMALL.record(), "temperature": 1.0, "partner_temperature": 1.0}
        cards.write(trained.folder, network, net, values)
    found = weights.load(trained.folder).marginal
    assert len(found.nets) == 2
    assert found.temperature == card(trained)["temperature"]
    assert found.predict(view(), "av").modes(16).futures.position_m.shape == (16, 80, 2)
