import gzip
import io
import json
import xml.etree.ElementTree as ET
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from deepmf_sumo import files, spec
from deepmf_sumo.errors import OutputError
from deepmf_sumo.report import table
from deepmf_sumo.results import artifacts, junit, result
from deepmf_sumo.results import folder as folder_module
from deepmf_sumo.results.tracks import TRACK_COLUMNS, write_tracks
from deepmf_sumo.scene import (
    Attack,
    Forecast,
    Futures,
    MetricValue,
    OpponentScores,
    Plan,
    PlanReason,
    Trial,
)
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.study.sweep import episode

from tests.support import same_bytes, tiny_network
from tests.support.rollout_doubles import case_of, contact_of, rollout_of, straight


def forecast(modes=3):
    futures = Futures(
        agent_id="b", position_m=np.ones((modes, 80, 2)), heading_rad=np.zeros((modes, 80))
    )
    return Forecast(futures=futures, probability=np.full(modes, 1 / modes))


def plan():
    reason = PlanReason(
        scores=OpponentScores(ids=("b",), logits=np.zeros(1), partner_logits=np.zeros(1)),
        candidates=forecast(),
        reactions=(forecast(2), forecast(2), forecast(2)),
        collides=np.zeros((3, 2), bool),
        collision_step=np.full((3, 2), 80.0),
        value=np.zeros(3),
        product=np.zeros(3),
        chosen=1,
        rule="expected",
        bent_m=np.zeros(3),
        milliseconds={"features": 2.0, "networks": 3.0},
    )
    return Plan(
        agent_id="b",
        first_step=11,
        position_m=np.ones((80, 2)),
        heading_rad=np.zeros(80),
        speed_mps=np.ones(80),
        reason=reason,
    )


@pytest.fixture
def rollout():
    paths = {"av": straight(0, 0, 10), "b": straight(-8, 3.5, 12), 'odd,"id"': straight(9, 9, 1)}
    return rollout_of(paths, contacts=[contact_of()], plans=[plan()])


@pytest.fixture
def task(tiny):
    path = tiny_network.spec(tiny, "made up", adversary="S2")
    return Task(run_id="made-up--tiny--0", spec=spec.load(path), scene="tiny")


METRICS = [
    MetricValue(name="feasible", value=1.0, unit="1", better="higher"),
    MetricValue(name="on_road", value=None, unit="1", better="higher", reason="no opponent"),
]


@pytest.fixture
def found(task, rollout):
    trials = (Trial(values={"a": 1.0}, objective=2.0),)
    attack = Attack(rollout=rollout, generation_s=0.25, trials=trials)
    one = result.finished(task, case_of(), attack, METRICS, wall_s=1.5)
    one["expectations_broken"] = []
    return one


def test_row(found):
    row = result.row(found)
    assert row == {
        "run_id": "made-up--tiny--0",
        "spec": "made up",
        "profile": "any",
        "constraints": "",
        "scene": "tiny",
        "planner": "idm",
        "perception": "lane",
        "adversary": "deepmf",
        "version": "S2",
        "seed": "0",
        "status": "ok",
        "outcome": "av_opponent",
        "contact_time_s": "3",
        "contact_speed_mps": "4.5",
        "impact_sector": "0",
        "opponent": "b",
        "opponent_score": "0.5",
        "feasible": "1",
        "on_road": "",
        "generation_s": "0.25",
        "cycle_ms_median": "5",
        "simulation_s": "0",
        "error": "",
        "method": "made up",
        "planner_label": "idm lane",
        "parameters": "treiber",
        "part": "main",
        "budget_simulations": "",
        "budget_seconds": "",
        "simulations": "1",
        "turns": "",
        "turn_hits": "",
    }
    assert tuple(row) == result.COLUMNS
    json.dumps(found, allow_nan=False)


def test_row_of_a_failed_run(task):
    row = result.row(result.unfinished(task, "failed", "two\nlines"))
    assert (row["status"], row["error"], row["outcome"]) == ("failed", "two lines", "")


