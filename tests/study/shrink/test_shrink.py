"""Hits of small networks and recordings, shrunk and run again."""

import itertools
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from deepmf_sumo import api
from deepmf_sumo.cli import main
from deepmf_sumo.errors import OutputError, RunError, SpecError, UsageError
from deepmf_sumo.results import tracks
from deepmf_sumo.scene.readers import npz
from deepmf_sumo.study import shrink
from deepmf_sumo.study.shrink import search

from tests.support import simulated_worlds, tiny_network
from tests.support.result_folders import Folder

pytestmark = pytest.mark.sumo

ROUTES = """<routes>
<vType id="steady" sigma="0" speedFactor="1"/>
<vehicle id="leader" depart="0" departPos="60" departLane="0" departSpeed="13.8" type="steady">
  <route edges="ab"/></vehicle>
<vehicle id="av" depart="0" departPos="20" departLane="0" departSpeed="13.8" type="steady">
  <route edges="ab"/></vehicle>
<vehicle id="beside" depart="0" departPos="30" departLane="1" departSpeed="13.8" type="steady">
  <route edges="ab"/></vehicle>
<flow id="late" begin="2" end="20" period="2" departPos="0" departLane="1" type="steady">
  <route edges="ab"/></flow>
</routes>"""


def braking(x, speed, decel=5.0, from_step=10, steps=60):
    """Poses of a vehicle that drives on for a while and then brakes to a halt."""
    speeds = np.maximum(speed - decel * 0.1 * np.maximum(np.arange(steps) - from_step, 0), 0.0)
    return np.column_stack([x + np.cumsum(speeds * 0.1), np.zeros(steps), np.zeros(steps)])


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    """A folder with a network, in which SUMO's traffic also has vehicles that do not matter."""
    folder = tmp_path_factory.mktemp("net")
    tiny_network.build(folder)
    (folder / "tiny.rou.xml").write_text(ROUTES)
    return folder


@pytest.fixture(scope="module")
def lane_y(network):
    """Where the middle of the right lane is."""
    import sumolib

    net = sumolib.net.readNet(str(network / "tiny.net.xml"))
    return net.getLane("ab_0").getShape()[0][1]


@pytest.fixture(scope="module")
def hit(network, lane_y, tmp_path_factory):
    """The folder of a run on the network in which the leader brakes and the AV does not."""
    tmp_path = tmp_path_factory.mktemp("hit")
    where = api.run(
        tiny_network.spec(
            network, "look", planner="constant_velocity", duration_s="0.1", adversary="none"
        ),
        tmp_path / "look",
    ).runs[0]
    found = where.rollout.tracks
    row = found.row("leader")
    x, speed = found.position_m[row, -2, 0], found.speed_mps[row, -2]
    poses = braking(x, speed)
    poses[:, 1] = lane_y
    spec = tiny_network.spec(
        network,
        "braking",
        planner="constant_velocity",
        duration_s="6.0",
        adversary=f"{{name: trajectory, agent: leader, poses: {poses.round(4).tolist()}}}",
    )
    [run] = api.run(spec, tmp_path / "out").runs
    assert run.hit, run.result
    return run.folder


def again(file, out):
    return api.run(file, out).runs[0]


def test_a_hit_is_shrunk_and_fails_again_and_a_careful_planner_passes(hit, tmp_path, capsys):
    file = tmp_path / "small.yaml"
    assert main.run(["shrink", str(hit), "--out", str(file), "--simulations", "12"]) == 0
    said = capsys.readouterr()
    assert "road users -> 2" in said.out
    assert "repeated byte for byte" in said.out
    small = yaml.safe_load(file.read_text())
    assert small["version"] == 3
    assert small["source"]["only"] == ["leader"]
    assert small["source"]["start_s"] > 2.0
    assert small["planner"] == {"name": "constant_velocity"}
    assert small["adversary"]["name"] == "trajectory"
    first, second = again(file, tmp_path / "1"), again(file, tmp_path / "2")
    assert first.hit
    assert set(first.rollout.tracks.ids) == {"av", "leader"}
    assert (first.folder / tracks.FILE).read_bytes() == (second.folder / tracks.FILE).read_bytes()
    assert first.result["expectations_broken"] == ["av_collision is true, expected false"]
    careful = ["--set", "planner=idm", "--out", str(tmp_path / "careful"), "--no-pictures"]
    assert main.run(["run", str(file), *careful]) == 0


