"""DeepMF with the package's weights leaves the same bytes, whatever the number of workers."""

from pathlib import Path

import pytest

from deepmf_sumo.spec import load
from deepmf_sumo.study.sweep import batch

from tests.support.same_bytes import differences

SPECS = Path(__file__).resolve().parents[3] / "scenarios"


@pytest.mark.slow
def test_one_worker_and_two_leave_the_same_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("DEEPMF_SUMO_HOME", str(tmp_path / "home"))
    specs = [load(SPECS / f"{name}.yaml") for name in ("cut_in", "rear_end", "u_turn")]
    for jobs in (1, 2):
        results = batch.run(specs, batch.Options(out=tmp_path / str(jobs), jobs=jobs))
        assert [one["status"] for one in results] == ["ok"] * 3
    assert differences(tmp_path / "1", tmp_path / "2") == []