def test_tracks(rollout, tmp_path):
    write_tracks(tmp_path / "t.csv.gz", rollout)
    table = pd.read_csv(tmp_path / "t.csv.gz")
    assert ",".join(table.columns) == TRACK_COLUMNS
    assert len(table) == rollout.tracks.valid.sum()
    now = table[(table.time_s == 0) & (table.id == "av")].iloc[0]
    assert (now.step, now.role, now.driver, now.x_m, now.speed_mps) == (10, "av", "log", 0, 10)
    assert set(table[table.role == "opponent"].driver) == {"log", "policy"}
    assert 'odd,"id"' in set(table.id)
    tracks = rollout.tracks
    high = replace(rollout, tracks=replace(tracks, z_m=np.full(tracks.z_m.shape, 8.0)))
    write_tracks(tmp_path / "high.csv.gz", high)
    assert set(table.z_m) == {0.0}
    assert set(pd.read_csv(tmp_path / "high.csv.gz").z_m) == {8.0}
    raw = (tmp_path / "t.csv.gz").read_bytes()
    assert raw[4:8] == b"\0\0\0\0"
    assert gzip.decompress(raw).startswith(b"step,time_s")


def test_plans(rollout, tmp_path):
    artifacts.write_plans(tmp_path / "a.npz", rollout)
    artifacts.write_plans(tmp_path / "b.npz", rollout)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    arrays = np.load(tmp_path / "a.npz", allow_pickle=False)
    assert arrays["plans"] == 1
    assert arrays["00/reaction_position_m"].shape == (3, 2, 80, 2)
    assert str(arrays["00/rule"]) == "expected"
    assert not any("milliseconds" in name for name in arrays)


def test_npz_is_what_numpy_reads():
    arrays = np.load(io.BytesIO(files.npz({"a/b": np.arange(3)})))
    assert arrays["a/b"].tolist() == [0, 1, 2]


def test_nan_never_reaches_a_file(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        files.write_json(tmp_path / "x.json", {"a": float("nan")})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("expect", "sentences"),
    [
        ({"av_collision": True}, []),
        ({"av_collision": False}, ["av_collision is true, expected false"]),
        ({"outcome": "none"}, ["outcome is av_opponent, expected none"]),
        ({"max_contact_speed_mps": 4}, ["contact speed is 4.50 m/s, expected at most 4"]),
        ({"max_contact_speed_mps": 5}, []),
        ({"metrics": {"feasible": {"min": 1}}}, []),
        ({"metrics": {"feasible": {"max": 0.5}}}, ["feasible is 1, expected at most 0.5"]),
        ({"metrics": {"feasible": {"min": 2}}}, ["feasible is 1, expected at least 2"]),
        ({"metrics": {"on_road": {"min": 0}}}, ["on_road has no value (no opponent)"]),
        ({"metrics": {"typo": {"min": 0}}}, ["typo has no value (no such metric)"]),
    ],
)
def test_expectations(found, expect, sentences):
    assert episode.broken(spec.Expect.model_validate(expect), found) == sentences


@pytest.mark.parametrize(
    ("outcome", "contacts", "wanted"),
    [
        ("opponent_other", [("opponent_other", 1.0), ("av_other", 15.0)], ["15.00"]),
        ("av_opponent", [("av_other", 15.0), ("av_opponent", 1.0)], ["15.00"]),
        ("av_opponent", [("av_opponent", 1.0), ("av_opponent", 15.0)], ["15.00"]),
        ("opponent_other", [("opponent_other", 12.0)], []),
    ],
)
def test_every_contact_of_the_av_is_expected_to_be_slow(found, outcome, contacts, wanted):
    found["outcome"] = outcome
    found["contacts"] = [{"kind": kind, "relative_mps": mps} for kind, mps in contacts]
    sentences = [f"contact speed is {mps} m/s, expected at most 5" for mps in wanted]
    assert episode.broken(spec.Expect(max_contact_speed_mps=5), found) == sentences


def test_failed_runs_break_no_expectation(task):
    lost = result.unfinished(task, "failed", "x")
    assert episode.broken(spec.Expect(av_collision=True), lost) == []


def test_junit(found, task, tmp_path):
    lost = result.unfinished(task, "timeout", "bell \x07 & <tag>")
    skipped = result.unfinished(task, "skipped", "bad record")
    broken = {**found, "expectations_broken": ["a < b"], "spec": "other"}
    for one in (lost, skipped):
        one["expectations_broken"] = []
    junit.write(tmp_path / "junit.xml", [found, lost, skipped, broken])
    root = ET.parse(tmp_path / "junit.xml").getroot()
    counts = {key: root.get(key) for key in ("tests", "failures", "errors", "skipped")}
    assert counts == {"tests": "4", "failures": "1", "errors": "1", "skipped": "1"}
    assert [suite.get("tests") for suite in root] == ["3", "1"]
    assert root.find(".//failure").get("message") == "a < b"
    assert root.find(".//error").get("message") == "bell \N{REPLACEMENT CHARACTER} & <tag>"


