"""Episodes of a user's SUMO scenario."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
import sumo as sumo_package

from deepmf_sumo.deepmf.networks.weights import cached_predictors
from deepmf_sumo.deepmf.policy import Settings
from deepmf_sumo.deepmf.policy import build as deepmf
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.planners import idm, replay, sumo
from deepmf_sumo.scene import HISTORY_STEPS, Driver, Plan
from deepmf_sumo.sumo.simulation import network_case, simulate

from tests.support.tiny_network import build

NOW = HISTORY_STEPS - 1
_STUCK = ("--time-to-teleport", "3")
NETWORKS = Path(__file__).resolve().parents[3] / "sumo_nets"


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    return build(tmp_path_factory.mktemp("tiny"))


def run(case, planner=None, policy=None):
    planner = planner or idm.build(idm.Settings())
    return simulate(case, planner, policy, rng=np.random.default_rng(0))


class Swerve:
    """The leader brakes, half off its lane, for two seconds."""

    period_steps = None

    def __init__(self, sideways=1.0):
        self.sideways = sideways

    def reset(self, view, rng):
        return ("leader",)

    def plan(self, view):
        row = view.history.row("leader")
        x, y = view.history.position_m[row, -1]
        speed = np.maximum(view.history.speed_mps[row, -1] - 0.3 * np.arange(1, 21), 0.0)
        return {
            "leader": Plan(
                agent_id="leader",
                first_step=view.step + 1,
                position_m=np.column_stack(
                    [x + np.cumsum(speed) * 0.1, y + self.sideways * np.linspace(0.05, 1, 20)]
                ),
                heading_rad=np.zeros(20),
                speed_mps=speed,
            )
        }


def test_history_is_what_sumo_drove_and_the_rest_follows_without_a_gap(config):
    rollout = run(network_case(config, 3.0, "av", 30, seed=0))
    assert (rollout.ended, rollout.now, rollout.tracks.steps) == ("time", NOW, NOW + 31)
    row = rollout.tracks.row("av")
    assert (rollout.driver[row, : NOW + 1] == Driver.SUMO).all()
    assert (rollout.driver[row, NOW + 1 :] == Driver.PLANNER).all()
    assert rollout.tracks.valid.all()
    step = np.diff(rollout.tracks.position_m[row], axis=0)[:, 0]
    assert step.min() > 0.5
    assert step == pytest.approx(rollout.tracks.speed_mps[row, 1:] * 0.1, abs=0.15)


def test_poses_are_box_centres(config):
    rollout = run(network_case(config, 0.5, "av", 1, seed=0), sumo.build(sumo.Settings()))
    row = rollout.tracks.row("av")
    # inserted at 20 m with its front; the first second of SUMO's time is only half there
    seen = np.flatnonzero(rollout.tracks.valid[row])
    assert seen[0] == NOW - 4
    assert rollout.tracks.position_m[row, seen[0], 0] == pytest.approx(20.0 - 2.5, abs=0.9)


def test_another_step_length_is_said(config):
    kinds = [event.kind for event in run(network_case(config, 2.0, "av", 2, seed=0)).events]
    assert kinds == ["step_length_changed"]


def test_opponent_is_taken_over_and_handed_back(config):
    rollout = run(network_case(config, 3.0, "av", 60, seed=0), policy=Swerve())
    row = rollout.tracks.row("leader")
    assert (rollout.driver[row, NOW + 1 : NOW + 21] == Driver.POLICY).all()
    after = rollout.driver[row, NOW + 21 :]
    back = int(np.argmax(after == Driver.SUMO))  # it comes back to the middle of its lane first
    assert 5 < back < 40
    assert (after[:back] == Driver.POLICY).all()
    assert (after[back:] == Driver.SUMO).all()
    expected = rollout.plans[0].position_m
    assert np.abs(rollout.tracks.position_m[row, NOW + 1 : NOW + 21] - expected).max() < 1e-6
    assert rollout.tracks.valid[row].all()
    sideways = np.diff(rollout.tracks.position_m[row, NOW + 20 :, 1])
    assert np.abs(sideways).max() < 0.15
    assert -0.1 < rollout.tracks.position_m[row, NOW + 21 + back, 1] + 4.8 < 0.1
    assert {event.kind for event in rollout.events} >= {"plan_ended", "handed_back"}


@pytest.mark.jumps("the plan leads sideways")
def test_opponent_far_off_the_road_is_put_back_onto_a_lane(config):
    case = network_case(config, 3.0, "av", 110, seed=0)
    rollout = run(case, policy=Swerve(sideways=-15.0))
    row = rollout.tracks.row("leader")
    assert rollout.tracks.valid[row].all()
    assert rollout.tracks.position_m[row, NOW + 20, 1] < -15.0
    assert rollout.tracks.position_m[row, -1, 1] > -6.0


def test_same_seed_same_bytes(config):
    case = network_case(config, 3.0, "av", 40, seed=5)
    one, other = run(case, policy=Swerve()), run(case, policy=Swerve())
    assert one.tracks.position_m.tobytes() == other.tracks.position_m.tobytes()
    assert one.tracks.ids == other.tracks.ids


def test_missing_av_says_when_it_departs_and_who_is_there(config):
    text = config.with_name("tiny.rou.xml").read_text()
    late = '<vehicle id="late" depart="9"><route edges="ab"/></vehicle></routes>'
    config.with_name("late.rou.xml").write_text(text.replace("</routes>", late))
    other = config.with_name("late.sumocfg")
    other.write_text(config.read_text().replace("tiny.rou", "late.rou"))
    with pytest.raises(SimulationError) as refused:
        run(network_case(other, 3.0, "late", 10, seed=0))
    message = str(refused.value)
    for part in ("late.sumocfg", "'late'", "departs at 9.", "av, leader"):
        assert part in message
    with pytest.raises(SimulationError, match=r"'nobody'.*never departs"):
        run(network_case(config, 3.0, "nobody", 10, seed=0))


def test_av_that_arrives_ends_the_episode(config):
    rollout = run(network_case(config, 20.0, "av", 300, seed=0), sumo.build(sumo.Settings()))
    assert rollout.ended == "av_gone"


def test_an_av_that_sumo_teleports_ends_the_episode_where_it_stood():
    config = NETWORKS / "four_way" / "four_way.sumocfg"
    case = network_case(config, 51.0, "av", 90, seed=23423, sumo_options=_STUCK)
    rollout = run(case, sumo.build(sumo.Settings()))
    assert rollout.ended == "av_gone"
    (told,) = [event for event in rollout.events if event.kind == "av_teleported"]
    assert told.step == rollout.tracks.steps - 1 < NOW + 90
    row = rollout.tracks.row("av")
    assert rollout.tracks.valid[row, NOW:-1].all()
    assert not rollout.tracks.valid[row, -1]
    position_m = rollout.tracks.position_m[row, NOW:-1]
    assert np.hypot(*np.diff(position_m, axis=0).T).max() < 2.0


def test_what_sumo_moves_over_a_junction_without_lanes_inside_is_told(tmp_path):
    """SUMO's cars are at the end of one edge, and a step later at the begin of the next."""
    grid = [tmp_path / "grid.net.xml", "--no-internal-links", "true", "--no-turnarounds", "true"]
    command = [Path(sumo_package.SUMO_HOME) / "bin" / "netgenerate", "--grid", "-o", *grid]
    subprocess.run([*map(str, command), "--default.lanenumber", "3"], check=True, timeout=60)
    (tmp_path / "cars.rou.xml").write_text(
        '<routes><route id="r" edges="A0B0 B0C0 C0D0"/>'
        '<vehicle id="other" route="r" depart="0"/><vehicle id="av" route="r" depart="4"/></routes>'
    )
    config = tmp_path / "grid.sumocfg"
    config.write_text(
        '<configuration><input><net-file value="grid.net.xml"/>'
        '<route-files value="cars.rou.xml"/></input></configuration>'
    )
    rollout = run(network_case(config, 6.0, "av", 150, seed=0), sumo.build(sumo.Settings()))
    told = {(one.agent_id, one.step) for one in rollout.events if one.kind == "jumped"}
    tracks = rollout.tracks
    moved = np.hypot(*np.moveaxis(np.diff(tracks.position_m, axis=1), -1, 0))
    found = {
        (tracks.ids[row], int(at) + 1)
        for row, at in zip(*np.nonzero(moved > 5.0), strict=True)
        if tracks.valid[row, at : at + 2].all()
    }
    assert {agent for agent, _ in found} == {"av", "other"}
    assert told == found


