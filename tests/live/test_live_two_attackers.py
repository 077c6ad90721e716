"""Two vehicles that attack together in a simulation that the test steps itself."""

import json
from dataclasses import replace

import libsumo
import numpy as np
import pytest

import deepmf_sumo
from deepmf_sumo.cli import _screen
from deepmf_sumo.live import attacker, record
from deepmf_sumo.live.session import LiveAttack
from deepmf_sumo.results.reader import Results
from deepmf_sumo.scene import Driver, Plan, Turn, TurnRules

from tests.support import tiny_network
from tests.support.live_doubles import OPTIONS, session_on, step
from tests.support.rollout_doubles import rollout_of, straight

pytestmark = pytest.mark.sumo

ROUTES = "".join(
    f'<vehicle id="{name}" depart="0" departPos="{at}" departLane="{lane}" departSpeed="8">'
    '<route edges="ab"/></vehicle>'
    for name, at, lane in (("leader", 40, 0), ("beside", 34, 1), ("av", 20, 0))
)


class BothBrake:
    """Leader and neighbour brake for two seconds, together."""

    period_steps = None

    def reset(self, view, rng):
        return ("leader", "beside") if "leader" in view.history.ids else ()

    def plan(self, view):
        return {agent: self._brake(view, agent) for agent in ("leader", "beside")}

    def _brake(self, view, agent):
        row = view.history.row(agent)
        x, y = view.history.position_m[row, -1]
        speed = np.maximum(view.history.speed_mps[row, -1] - 0.3 * np.arange(1, 21), 0.0)
        return Plan(
            agent_id=agent,
            first_step=view.step + 1,
            position_m=np.column_stack([x + np.cumsum(speed) * 0.1, np.full(20, y)]),
            heading_rad=np.zeros(20),
            speed_mps=speed,
        )


@pytest.fixture
def sumo(tmp_path):
    tiny_network.build(tmp_path)
    (tmp_path / "tiny.rou.xml").write_text(f"<routes>{ROUTES}</routes>")
    command = ["sumo", "-c", str(tmp_path / "tiny.sumocfg"), *OPTIONS, "--step-length", "0.1"]
    libsumo.start(command)
    yield libsumo
    libsumo.close()


@pytest.mark.parametrize("blind", [False, True])
def test_both_are_driven_and_handed_back(sumo, tmp_path, blind):
    session, fought = session_on(
        sumo, tmp_path, BothBrake(), pause_s=100.0, rules=TurnRules(longest_s=5.0, harmless_s=9.0)
    )
    step(sumo, session, 11)
    if blind:
        sumo.vehicle.setSpeedMode("av", 0)
        sumo.vehicle.setSpeed("av", 16.0)
    assert session.driving == {"leader", "beside"}
    step(sumo, session, 40)
    (one,) = fought
    rollout, ended = one.rollout, {turn.opponent_id: turn.ended for turn in one.rollout.turns}
    if blind:
        assert (rollout.ended, rollout.attackers) == ("contact", ("leader", "beside"))
        assert ended == {"leader": "contact", "beside": "other_hit"}
    else:
        assert ended == {"leader": "plan_ended", "beside": "plan_ended"}
    rows = [rollout.tracks.row(agent) for agent in ("leader", "beside")]
    assert (rollout.driver[rows, rollout.now + 1 : rollout.now + 10] == Driver.POLICY).all()
    assert (session.driving, session.attacking) == (set(), None)
    row = record.row(one, 1, 1)
    assert row["opponent"] == rollout.opponent_id
    assert (row["contact"] is not None) == blind
    assert row["min_gap_m"] == round(min(turn.gap_m for turn in rollout.turns), 3)


def test_the_folder_has_the_attack_of_each(sumo, tmp_path, monkeypatch):
    monkeypatch.setattr(attacker, "policy_of", lambda spec: BothBrake())
    out = tmp_path / "out"
    with deepmf_sumo.Attacker(sumo, "av", duration_s=3.0, out=out) as attacking:
        for _ in range(50):
            attacking.before_step()
            sumo.simulationStep()
            attacking.after_step()
    (run,) = Results.open(out).done
    assert [turn["opponent"] for turn in run.result["turns"]] == ["leader", "beside"]
    assert set(run.rollout.attackers) == {"leader", "beside"}
    assert run.rollout.opponent_id == run.result["opponent"]


def test_an_attack_without_a_gap_is_json():
    """The opponent was gone with the first step."""
    rollout = rollout_of({"av": straight(0, 0, 10), "b": straight(30, 0, 10)})
    turn = Turn(opponent_id="b", first_step=10, last_step=11, ended="gone", gap_m=np.inf)
    attack = LiveAttack(begin_s=1.0, end_s=1.1, rollout=replace(rollout, turns=(turn,)))
    row = record.row(attack, 1, 1)
    assert row["min_gap_m"] is None
    json.dumps(row, allow_nan=False)
    assert _screen._live_cells(row)[6] == "-"
    _screen.tell_attack(row)
