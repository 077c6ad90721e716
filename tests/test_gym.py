"""The Gymnasium environment: its rules, equal tracks, and how episodes end."""

import importlib
import sys
from dataclasses import replace
from types import MappingProxyType, SimpleNamespace

import numpy as np
import pytest

from deepmf_sumo import spec
from deepmf_sumo.errors import PlannerError, PluginError, UsageError
from deepmf_sumo.judge.metrics import NotMeasurable
from deepmf_sumo.scene import Command, Driver, Lane, RoadMap
from deepmf_sumo.spec import tasks
from deepmf_sumo.study.sweep import episode
from deepmf_sumo.sumo.simulation.sumo_api import sumo_seed

from tests.support import tiny_network
from tests.support.predictor_doubles import view_of
from tests.support.rollout_doubles import case_of, rollout_of, straight

pytestmark = pytest.mark.sumo

MODULE = "deepmf_sumo.gym"


@pytest.fixture
def make():
    """Environments that are closed whatever happens: there is one simulation a process."""
    pytest.importorskip("gymnasium")
    made = []

    def new(loaded, step_s=0.1):
        made.append(importlib.import_module(MODULE).AttackEnv(loaded, step_s=step_s))
        return made[-1]

    yield new
    for environment in made:
        environment.close()


@pytest.fixture
def loaded(tiny):
    planner = "{name: idm, perception: corridor}"
    return spec.load(tiny_network.spec(tiny, "stepped", planner=planner, duration_s="3.0"))


def test_without_gymnasium_it_says_what_to_install(monkeypatch):
    monkeypatch.delitem(sys.modules, MODULE, raising=False)
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(PluginError, match=r"install deepmf-sumo\[gym\]"):
        importlib.import_module(MODULE)


@pytest.mark.filterwarnings("ignore:.*we recommend using a symmetric and normalized space")
@pytest.mark.filterwarnings("ignore:.*Box observation space m..imum value is .*infinity")
def test_it_keeps_gymnasiums_rules(loaded):
    check_env = pytest.importorskip("gymnasium.utils.env_checker").check_env
    gymnasium = importlib.import_module("gymnasium")
    for mode in (None, "rgb_array"):
        name = f"{MODULE}:deepmf_sumo/Attack-v0"
        environment = gymnasium.make(name, spec=loaded, render_mode=mode)
        try:
            check_env(environment.unwrapped)
        finally:
            environment.close()


def test_a_longer_step_repeats_the_action(make, loaded):
    """Twin: the same acceleration in ten steps, and what is left of the episode in one."""
    for action in ([1.0], Command(kind="speed", speed_mps=4.0)):
        short, long = make(loaded), make(loaded, 1.0)
        short.reset(seed=3)
        found = [short.step(action) for _ in range(30)]
        long.reset(seed=3)
        for second in range(3):
            observation, reward, *ends, info = long.step(action)
            last = found[10 * second + 9]
            assert reward == pytest.approx(sum(one[1] for one in found[10 * second :][:10]))
            assert (ends, info) == (list(last[2:4]), last[4])
            for name, values in last[0].items():
                np.testing.assert_array_equal(observation[name], values)
        assert ends == [False, True]


@pytest.mark.parametrize("step_s", [0.0, 0.15, -1.0, float("nan"), float("inf"), "1", None])
def test_a_step_is_a_multiple_of_a_tenth(make, loaded, step_s):
    with pytest.raises(UsageError, match="step_s"):
        make(loaded, step_s)


def test_the_same_idm_through_the_door_drives_the_same(make, loaded):
    (task,) = tasks.plan([loaded], cache=None)
    case = episode.make_case(task, None)
    direct = episode.attack_case(task, case).rollout
    environment = make(loaded)
    for _ in range(2):
        planner = episode.planner_of(task)
        environment.reset(seed=loaded.seed)
        planner.reset(environment.case, np.random.default_rng(0))
        ended = steps = 0
        while not ended:
            _, _, *flags, info = environment.step(planner.act(environment.view))
            ended, steps = any(flags), steps + 1
        through = environment.attack.rollout
        assert info == {
            "run_id": task.run_id, "step": 40, "outcome": "none", "ended": "time",
            "opponent": through.opponent_id,
        }  # fmt: skip
        assert steps == 30
        assert flags == [False, True]
        assert direct.tracks.position_m.tobytes() == through.tracks.position_m.tobytes()
        assert direct.leaders == through.leaders


