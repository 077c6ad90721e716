"""MetaDrive as a world of the episode's loop, with a double that replays what MetaDrive is given.

MetaDrive itself is not installed here; `studies/metadrive` says what was run with it.
"""

import pickle
from types import SimpleNamespace

import numpy as np
import pytest

from deepmf_sumo.scene import Command, Driver
from deepmf_sumo.sumo.simulation.frame import Pose
from studies.metadrive.world import MetaDriveWorld, from_now, written

from tests.support import rollout_doubles, synthetic


class Double:
    """The part of ScenarioEnv that is used: the AV stands, all others replay their lists."""

    def __init__(self, scene):
        tracks = from_now(scene).tracks
        origin = tracks.position_m[tracks.row(scene.av_id), 0]
        self.agent = SimpleNamespace(position=(0.0, 0.0), velocity=(3.0, 4.0), heading_theta=0.5)
        self.lists = {
            agent: [
                {"valid": True, "position": at - origin} if there else None
                for at, there in zip(tracks.position_m[row], tracks.valid[row], strict=True)
            ]
            for row, agent in enumerate(tracks.ids)
            if agent != scene.av_id
        }
        policies = {
            f"obj {agent}": SimpleNamespace(traj_info=at) for agent, at in self.lists.items()
        }
        manager = SimpleNamespace(
            _scenario_id_to_obj_id={agent: f"obj {agent}" for agent in self.lists},
            get_policy=policies.__getitem__,
        )
        self.engine = SimpleNamespace(traffic_manager=manager)

    def reset(self, seed):
        self.seed = seed

    def step(self, action):
        return None, 0.0, False, False, {}


@pytest.fixture
def world():
    case = rollout_doubles.case_of()  # the AV at the origin, b 8 m behind and 3.5 m beside it
    return MetaDriveWorld(Double(case.scene), 7, case)


def stepped(world, opponent=None, pose=None):
    return world.step(Command(kind="sumo"), {} if opponent is None else {opponent: pose})


def test_the_av_is_where_metadrive_has_it_and_others_are_where_they_were(world):
    assert world._env.seed == 7
    assert len(world.history()) == 11
    frame = stepped(world)
    me, other = frame.ids.index("av"), frame.ids.index("b")
    np.testing.assert_allclose(frame.position_m[me], (0.0, 0.0), atol=1e-9)
    np.testing.assert_allclose(frame.velocity_mps[me], (3.0, 4.0))
    np.testing.assert_allclose(frame.position_m[other], (-8 + 1.2, 3.5))
    assert [frame.driver[me], frame.driver[other]] == [Driver.PLANNER, Driver.LOG]


def test_metadrive_replays_the_plan_of_the_opponent_in_its_own_frame(world):
    pose = Pose(x_m=5.0, y_m=2.0, heading_rad=0.3, speed_mps=10.0, course_rad=0.0)
    stepped(world)
    frame = stepped(world, "b", pose)
    other = frame.ids.index("b")
    np.testing.assert_allclose(frame.position_m[other], (5.0, 2.0))
    assert frame.driver[other] == Driver.POLICY
    given = world._env.lists["b"][2]
    np.testing.assert_allclose(given["position"], (5.0, 2.0))  # the AV began at the origin
    np.testing.assert_allclose(given["velocity"], (10.0, 0.0))
    assert given["heading"] == 0.3
    np.testing.assert_allclose(world._env.lists["b"][1]["position"], (-8 + 1.2, 3.5))


def test_an_opponent_that_metadrive_does_not_have_is_not_shown_where_it_was_put(world):
    world._env.engine.traffic_manager._scenario_id_to_obj_id.clear()
    pose = Pose(x_m=5.0, y_m=2.0, heading_rad=0.0, speed_mps=10.0)
    for _ in range(2):
        frame = stepped(world, "b", pose)
    np.testing.assert_allclose(frame.position_m[frame.ids.index("b")], (-8 + 2.4, 3.5))
    (event,) = world.events
    assert (event.kind, event.agent_id) == ("opponent_gone", "b")


def test_scenes_begin_at_the_current_step(tmp_path):
    scene = synthetic.scene()
    written([scene, scene], tmp_path)
    summary = pickle.loads((tmp_path / "dataset_summary.pkl").read_bytes())
    assert list(summary) == ["sd_deepmf_00000.pkl", "sd_deepmf_00001.pkl"]
    values = pickle.loads((tmp_path / "sd_deepmf_00001.pkl").read_bytes())
    assert values["metadata"]["sdc_id"] == scene.av_id
    row = scene.tracks.row("south")
    state = values["tracks"]["south"]["state"]
    assert len(state["position"]) == scene.tracks.steps - scene.now == values["length"]
    np.testing.assert_allclose(state["position"][0, :2], scene.tracks.position_m[row, scene.now])
