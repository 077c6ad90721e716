"""``train marginal --set members=N``, and a set whose second member is missing."""

import json
import shutil
from pathlib import Path

import pytest

from deepmf_sumo.cli import main
from deepmf_sumo.deepmf.networks import weights
from deepmf_sumo.scene.readers import npz
from deepmf_sumo.training import command, run

from tests.support.synthetic import scene


@pytest.fixture
def trained(monkeypatch, tmp_path, capsys):
    """Members and seeds that ``train`` asks for, without training."""
    asked = []
    monkeypatch.setattr(
        command, "train_members", lambda training, _: asked.append((training.members, "all"))
    )
    monkeypatch.setattr(run, "train", lambda network, training, *_: asked.append((0, network)))
    npz.write(scene(), tmp_path / "one.npz")

    def train(*arguments):
        asked.clear()
        fixed = ["--data", str(tmp_path), "--out", str(tmp_path / "set")]
        code = main.run(["train", *map(str, arguments), *fixed])
        return code, list(asked), capsys.readouterr().err

    return train


def test_the_marginal_network_alone_has_members(trained):
    assert trained("marginal") == (0, [(1, "all")], "")
    assert trained("marginal", "--set", "members=3") == (0, [(3, "all")], "")
    code, asked, error = trained("opponent", "--set", "members=3")
    assert (code, asked) == (2, [])
    assert "members applies to the marginal network; the opponent network has one" in error
    assert trained("all", "--set", "members=1")[1] == [
        (0, "opponent"),
        (1, "all"),
        (0, "conditional"),
    ]


@pytest.mark.parametrize("value", ["0", "9", "two"])
def test_a_number_of_members_that_is_none(trained, value):
    code, asked, error = trained("marginal", "--set", f"members={value}")
    assert code == 2
    assert not asked
    assert "key 'members'" in error


def test_a_missing_member_is_one_sentence(tmp_path, capsys):
    folder = Path(shutil.copytree(weights.find("open"), tmp_path / "mine"))
    card = json.loads((folder / "marginal.json").read_text())
    card["members"] = [{"name": "marginal"}, {"name": "marginal-2"}]
    (folder / "marginal.json").write_text(json.dumps(card))
    (folder / "marginal-2.json").unlink(missing_ok=True)
    npz.write(scene(), tmp_path / "one.npz")
    code = main.run(["evaluate", str(tmp_path / "one.npz"), "--weights", str(folder)])
    error = capsys.readouterr().err
    assert code == 2
    assert error.count("\n") == 1
    assert "marginal-2.json is missing; make it with `deepmf-sumo train marginal --set mem" in error