def test_nothing_gets_larger_and_the_budget_is_kept(hit):
    failure = shrink.read(hit)
    found = shrink.shrink(failure, 5)
    assert found.simulations == 5
    assert found.end == "budget"
    assert found.best.hit
    assert found.best.steps <= failure.contact
    assert found.best.road_users <= 2 + len(failure.others)
    assert found.best.hardest_mps2 <= found.first.hardest_mps2 + 0.05


def test_a_hit_on_a_recording_is_shrunk(tmp_path):
    motion = simulated_worlds.straight_motion
    slow = motion(40.0, 0.0, 0.0, 10.0)
    scene = simulated_worlds.scene_of(
        simulated_worlds.straight_road(),
        {
            "av": motion(0.0, 0.0, 0.0, 10.0),
            "b": slow,
            "c": motion(10.0, simulated_worlds.LANE_M, 0.0, 10.0),
            "d": motion(-30.0, 0.0, 0.0, 10.0),
        },
    )
    npz.write(scene, tmp_path / "scene.npz")
    poses = braking(40.0, 10.0, steps=80)
    spec = {
        "version": 1,
        "name": "recorded",
        "source": {"recording": "scene.npz"},
        "planner": "constant_velocity",
        "adversary": {"name": "trajectory", "agent": "b", "poses": poses.round(3).tolist()},
    }
    (tmp_path / "spec.yaml").write_text(yaml.safe_dump(spec))
    [run] = api.run(tmp_path / "spec.yaml", tmp_path / "out").runs
    assert run.hit
    found = shrink.shrink(shrink.read(run.folder), 10)
    shrink.write(found, tmp_path / "small.yaml")
    assert found.best.road_users == 2
    assert found.best.values["source"]["start_s"] > 0.5
    repeated = again(tmp_path / "small.yaml", tmp_path / "again")
    assert repeated.hit
    assert set(repeated.rollout.tracks.ids) == {"av", "b"}


def test_what_cannot_be_shrunk_is_refused_in_one_sentence(hit, tmp_path, capsys):
    folder = Folder(tmp_path / "made")
    folder.add("one", hit=False)
    folder.fail("two")
    miss, file = folder.out / "runs" / "00-one", tmp_path / "small.yaml"
    with pytest.raises(UsageError, match="did not hit the AV"):
        shrink.read(miss)
    with pytest.raises(UsageError, match="none of them is a hit"):
        shrink.run_of(folder.out)
    with pytest.raises(UsageError, match=r"has no run '00-ones'\. Did you mean '00-one'"):
        shrink.run_of(folder.out, "00-ones")
    assert main.run(["shrink", str(hit), "--out", str(tmp_path / "no" / "x.yaml")]) == 2
    assert "is not a folder" in capsys.readouterr().err
    with pytest.raises(OutputError, match="cannot be written"):  # before the search, which is long
        shrink.check(Path("/proc/self/task/x.yaml"))
    copy = shutil.copytree(hit, tmp_path / "copy")
    text = (hit / "spec.yaml").read_text()
    (copy / "spec.yaml").write_text(text.replace("constant_velocity", "no_such:Planner"))
    with pytest.raises(SpecError, match=r"planner\.name.*cannot be imported"):
        shrink.read(copy)
    (copy / "spec.yaml").write_text(text.replace("tiny.sumocfg", "gone.sumocfg"))
    with pytest.raises(SpecError, match="no such file"):
        shrink.read(copy)
    assert not file.exists()


def test_a_run_that_failed_is_refused(network, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(network))
    monkeypatch.setenv("PYTHONPATH", str(network), prepend=":")
    spec = tiny_network.spec(network, "bad", planner="bad_planners:Raise")
    [run] = api.run(spec, tmp_path / "out").runs
    assert run.status == "failed"
    with pytest.raises(UsageError, match="ended with 'failed'"):
        shrink.read(run.folder)


def test_a_planner_that_does_not_repeat_itself_is_found_out(hit, monkeypatch):
    real, count = search.trial, itertools.count()

    def drifting(*given):
        return replace(real(*given), digest=str(next(count)))

    monkeypatch.setattr(search, "trial", drifting)
    with pytest.raises(RunError, match="does not repeat itself"):
        shrink.shrink(shrink.read(hit), 4)
