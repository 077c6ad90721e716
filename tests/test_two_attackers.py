"""A user's adversary attacks with two vehicles of a packaged network: the run, and its folder."""

import base64
import csv
import json
import re
import xml.etree.ElementTree as ET
import zlib
from pathlib import Path

import numpy as np
import pytest
import yaml

from deepmf_sumo import spec
from deepmf_sumo.report.page import document
from deepmf_sumo.results.exports import Format
from deepmf_sumo.results.reader import Results
from deepmf_sumo.scene import Driver
from deepmf_sumo.study.sweep import batch

HIGHWAY = Path(__file__).resolve().parents[1] / "sumo_nets" / "highway" / "highway.sumocfg"
AV, LEFT, RIGHT = "flow_through.16", "flow_through.17", "flow_through.18"
SPEC = {
    "version": 3,
    "name": "pincer",
    "source": {"network": str(HIGHWAY), "start_s": 30.0, "av": {"vehicle": AV}},
    "duration_s": 3.0,
    "planner": "idm",
    "adversary": {"name": "tests.support.pincer:Pincer"},
}


@pytest.fixture(scope="module")
def out(tmp_path_factory, starts_sumo):
    folder = tmp_path_factory.mktemp("two")
    (folder / "pincer.yaml").write_text(yaml.safe_dump(SPEC))
    options = batch.Options(out=folder / "out", jobs=1, formats=(Format.named("openscenario"),))
    batch.run([spec.load(folder / "pincer.yaml")], options)
    return folder / "out"


def test_both_are_driven_and_the_one_that_hits_is_the_opponent(out):
    (run,) = Results.open(out).done
    assert (run.status, run.outcome, run.result["opponent"]) == ("ok", "av_opponent", LEFT)
    rollout = run.rollout
    assert (rollout.attackers, rollout.opponent_id) == ((LEFT, RIGHT), LEFT)
    assert rollout.roles == {AV: "av", LEFT: "opponent", RIGHT: "attacker"}
    rows = [rollout.tracks.row(agent) for agent in (LEFT, RIGHT)]
    assert (rollout.driver[rows, rollout.now + 1 :] == Driver.POLICY).all()
    assert {plan.agent_id for plan in rollout.plans} == {LEFT, RIGHT}


def test_each_attacker_is_measured_by_itself(out):
    (run,) = Results.open(out).done
    rollout = run.rollout
    hitting, other = run.result["turns"]
    assert (hitting["opponent"], hitting["ended"], hitting["outcome"]) == (
        LEFT, "contact", "av_opponent",
    )  # fmt: skip
    assert (other["opponent"], other["ended"], other["outcome"]) == (RIGHT, "other_hit", "av_other")
    assert [one["metrics"]["collision"] for one in (hitting, other)] == [1.0, 0.0]
    assert hitting["metrics"] == {name: one["value"] for name, one in run.metrics.items()}
    position = [rollout.tracks.position_m[rollout.tracks.row(one)] for one in (AV, RIGHT)]
    away = np.hypot(*(position[0] - position[1])[rollout.now + 1 :].T).min()
    assert away - 5 < other["metrics"]["min_gap"] < away
    rows = csv.DictReader((out / "turns.csv").read_text("utf-8").splitlines())
    assert [row["opponent"] for row in rows] == [LEFT, RIGHT]


def test_the_page_shows_both(out):
    text = document.write(out).read_text("utf-8")
    packed = re.search(r'<script[^>]*id="run-0"[^>]*>([^<]*)<', text)[1]
    shown = json.loads(zlib.decompress(base64.b64decode(packed)))
    agents = {agent["id"]: agent for agent in shown["replay"]["agents"]}
    assert [agents[name]["role"] for name in (AV, LEFT, RIGHT)] == ["av", "opponent", "attacker"]
    assert all("speed" in agents[name] for name in (AV, LEFT, RIGHT))
    assert [turn["opponent"] for turn in shown["turns"]] == [LEFT, RIGHT]
    assert [turn["ended"] for turn in shown["turns"]] == ["contact", "another attacker hit the AV"]
    assert {plan["agent"] for plan in shown["reasons"]} == {LEFT, RIGHT}
    timeline = shown["replay"]["timeline"]
    assert len(timeline["gap"]) == shown["replay"]["steps"] - 1 - shown["replay"]["now"]


def test_other_formats_name_both(out):
    (file,) = out.glob("runs/*/openscenario/*.xosc")
    properties = [
        {one.get("name"): one.get("value") for one in thing}
        for thing in ET.parse(file).iter("Properties")
    ]
    roles = {known["id"]: known["role"] for known in properties}
    assert [roles[name] for name in (AV, LEFT, RIGHT)] == ["av", "opponent", "attacker"]