def test_accelerations_are_driven_and_a_contact_ends_it(make, tiny):
    path = tiny_network.spec(tiny, "racing", planner="sumo", duration_s="20.0")
    environment = make(path)
    observation, _ = environment.reset()
    assert observation["path"][:3, 1] == pytest.approx([7.5, 12.5, 17.5], abs=0.6)
    assert observation["agents"][0, 0] == 1.0
    assert 20.0 < observation["agents"][0, 1] < 60.0
    assert not observation["agents"][1:].any()
    speeds, rewards = [observation["av"][0]], []
    ended = False
    while not ended:
        observation, reward, terminated, late, _ = environment.step(np.array([2.0], np.float32))
        speeds.append(observation["av"][0])
        rewards.append(reward)
        ended = terminated or late
    assert np.diff(speeds[:10]) == pytest.approx(0.2, abs=0.01)
    rollout = environment.attack.rollout
    av = rollout.tracks.row(rollout.av_id)
    there = rollout.tracks.valid[av, rollout.now + 1 :]
    assert (rollout.driver[av, rollout.now + 1 :][there] == Driver.PLANNER).all()
    assert rollout.contacts
    speeds = np.array(speeds)
    driven = 0.01 * 0.1 * speeds[1:-1] - 0.005 * 0.1 * (np.diff(speeds[:-1]) / 0.1) ** 2
    assert rewards[:-1] == pytest.approx(driven, abs=2e-3)
    assert -1.1 < rewards[-1] < -0.9
    with pytest.raises(UsageError, match="call reset first"):
        environment.step(np.zeros(1))


@pytest.mark.parametrize("action", [[np.nan], [np.inf], [-np.inf], [], [1.0, 2.0]])
def test_an_action_that_is_no_acceleration_is_refused_and_the_episode_goes_on(make, loaded, action):
    environment = make(loaded)
    environment.reset()
    for given in (np.array(action, np.float32), "brake", None, [[1.0], [2.0, 3.0]]):
        with pytest.raises(UsageError, match="must be one finite acceleration"):
            environment.step(given)
    assert environment.step(np.zeros(1, np.float32))[1] != 0.0


def test_seeds_of_learning_libraries_fit_and_small_ones_are_sumos(make, loaded):
    assert [sumo_seed(seed) for seed in (0, 42, 2**31 - 1)] == [0, 42, 2**31 - 1]
    environment = make(loaded)
    for seed in (2**31, 2**32 - 1):
        seen = [environment.reset(seed=seed)[0]["agents"].tobytes() for _ in range(2)]
        assert seen[0] == seen[1]


def test_one_episode_a_process(make, loaded):
    one, other = make(loaded), make(loaded)
    one.reset()
    other.reset()
    with pytest.raises(UsageError, match="AsyncVectorEnv"):
        one.step(np.zeros(1))
    other.step(np.zeros(1))
    other.close()
    other.close()  # twice does no harm
    with pytest.raises(UsageError, match="call reset first"):
        other.step(np.zeros(1))
    one.reset()
    one.step(np.zeros(1))


def test_an_error_is_raised_and_the_next_episode_runs(make, tiny, loaded):
    environment = make(loaded)
    environment.reset()
    with pytest.raises(PlannerError, match="speed_mps at step 10 is nan"):
        environment.step(Command(kind="speed", speed_mps=float("nan")))
    environment.reset(options={"scene": "tiny"})
    with pytest.raises(UsageError, match=r"no scene 'huge'; e.g. tiny"):
        environment.reset(options={"scene": "huge"})
    environment.reset()
    environment.close()


def test_gymnasium_knows_it_by_its_id(make, loaded):
    gymnasium = pytest.importorskip("gymnasium")
    environment = gymnasium.make(
        "deepmf_sumo.gym:deepmf_sumo/Attack-v0", spec=loaded, render_mode="rgb_array",
        reward={"progress": 1.0, "comfort": 0.0},
    )  # fmt: skip
    try:
        observation, _ = environment.reset(seed=3)
        before = environment.render()
        assert (before.shape, before.dtype) == ((480, 480, 3), np.uint8)
        _, reward, *_ = environment.step(np.zeros(1, np.float32))
        assert reward == pytest.approx(0.1 * observation["av"][0], rel=0.02)
        assert (environment.render() != before).any()
    finally:
        environment.close()


def test_several_at_a_time_are_processes(loaded):
    gymnasium = pytest.importorskip("gymnasium")
    name = "deepmf_sumo.gym:deepmf_sumo/Attack-v0"
    environments = gymnasium.make_vec(
        name, num_envs=2, vectorization_mode="async", spec=loaded,
        vector_kwargs={"context": "spawn"},
    )  # fmt: skip
    try:
        observation, _ = environments.reset(seed=1)
        assert observation["av"].shape == (2, 3)
        _, reward, *_ = environments.step(np.zeros((2, 1), np.float32))
        assert reward.shape == (2,)
    finally:
        environments.close()


