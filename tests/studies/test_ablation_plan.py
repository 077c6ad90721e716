"""Plans of ablations: what they say, and what is refused before anything is trained."""

import pytest
import yaml

from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.errors import SpecError
from studies import ablation

PLAN = """version: 1
data: [train]
test: val
study: study.yaml
planners:
  replay: {planner: replay, adversary.goal: hit}
  idm, lane: {planner: {name: idm, perception: lane}}
variants:
  - {name: raster off, sizes: {raster: false}}
  - {name: N1 16, attack: {form.candidates: 16, form.likelihood_weight: 1.0e-6}}
  - {name: raster off N1 16, sizes: {raster: false}, attack: {form.candidates: 16}}
"""
STUDY = """version: 1
name: attacked
source: {recording: val, scenes: {first: 2}}
planner: replay
adversary: {version: S2}
seed: 3
"""


@pytest.fixture
def folder(tmp_path):
    for name in ("train", "val"):
        (tmp_path / name).mkdir()
    (tmp_path / "study.yaml").write_text(STUDY, encoding="utf-8")
    return tmp_path


def loaded(folder, text=PLAN, sets=()):
    (folder / "plan.yaml").write_text(text, encoding="utf-8")
    return ablation.load(folder / "plan.yaml", sets)


def test_the_base_comes_first_and_equal_sizes_share_networks(folder):
    plan = loaded(folder)
    base, off, fewer, both = plan.all_variants
    assert base.name == "base"
    assert plan.trained_for(fewer) == base
    assert plan.trained_for(both) == off
    assert plan.preset_of(fewer) == LIGHT
    assert plan.preset_of(off).raster is False
    assert plan.preset_of(off).vgg_widths == LIGHT.vgg_widths


def test_variants_attack_as_the_study_does_but_for_their_settings(folder):
    plan = loaded(folder)
    base, _, fewer, _ = plan.all_variants
    first = plan.spec_of(base, "idm, lane")
    other = plan.spec_of(fewer, "replay", folder / "val")
    assert first.name == other.name == "attacked"
    assert first.seed == other.seed == 3
    assert (first.planner.name, first.planner.settings) == ("idm", {"perception": "lane"})
    assert other.planner.name == "replay"
    assert first.adversary.settings == {"period_s": 2.0}
    assert other.adversary.settings == {
        "period_s": 2.0,
        "goal": "hit",
        "form": {"candidates": 16, "likelihood_weight": 1e-6},
    }
    assert other.source.recording == folder / "val"
    assert other.weights == str(folder / "val")


def test_a_key_can_be_set_from_outside(folder):
    assert loaded(folder, sets=["marginal.steps=7"]).of("marginal").steps == 7


@pytest.mark.parametrize(
    ("old", "new", "place", "message"),
    [
        ("test: val", "test: nowhere", "plan.yaml:3", "no such file"),
        ("test: val", "test: train", "plan.yaml:3", "is trained on"),
        ("planners:", "planner:", "plan.yaml:5", "Did you mean 'planners'"),
        (
            "raster: false}}",
            "rasters: false}}",
            "plan.yaml:9",
            "'rasters' is not a size of a network",
        ),
        ("raster: false}}", "vgg_widths: [8, 8]}}", "plan.yaml:9", "'vgg_widths'"),
        ("raster: false}}", "raster_pixels: 16}}", "plan.yaml:9", "'raster_pixels'"),
        ("candidates: 16,", "candidate: 16,", "plan.yaml:10", "Did you mean 'candidates'"),
        ("perception: lane", "perception: road", "plan.yaml:4", "planner 'idm, lane'"),
        ("name: N1 16", "name: raster_off", "plan.yaml:8", "two variants are named"),
        ("name: N1 16", "name: base", "plan.yaml:8", "'base' is the row"),
        ("version: 1\n", "version: 1\nbegin_from: open\n", "plan.yaml:2", "begin_from"),
        ("variants:", "preset: heavy\nvariants:", "plan.yaml:4", "no preset 'heavy'"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(folder, old, new, place, message):
    assert old in PLAN
    with pytest.raises(SpecError, match=r"plan\.yaml") as caught:
        loaded(folder, PLAN.replace(old, new, 1))
    assert f"{place}:" in str(caught.value)
    assert message in str(caught.value)


def test_the_example_is_right(folder):
    from pathlib import Path

    example = Path(__file__).resolve().parents[2] / "studies" / "ablation.yaml"
    names = [one["name"] for one in yaml.safe_load(example.read_text(encoding="utf-8"))["variants"]]
    plan = ablation.load(example, [f"data=['{folder / 'train'}']", f"test='{folder / 'val'}'"])
    assert [one.name for one in plan.variants] == names
