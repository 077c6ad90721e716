from pathlib import Path

import pytest

from deepmf_sumo.errors import SpecError, UsageError
from deepmf_sumo.training import command as training
from deepmf_sumo.training import config
from deepmf_sumo.training.config import Optimisation
from deepmf_sumo.training.samples.feature_cache import Data

ROOT = Path(__file__).resolve().parents[2]


def written(tmp_path, text):
    (tmp_path / "mine").mkdir()
    (tmp_path / "sumo").mkdir()
    file = tmp_path / "train.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def test_single_networks_stand_above_all_and_flags_above_both(tmp_path):
    file = written(
        tmp_path,
        """
version: 1
data:
  - {path: mine, weight: 3.0}
  - {path: sumo, weight: 1.0}
begin_from: open
seed: 4
rate: 1.0e-3
patience: 6
marginal: {steps: 5000, rate: 2.0e-3}
""",
    )
    found = config.load(file)
    assert found.sources() == [
        Data(path=tmp_path / "mine", weight=3.0),
        Data(path=tmp_path / "sumo", weight=1.0),
    ]
    assert found.begin_from == "open"
    flags = Optimisation(patience=2)
    marginal = flags.over(found.of("marginal")).with_defaults("marginal", began=True)
    assert marginal["steps"] == 5000
    assert marginal["rate"] == 2e-3
    assert marginal["patience"] == 2
    assert marginal["evaluate_every"] == 250
    opponent = found.of("opponent").with_defaults("opponent", began=False)
    assert (opponent["rate"], opponent["batch"], opponent["patience"]) == (1e-3, 32, 6)


def test_a_network_that_begins_from_another_learns_slowly():
    assert Optimisation().with_defaults("marginal", began=True)["rate"] == 5e-4
    assert Optimisation().with_defaults("marginal", began=False)["rate"] == 2e-3
    assert Optimisation(steps=8).with_defaults("marginal", began=False)["evaluate_every"] == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "version: 1\nstepps: 3\n",
            "train.yaml:2: key 'stepps': unknown key. Did you mean 'steps'",
        ),
        ("version: 1\nmarginal: {rate: 1e-3}\n", "train.yaml:2: key 'marginal.rate': '1e-3'"),
        ("version: 1\nema: 1.5\n", "train.yaml:2: key 'ema': 1.5"),
        ("version: 1\nprecision: fp16\n", "key 'precision': 'fp16'"),
        ("version: 1\ndata: [no]\n", "train.yaml:2: key 'data.0"),
        ("version: 1\ndata: [nowhere]\n", "no such file or folder"),
        ("version: 1\ndata:\n- {path: mine, weight: 0}\n", "train.yaml:3: key 'data.0.weight'"),
        ("version: 2\n", "train.yaml:1: key 'version': 2"),
        ("steps: 3\n", "key 'version'"),
        ("- 1\n", "train.yaml:1"),
    ],
)
def test_what_is_wrong_is_named_with_file_line_and_key(tmp_path, text, message):
    with pytest.raises(SpecError) as error:
        config.load(written(tmp_path, text))
    assert message in str(error.value)


def test_weights_are_for_all_sources_or_for_none(tmp_path):
    file = written(tmp_path, "version: 1\ndata:\n- {path: mine, weight: 1.0}\n- sumo\n")
    with pytest.raises(UsageError, match=r"train.yaml:2: key 'data': sumo has no weight"):
        config.load(file)


def test_a_source_on_the_command_line_may_have_a_weight(tmp_path):
    assert config.parsed("a/b") == Data(path=Path("a/b"))
    assert config.parsed("a/b=2.5") == Data(path=Path("a/b"), weight=2.5)
    assert config.parsed("a=b=2") == Data(path=Path("a=b"), weight=2.0)
    there = tmp_path / "x=3"
    there.mkdir()
    assert config.parsed(str(there)) == Data(path=there)


@pytest.mark.parametrize("text", ["a=", "a=heavy", "a=0", "a=-1", "a=inf", "a=nan", "=2"])
def test_a_weight_that_is_not_a_number_is_refused(text):
    with pytest.raises(UsageError, match="is not a weight; give PATH=WEIGHT"):
        config.parsed(text)


def test_members_come_from_the_flag_then_the_file_then_the_default(tmp_path, monkeypatch):
    (tmp_path / "mine").mkdir()
    file = tmp_path / "train.yaml"
    asked = []
    monkeypatch.setattr(training, "train_each", lambda _, made, *__: asked.append(made.members))
    for text, sets in (("", ()), ("members: 3\n", ()), ("members: 3\n", ("members=1",))):
        file.write_text(f"version: 1\ndata: [mine]\n{text}", encoding="utf-8")
        request = training.TrainingRequest(network="marginal", file=file, sets=sets)
        training.train_requested(request, print)
    assert asked == [config.MEMBERS, 3, 1]


@pytest.mark.parametrize("value", [0, 9, "two"])
def test_a_number_of_members_that_is_none_is_refused(tmp_path, value):
    file = written(tmp_path, f"version: 1\ndata: [mine]\nmembers: {value}\n")
    with pytest.raises(SpecError, match="members"):
        config.load(file)
