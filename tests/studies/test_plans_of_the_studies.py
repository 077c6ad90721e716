"""The plans in studies/ are plans."""

from pathlib import Path

import pytest

from deepmf_sumo.scene import readers
from deepmf_sumo.study import plans
from deepmf_sumo.study.plans import entries

STUDIES = Path(__file__).resolve().parents[2] / "studies"
PLANS = [path for path in sorted(STUDIES.glob("*.yaml")) if plans.is_plan(path)]


@pytest.mark.parametrize("path", PLANS, ids=lambda path: path.stem)
def test_each_method_goes_with_each_planner(path, monkeypatch, tmp_path):
    found = [readers.RecordRef(file=tmp_path, name="a", record=0)]
    monkeypatch.setattr(readers, "records", lambda path, cache: iter(found))
    recorded = "source: {recording" in path.read_text("utf-8")
    sets = [f'source.recording="{tmp_path}"'] * recorded
    loaded = plans.load(path, [*sets, "weights=open"])
    rows = entries.entries_of(loaded, tmp_path)
    assert {row.label.planner for row in rows} == set(loaded.plan.planners)
    assert {row.label.base for row in rows} == set(loaded.plan.methods)


def test_the_studies_of_attacks_are_there():
    assert {"attacks", "attack_settings", "no_attack", "paper"} <= {path.stem for path in PLANS}
