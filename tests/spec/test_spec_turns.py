"""Opponents in turn: what a spec may say of them."""

import pytest
import yaml

from deepmf_sumo import spec
from deepmf_sumo.errors import SpecError

from tests.support import tiny_network


@pytest.fixture
def write(tmp_path):
    (tmp_path / "tiny.sumocfg").write_text("<configuration/>")
    (tmp_path / "val").mkdir()
    return lambda **keys: tiny_network.spec(tmp_path, "several", **keys)


def test_one_opponent_is_the_default_and_not_written(write):
    loaded = spec.load(write())
    assert loaded.opponents == "one"
    assert not {"opponents", "turns"} & set(loaded.resolved())


def test_turns_are_kept_in_what_repeats_the_run(write, tmp_path):
    keys = {"opponents": "in_turn", "turns": "{longest_s: 8.0}"}
    loaded = spec.load(write(**keys))
    assert (loaded.turns.longest_s, loaded.turns.again_after_s) == (8.0, 30.0)
    again = tmp_path / "again.yaml"
    again.write_text(yaml.safe_dump(loaded.resolved()))
    assert spec.load(again) == loaded


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"opponents": "several"}, "'opponents': 'several'"),
        ({"turns": "{longest: 8.0}"}, "Did you mean 'longest_s'"),
        ({"turns": "{longest_s: 1.0}"}, "turns.longest_s"),
        ({"opponents": "in_turn", "adversary": "bbo"}, "bbo looks for one attack"),
        (
            {"opponents": "in_turn", "adversary": "{name: deepmf, opponent: bus_3}"},
            "adversary.opponent is 'bus_3'",
        ),
        (
            {"opponents": "in_turn", "source": "{recording: val}"},
            "a recording is too short for several opponents",
        ),
    ],
)
def test_wrong_specs_are_refused_in_one_line(write, keys, message):
    with pytest.raises(SpecError) as refused:
        spec.load(write(**keys))
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)
