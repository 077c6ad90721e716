"""Whom the AV sees: a key of specs."""

import pytest
import yaml

from deepmf_sumo import spec
from deepmf_sumo.errors import SpecError

from tests.support import tiny_network


@pytest.fixture
def write(tmp_path):
    (tmp_path / "tiny.sumocfg").write_text("<configuration/>")
    return lambda **keys: tiny_network.spec(tmp_path, "sight", **keys)


def test_all_is_the_default_and_not_written(write):
    loaded = spec.load(write())
    assert loaded.av_sees == "all"
    assert "av_sees" not in loaded.resolved()


def test_it_is_kept_in_what_repeats_the_run(write, tmp_path):
    planner = "{name: idm, perception: corridor}"
    loaded = spec.load(write(av_sees="in_sight", planner=planner))
    again = tmp_path / "again.yaml"
    again.write_text(yaml.safe_dump(loaded.resolved()))
    assert spec.load(again) == loaded
    assert loaded.resolved()["av_sees"] == "in_sight"


@pytest.mark.parametrize(
    ("planner", "cure"),
    [("sumo", "choose another planner"), ("idm", "set planner.perception to corridor")],
)
def test_sumos_own_model_sees_everybody(write, planner, cure):
    with pytest.raises(SpecError, match="SUMO's own model sees everybody") as refused:
        spec.load(write(av_sees="in_sight", planner=planner))
    assert cure in str(refused.value)
    assert "\n" not in str(refused.value)