def test_summary(found, task):
    lost = result.unfinished(task, "failed", "x")
    lost["expectations_broken"] = []
    summary = folder_module.summary([found, lost])
    assert summary["status"] == {"ok": 1, "failed": 1}
    assert summary["collision_rate"]["rate"] == 1.0
    assert 0 < summary["collision_rate"]["low"] < 0.3
    nobody = found | {"opponent": None, "outcome": "none", "contacts": []}
    with_nobody = folder_module.summary([found, nobody, lost])
    assert (with_nobody["runs"], with_nobody["attacked"], with_nobody["hits"]) == (3, 1, 1)
    assert with_nobody["collision_rate"] == summary["collision_rate"]
    assert "AV hit by opponent in 1 of 1 attacked, 100 %" in table.totals(with_nobody)
    assert folder_module.summary([nobody])["collision_rate"] is None
    assert summary["metrics"]["feasible"]["mean"] == 1.0
    assert summary["metrics"]["on_road"]["runs"] == 0
    assert summary["timings"]["generation_s"] == 0.25
    assert folder_module.summary([])["collision_rate"] is None


@pytest.mark.sumo  # the manifest names the platform, for which Python calls uname
def test_results_of_an_earlier_batch_are_deleted_only_where_that_is_asked_for(tmp_path):
    out = tmp_path / "deep" / "out"
    with folder_module.opened(out, resume=False) as folder:
        folder.manifest({}, {})
        (out / "runs" / "old").mkdir()
    with folder_module.opened(out, resume=True):
        assert (out / "runs" / "old").is_dir()
    for refused in (folder_module.opened(out, resume=False), _checked(out)):
        with pytest.raises(OutputError, match=r"--resume .* --overwrite .* --out"), refused:
            pass
    assert (out / "runs" / "old").is_dir()
    with folder_module.opened(out, resume=False, overwrite=True):
        assert list((out / "runs").iterdir()) == []
    (out / "manifest.json").write_text("[]")
    for overwrite in (False, True):
        with (
            pytest.raises(OutputError, match="holds other files"),
            folder_module.opened(out, resume=False, overwrite=overwrite),
        ):
            pass


@contextmanager
def _checked(out):
    folder_module.check(out, resume=False)
    yield


@pytest.mark.sumo  # the manifest names the platform, for which Python calls uname
def test_tables_without_their_runs_are_results_too(tmp_path):
    with folder_module.opened(tmp_path, resume=False) as folder:
        folder.manifest({"one": "key"}, {})
        folder.finish([], junit_too=False, interrupted=True)
    assert folder_module.holds_results(tmp_path)
    with folder_module.opened(tmp_path, resume=True) as folder:
        folder.manifest({}, {})
    assert not folder_module.holds_results(tmp_path)  # a batch of no runs: nothing is lost


def test_a_look_at_a_folder_leaves_nothing_behind(tmp_path):
    out = tmp_path / "deep" / "out"
    folder_module.check(out, resume=False)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        folder_module.check(tmp_path / "file" / "out", resume=False)


def test_compare_sees_what_matters(tmp_path):
    for name in "ab":
        folder = tmp_path / name
        (folder / "sub").mkdir(parents=True)
        (folder / "x.json").write_text(json.dumps({"kept": 1, "timings": {"s": name}}))
        (folder / "net.xml").write_text(f"<!-- made by {name} --><net/>")
        (folder / "sub" / "log.txt").write_text(name)
        (folder / "runs.csv").write_text(f"run_id,generation_s\na,{ord(name)}\n")
        (folder / "junit.xml").write_text(f'<a name="x" time="{ord(name)}"/>')
    assert same_bytes.same(tmp_path / "a", tmp_path / "b")
    (tmp_path / "b" / "x.json").write_text(json.dumps({"kept": 2}))
    (tmp_path / "b" / "runs.csv").write_text("run_id,generation_s\nb,97\n")
    (tmp_path / "a" / "sub" / "extra").write_bytes(b"")
    assert same_bytes.differences(tmp_path / "a", tmp_path / "b") == [
        "runs.csv",
        "sub/extra",
        "x.json",
    ]
