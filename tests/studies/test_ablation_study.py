"""What an ablation trains, measures and attacks, and what it keeps; nothing is computed here."""

import json
from pathlib import Path

import pytest

from deepmf_sumo.errors import OutputError
from deepmf_sumo.training.evaluation import Evaluation
from studies import ablation
from studies.ablation import study

PLAN = """version: 1
data: [train]
test: val
study: study.yaml
planners: {replay: {planner: replay}, idm: {planner: idm}}
variants:
  - {name: Raster off, sizes: {raster: false}}
  - {name: N1 16, attack: {candidates: 16}}
"""
STUDY = "{version: 1, name: attacked, source: {recording: val}, adversary: S2, seed: 3}"


class Work:
    """Records the calls of training, evaluation and attacks, which it replaces."""

    def __init__(self, monkeypatch):
        self.trained, self.evaluated, self.attacked = [], [], []
        monkeypatch.setattr(study, "train_each", self.train)
        monkeypatch.setattr(study.evaluation, "run", self.evaluate)
        monkeypatch.setattr(study.batch, "run", self.attack)
        monkeypatch.setattr(study, "row", lambda *parts: parts)

    def train(self, networks, training, threads, report):
        self.trained.append((training.folder.name, networks, training.preset.raster, threads))
        training.folder.mkdir(parents=True, exist_ok=True)
        for network in networks:
            made = f"{network} {training.seed} {training.preset.name}"
            (training.folder / f"{network}.safetensors").write_text(made, encoding="utf-8")
            card = {"format_version": 1, "made": made}
            (training.folder / f"{network}.json").write_text(json.dumps(card), encoding="utf-8")

    def evaluate(self, data, *, name, file, **_):
        self.evaluated.append((data[0].name, Path(name).name))
        file.parent.mkdir(exist_ok=True)
        found = Evaluation(
            data=["val"],
            weights=Path(name).name,
            scenes=1,
            attacked_scenes=0,
            refused=0,
            refusals=[],
            labelled_objects=0,
            modes=(6,),
            clusters="",
            figures={},
        )
        file.write_text(json.dumps(found.record()), encoding="utf-8")
        return found

    def attack(self, specs, options, report):
        (spec,) = specs
        adversary = spec.adversary.settings
        self.attacked.append(
            (options.out, Path(spec.weights).name, spec.planner.name, adversary.get("form"))
        )
        assert options.resume
        return []


@pytest.fixture
def plan(tmp_path):
    for name in ("train", "val"):
        (tmp_path / name).mkdir()
    (tmp_path / "val" / "scene.npz").write_bytes(b"x")
    (tmp_path / "study.yaml").write_text(STUDY, encoding="utf-8")
    (tmp_path / "plan.yaml").write_text(PLAN, encoding="utf-8")
    return tmp_path / "plan.yaml"


def rows_of(plan, *sets):
    options = ablation.Options(out=plan.parent / "out", threads=2)
    return list(ablation.run(ablation.load(plan, sets), options, lambda _: None))


def test_sizes_are_trained_and_settings_are_not(plan, monkeypatch):
    work = Work(monkeypatch)
    rows = rows_of(plan)
    every = ("opponent", "marginal", "conditional")
    own = ("marginal", "conditional")
    assert work.trained == [
        ("base", every, True, 2),
        ("raster-off", own, False, 2),
        ("base", every, True, 2),  # left alone by `train`
    ]
    assert work.evaluated == [("val", "base"), ("val", "raster-off")]
    assert [attack[1:] for attack in work.attacked] == [
        ("base", "replay", None),
        ("base", "idm", None),
        ("raster-off", "replay", None),
        ("raster-off", "idm", None),
        ("base", "replay", {"preset": "extended", "candidates": 16}),
        ("base", "idm", {"preset": "extended", "candidates": 16}),
    ]
    assert [row[:2] for row in rows] == [
        ("base", "base"),
        ("Raster off", "Raster off"),
        ("N1 16", "base"),
    ]
    assert [row[3].weights for row in rows] == ["base", "raster-off", "base"]
    assert rows[1][2]["opponent"]["made"] == "opponent 0 light"
    assert rows[1][2]["marginal"]["made"] == "marginal 0 raster-off"


def test_finished_figures_are_those_of_these_networks_and_recordings(plan, monkeypatch):
    work = Work(monkeypatch)
    rows_of(plan)
    first = {attack[0] for attack in work.attacked}
    assert len(first) == len(work.attacked) == 6
    rows_of(plan)
    assert {attack[0] for attack in work.attacked} == first
    assert len(work.evaluated) == 2
    rows_of(plan, "seed=1")
    assert len({attack[0] for attack in work.attacked}) == 12
    assert len(work.evaluated) == 4
    (plan.parent / "val" / "scene.npz").write_bytes(b"other")
    rows_of(plan)
    assert len({attack[0] for attack in work.attacked}) == 18
    assert len(work.evaluated) == 6


def test_figures_of_an_earlier_version_are_measured_again(plan, monkeypatch):
    work = Work(monkeypatch)
    rows_of(plan)
    for file in (plan.parent / "out" / "evaluation").iterdir():
        file.write_text(json.dumps({"marginal": {"8.0": {}}}), encoding="utf-8")
    rows_of(plan)
    assert len(work.evaluated) == 4


def test_a_folder_that_cannot_be_written_is_named(plan, monkeypatch):
    work = Work(monkeypatch)
    options = ablation.Options(out=plan.parent / "out")
    rows = ablation.run(ablation.load(plan), options, lambda _: None)
    next(rows)
    monkeypatch.setattr(study, "train_each", lambda *_: None)
    with pytest.raises(OutputError, match=r"raster-off cannot be written"):
        next(rows)
    assert len(work.attacked) == 2