def test_replay_planner_needs_a_recording(config):
    with pytest.raises(SimulationError, match="needs a recording"):
        run(network_case(config, 3.0, "av", 10, seed=0), replay.build(replay.Settings()))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("<configuration/>", "names no network"),
        (
            '<configuration><input><net-file value="x.net.xml"/></input></configuration>',
            "x.net.xml",
        ),
        ("nonsense", "cannot be read"),
    ],
)
def test_unusable_configurations_are_refused_in_one_sentence(tmp_path, text, reason):
    file = tmp_path / "bad.sumocfg"
    file.write_text(text)
    with pytest.raises(SimulationError, match=reason):
        network_case(file, 1.0, "av", 10, seed=0)


def test_what_sumo_says_against_a_configuration_is_passed_on(config):
    routes = config.with_name("broken.rou.xml")
    routes.write_text(
        '<routes><vehicle id="a" depart="0"><route edges="nowhere"/></vehicle></routes>'
    )
    broken = config.with_name("broken.sumocfg")
    broken.write_text(config.read_text().replace("tiny.rou", "broken.rou"))
    with pytest.raises(SimulationError, match="nowhere"):
        run(network_case(broken, 1.0, "a", 10, seed=0))


@pytest.mark.parametrize(
    ("vehicle_class", "kind"),
    [("bus", "vehicle"), ("tram", "other"), ("bicycle", "cyclist"), ("wheelchair", "pedestrian")],
)
def test_what_is_no_vehicle_on_roads_never_attacks(tmp_path, vehicle_class, kind):
    config = build(tmp_path)
    routes = tmp_path / "tiny.rou.xml"
    of_class = f'<routes><vType id="kind" vClass="{vehicle_class}"/>'
    text = routes.read_text().replace("<routes>", of_class)
    routes.write_text(text.replace('id="leader"', 'id="leader" type="kind"'))
    policy = deepmf(Settings(period_s=1.0), cached_predictors("open"))
    rollout = run(network_case(config, 5.0, "av", 1), policy=policy)
    assert rollout.tracks.kinds[rollout.tracks.row("leader")] == kind
    assert rollout.opponent_id == ("leader" if kind == "vehicle" else None)
