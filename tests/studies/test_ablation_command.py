"""`python -m studies.ablation` from plan to table, on a made crossing."""

import csv

import pytest

from deepmf_sumo.scene.readers import npz
from deepmf_sumo.training.samples import opponent as opponent_samples
from deepmf_sumo.training.samples import trajectory as trajectory_samples
from studies.ablation.__main__ import main

from tests.support.synthetic import scene

PLAN = """version: 1
data: [train]
test: val
study: study.yaml
planners: {replay: {planner: replay}}
opponent: {steps: 1}
marginal: {steps: 1}
conditional: {steps: 1}
variants:
  - {name: raster off, sizes: {raster: false}}
"""
STUDY = """version: 1
name: crossing
source: {recording: val, scenes: all}
duration_s: 1.0
planner: replay
adversary: G
"""


@pytest.fixture
def folder(monkeypatch, tmp_path):
    monkeypatch.setattr(trajectory_samples, "WINDOW_STEPS", (10, 40))
    monkeypatch.setattr(opponent_samples, "AV_STEPS", (10,))
    monkeypatch.setattr(opponent_samples, "STAND_IN_STEPS", ())
    made = [scene(shift=2.0 * number - 30, av_speed=4.0 + number % 9) for number in range(20)]
    for name, scenes in (("train", made), ("val", [scene(shift=1.0)])):
        (tmp_path / name).mkdir()
        for number, each in enumerate(scenes):
            npz.write(each, tmp_path / name / f"{number:02}.npz")
    (tmp_path / "study.yaml").write_text(STUDY, encoding="utf-8")
    (tmp_path / "plan.yaml").write_text(PLAN, encoding="utf-8")
    return tmp_path


def ablate(folder, *more):
    out, cache = folder / "out", folder / "features"
    arguments = [folder / "plan.yaml", "--out", out, "--cache", cache, "--threads", 1, *more]
    return main(list(map(str, arguments)))


@pytest.mark.slow
@pytest.mark.sumo
def test_one_command_gives_the_table_and_repeats_nothing(folder, capsys):
    assert ablate(folder) == 0
    first = capsys.readouterr().out
    with (folder / "out" / "ablation.csv").open(newline="", encoding="utf-8") as file:
        base, off = csv.DictReader(file)
    assert (base["variant"], off["variant"]) == ("base", "raster off")
    assert int(off["weights"]) < int(base["weights"])
    assert off["min_fde_6_m"] != base["min_fde_6_m"]
    assert all(one["replay runs"] == "1" and float(one["cycle_ms"]) > 0 for one in (base, off))
    table = (folder / "out" / "ablation.md").read_text(encoding="utf-8")
    assert "train (20 scenes, 0 refused)" in table
    assert "val: 1 scenes (0 refused), 2 objects; gains of 1 AVs" in table
    assert "- raster off: raster false" in table
    assert 'replay: planner "replay"' in table
    sets = folder / "out" / "weights"
    assert sorted(path.name for path in sets.iterdir()) == ["base", "raster-off"]
    opponents = {path.read_bytes() for path in sets.glob("*/opponent.safetensors")}
    assert len(opponents) == 1
    made = {path: path.stat().st_mtime_ns for path in sets.rglob("conditional.*")}
    runs = list((folder / "out" / "attacks").rglob("result.json"))
    made |= {path: path.stat().st_mtime_ns for path in runs}

    assert ablate(folder) == 0
    assert capsys.readouterr().out == first
    assert made == {path: path.stat().st_mtime_ns for path in made}
    assert (folder / "out" / "ablation.md").read_text(encoding="utf-8") == table == first


def test_a_wrong_plan_is_refused_before_anything_is_made(folder, capsys):
    assert ablate(folder, "--set", "marginal.step=3") == 2
    told = capsys.readouterr().err
    assert "--set marginal.step=3" in told
    assert "Did you mean 'steps'" in told
    assert not (folder / "out").exists()