def test_a_contact_that_nobody_could_avoid_may_count_for_nothing(make, tiny, monkeypatch):
    module = importlib.import_module(MODULE)
    path = tiny_network.spec(tiny, "racing", planner="sumo", duration_s="20.0")
    rewards = {}
    for judged in (0.0, 1.0):
        monkeypatch.setattr(module, "_counts", lambda *_, judged=judged: judged > 0)
        environment = make(path)
        environment._reward = module.Reward(progress=0.0, comfort=0.0, findings_only=True)
        environment.reset()
        ended = False
        while not ended:
            _, reward, terminated, late, _ = environment.step(np.array([2.0], np.float32))
            ended = terminated or late
        rewards[judged] = reward
    assert rewards == {0.0: 0.0, 1.0: -1.0}


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"reward": {"comfrot": 1}}, "can have progress, comfort"),
        ({"reward": {"comfort": float("nan")}}, "comfort nan; it must be a finite number"),
        ({"reward": {"contact": "1"}}, "contact '1'; it must be a finite number"),
        ({"render_mode": "human"}, "rgb_array"),
    ],
)
def test_wrong_settings_are_refused(loaded, keys, told):
    pytest.importorskip("gymnasium")
    with pytest.raises(UsageError, match=told):
        importlib.import_module(MODULE).AttackEnv(loaded, **keys)


def test_a_contact_that_cannot_be_judged_counts(monkeypatch):
    """E.g. with another vehicle than the opponent: that nobody could avoid it is not known."""
    module = importlib.import_module(MODULE)
    hit = SimpleNamespace(contacts=[SimpleNamespace(kind="av_other")])
    monkeypatch.setattr(module.ladder, "verdict", _not_measurable)
    monkeypatch.setattr(module, "Episode", lambda *_: None)
    for only in (True, False):
        assert module.Reward(findings_only=only).of_end(hit, None) == -module.Reward().contact
    assert module.Reward().contact > 0
    assert module.Reward(findings_only=True).of_end(SimpleNamespace(contacts=[]), None) == 0.0


def _not_measurable(_):
    raise NotMeasurable("the opponent did not hit the AV")


@pytest.mark.parametrize(("finding", "counts"), [(None, True), (True, True), (False, False)])
def test_of_hits_of_the_opponent_findings_may_count_alone(monkeypatch, finding, counts):
    """Without a verdict, as of a contact with another vehicle, it counts."""
    module = importlib.import_module(MODULE)
    verdict = None if finding is None else SimpleNamespace(finding=finding)
    monkeypatch.setattr(module.ladder, "verdict", lambda _: verdict)
    monkeypatch.setattr(module, "Episode", lambda *_: None)
    hit = SimpleNamespace(contacts=[SimpleNamespace(kind="av_opponent")])
    assert (module.Reward(findings_only=True).of_end(hit, None) < 0) == counts
    assert module.Reward().of_end(hit, None) < 0


def test_a_vehicle_on_the_bridge_above_is_not_observed():
    pytest.importorskip("gymnasium")
    ends = ((-100, 0), (100, 0), 0.0), ((0, -100), (0, 100), 8.0)
    lanes = [
        Lane(
            id=f"{z}", kind="street", centre_m=np.array([a, b], float), z_m=np.full(2, z), width_m=3
        )
        for a, b, z in ends
    ]
    view = view_of({"av": (-9, 0, 0, 10.0), "over": (0, 5, 0, 9.0), "ahead": (20, 0, 0, 8.0)})
    tracks = view.history
    heights = np.where(np.arange(3) == tracks.row("over"), 8.0, 0.0)[:, None]
    for z_m, seen in ((heights, ["ahead"]), (0.0 * heights, ["over", "ahead"])):
        history = replace(tracks, z_m=np.repeat(z_m, tracks.steps, axis=1))
        road = RoadMap(lanes={one.id: one for one in lanes})
        observer = importlib.import_module(MODULE).ObservationBuilder(4)
        agents = observer.observe(replace(view, history=history, road=road))["agents"]
        at = {"over": (9.0, 5.0), "ahead": (29.0, 0.0)}
        assert [tuple(row[1:3]) for row in agents.tolist() if row[0]] == [at[one] for one in seen]


@pytest.mark.parametrize(("in_sight", "seen"), [(False, ["truck", "child"]), (True, ["truck"])])
def test_the_last_observation_shows_no_more_than_the_ones_before(in_sight, seen):
    """A child stands behind a truck beside the lane; both are to the AV's right."""
    pytest.importorskip("gymnasium")
    paths = {"av": straight(0, 0, 0.0), "truck": straight(20, -3.6, 0.0)}
    rollout = rollout_of({**paths, "child": straight(30, -6.0, 0.0)}, opponent_id="child")
    tracks = rollout.tracks
    size = [(4.8, 2.0, 1.5), (12.0, 2.5, 3.5), (0.5, 0.5, 1.2)]
    tracks = replace(tracks, size_m=np.array(size))
    rollout = replace(rollout, tracks=tracks, signals=(MappingProxyType({}),))
    observer = importlib.import_module(MODULE).ObservationBuilder(4)
    case = replace(case_of(), in_sight=in_sight)
    agents = observer.observe(observer.last_view(rollout, case))["agents"]
    at = {"truck": (20.0, -3.6), "child": (30.0, -6.0)}
    places = [(round(x, 3), round(y, 3)) for there, x, y, *_ in agents.tolist() if there]
    assert places == [at[one] for one in seen]
