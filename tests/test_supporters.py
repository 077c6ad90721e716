"""A user's adversary attacks with a supporter on a packaged network: the run, folder and page."""

import base64
import json
import re
import zlib
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from deepmf_sumo import spec
from deepmf_sumo.report import table
from deepmf_sumo.report.page import document
from deepmf_sumo.results.reader import Results
from deepmf_sumo.scene import Attack, Driver
from deepmf_sumo.study.sweep import batch

from tests.support import pincer

HIGHWAY = Path(__file__).resolve().parents[1] / "sumo_nets" / "highway" / "highway.sumocfg"
AV, LEFT, RIGHT = "flow_through.16", "flow_through.17", "flow_through.18"
SPEC = {
    "version": 3,
    "name": "helped",
    "source": {"network": str(HIGHWAY), "start_s": 30.0, "av": {"vehicle": AV}},
    "duration_s": 3.0,
    "planner": "idm",
    "adversary": {"name": "tests.test_supporters:Helped"},
}


class Policy(pincer.Policy):
    """Of the two that close in, the left one attacks, and the right one supports it."""

    def reset(self, view, rng):
        return super().reset(view, rng)[:1]

    def plan(self, view):
        attacker, supporter = super().plan(view).values()
        return {
            attacker.agent_id: attacker,
            supporter.agent_id: replace(supporter, supports=attacker.agent_id),
        }


class Helped(pincer.Pincer):
    def attack(self, case, simulate, budget, rng):
        return Attack(rollout=simulate(Policy(self.settings.seconds)))


@pytest.fixture(scope="module")
def out(tmp_path_factory, starts_sumo):
    folder = tmp_path_factory.mktemp("helped")
    (folder / "helped.yaml").write_text(yaml.safe_dump(SPEC))
    batch.run(
        [spec.load(folder / "helped.yaml")], batch.Options(out=folder / "out", jobs=1, sumo=False)
    )
    return folder / "out"


def test_the_supporter_is_driven_and_its_role_is_read_back(out):
    (run,) = Results.open(out).done
    rollout = run.rollout
    assert (run.result["opponent"], rollout.attackers) == (LEFT, (LEFT,))
    assert rollout.roles == {AV: "av", LEFT: "opponent", RIGHT: "supporter"}
    assert (rollout.driver[rollout.tracks.row(RIGHT), rollout.now + 1 :] == Driver.POLICY).all()
    assert [plan.supports for plan in rollout.plans] == [None, LEFT]


def test_a_supporter_that_touches_the_av_hits_nothing_and_spoils_the_attack(out):
    """Both reach the AV at the same time; only a contact of the attacker is a hit."""
    (run,) = Results.open(out).done
    kinds = {(one["kind"], one["second_id"]) for one in run.result["contacts"]}
    assert ("av_opponent", LEFT) in kinds
    assert ("av_opponent", RIGHT) not in kinds
    touched = ("av_other", RIGHT) in kinds
    assert ("supporter_touched" in run.result["finding"]["reasons"]) == touched


def test_the_table_and_the_page_say_who_supports(out):
    (run,) = Results.open(out).done
    assert f"{LEFT}, supported by {RIGHT}" in table.rows([run.result])[0]
    text = document.write(out).read_text("utf-8")
    packed = re.search(r'<script[^>]*id="run-0"[^>]*>([^<]*)<', text)[1]
    shown = json.loads(zlib.decompress(base64.b64decode(packed)))
    roles = {agent["id"]: agent["role"] for agent in shown["replay"]["agents"]}
    assert (roles[LEFT], roles[RIGHT]) == ("opponent", "supporter")
    assert shown["supporters"] == [f"{RIGHT}: none of the ways out in 1 plan"]
