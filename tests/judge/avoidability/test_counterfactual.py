"""Same motion, same grade: whatever made the attack, and whatever world it happened in."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.judge import metrics
from deepmf_sumo.judge.avoidability import grading
from deepmf_sumo.judge.avoidability.counterfactual import counterfactual, unrepeated_m
from deepmf_sumo.judge.avoidability.encounter import onset_step
from deepmf_sumo.scene import Budget, Forecast, Futures, Plan, PlanReason, RoadMap

from tests.attacks.test_policies_of_the_package import NEEDED
from tests.support.drawn_attacks import NO_ROAD, NOW, attack
from tests.support.driven_world import World
from tests.support.rollout_doubles import case_of, in_traffic, rollout_of, straight, tracks_of
from tests.support.simulated_worlds import crossing_road, lane

AV, BESIDE = straight(0, 0, 10), straight(20, 3.5, 10)


def slow_cut_in():
    """(91, 3) from 2 s on slower, and over 5 s into the AV's lane."""
    steps = np.maximum(np.arange(91) - 30, 0)
    path = BESIDE.copy()
    path[:, 0] -= 0.3 * steps
    path[:, 1] -= 3.5 * np.minimum(steps / 50, 1)
    return path


def thought(path, first=NOW + 1):
    """What a plan says that the opponent would do: (91, 3) from a step on."""
    ahead = np.stack([path[first:]] * 2)
    futures = Futures(agent_id="b", position_m=ahead[..., :2], heading_rad=ahead[..., 2])
    none = np.zeros((2, 1))
    return PlanReason(
        scores=None, candidates=Forecast(futures=futures, probability=[0.6, 0.4]), reactions=(),
        collides=none > 0, collision_step=none, value=none[:, 0], product=none[:, 0], chosen=0,
        rule="expected", bent_m=none[:, 0], origin=("mode", "mode"),
    )  # fmt: skip


THOUGHTS = {"nothing": None, "the truth": thought(BESIDE), "elsewhere": thought(BESIDE + 50.0)}


def twins(rollout):
    """The same motion by plans that tell nothing, the truth, or something wrong."""
    return [
        replace(rollout, plans=tuple(replace(one, reason=reason) for one in rollout.plans))
        for reason in THOUGHTS.values()
    ]


def in_sumo(case):
    return replace(case, traffic="sumo")


@pytest.mark.parametrize("world", [in_traffic, in_sumo, lambda case: case])
def test_the_grade_is_that_of_the_motion(world):
    rollout, case = attack(AV, slow_cut_in(), log=BESIDE)
    case = replace(world(case), unattacked=tracks_of({"av": AV, "b": BESIDE}))
    found = [grading.judge(one, case) for one in twins(rollout)]
    assert found[0] == found[1] == found[2]
    # by hand: beside its own position by 0.5 m after 1 or 2 steps of 0.3 m
    assert found[0].onset_step == 32


OF_MOTION = ("avoidance_grade", "finding", "path_sspd_cut", "acceleration_wasserstein")
ADVERSARIES = [  # all that are found; two of them descend for seconds
    pytest.param(name, marks=[pytest.mark.slow] * (name in {"art", "strive"}))
    for name in plugins.names("adversaries")
]


@pytest.mark.parametrize("name", ADVERSARIES)
def test_no_metric_of_an_attack_asks_what_its_plan_expected(name):
    """Each adversary attacks; then its plans say something else, and the motion stays."""
    settings = plugins.settings("adversaries", name, NEEDED.get(name, {}))
    made = plugins.load("adversaries", name).build(settings, "open")
    world = World()
    done = made.attack(case_of(), world, Budget(simulations=2), np.random.default_rng(0)).rollout
    own = world(None).tracks
    for world_of in (in_traffic, in_sumo):
        case = replace(world_of(case_of()), unattacked=own)
        values = [
            [plugins.load("metrics", one).measure(rollout, case) for one in OF_MOTION]
            for rollout in (done, *twins(done))
        ]
        assert all(one == values[0] for one in values)


def test_with_sumo_in_a_recording_sumo_tells_what_would_have_been():
    """SUMO drives 2 m/s slower than the log; the attack begins with the swerve at step 60."""
    attacked = BESIDE.copy()
    attacked[:, 1] -= 3.5 * np.clip((np.arange(91) - 60) / 20, 0, 1)
    attacked[:, 0] -= 0.5 * np.maximum(np.arange(91) - 60, 0)
    log = straight(20, 3.5, 12)
    rollout = rollout_of({"av": AV, "b": attacked})
    case = in_sumo(case_of({"av": AV, "b": log}))
    case = replace(case, unattacked=tracks_of({"av": AV, "b": BESIDE}))
    assert counterfactual(rollout, case, "b").by == "episode"
    assert onset_step(rollout, case, rollout.tracks.row("b"), NOW, 78) == 61
    kept = metrics.measure(rollout, case)
    value = {one.name: one.value for one in kept}["path_sspd_cut"]
    same = replace(case, scene=case_of({"av": AV, "b": BESIDE}).scene)
    assert value == {one.name: one.value for one in metrics.measure(rollout, same)}["path_sspd_cut"]


def test_a_log_is_what_would_have_been_whatever_the_av_does():
    """Logged traffic does not react, so an AV that brakes changes nothing."""
    braking = straight(0, 0, 10, accel=-2.0)
    rollout = rollout_of({"av": braking, "b": slow_cut_in()})
    case = replace(case_of({"av": AV, "b": BESIDE}), unattacked=tracks_of({"b": BESIDE + 5.0}))
    alone = counterfactual(rollout, case, "b")
    assert alone.by == "log"
    np.testing.assert_array_equal(alone.position_m, BESIDE[:, :2])
    # an earlier turn took the opponent elsewhere: the log is not where it comes from
    elsewhere = rollout_of({"av": braking, "b": slow_cut_in() + np.array([0.1, 0, 0])})
    assert counterfactual(elsewhere, case, "b").by == "lane"


@pytest.mark.parametrize("moved", ["av", "b"])
def test_an_episode_that_went_another_way_before_tells_nothing(moved):
    """An earlier attack has moved one of the two: the later one begins in another world."""
    paths = {"av": AV, "b": slow_cut_in()}
    case = replace(in_traffic(case_of()), unattacked=tracks_of({"av": AV, "b": BESIDE}))
    assert counterfactual(rollout_of(paths), case, "b").by == "episode"
    paths[moved] = paths[moved] + np.array([0.1, 0, 0])
    alone = counterfactual(rollout_of(paths), case, "b")
    assert alone.by == "lane"
    found = {one.name: one for one in metrics.measure(rollout_of(paths), case)}
    assert found["path_sspd"].value is None
    assert found["path_sspd"].reason == "the opponent's motion without the attack is not known"


def test_without_an_episode_the_opponent_keeps_lane_and_speed():
    """Lanes of 3.5 m around y = 0 and 3.5: 0.3 m beside the middle, then 1 m/s towards the AV."""
    path = straight(20, 3.8, 10)
    aside = 0.1 * np.maximum(np.arange(91) - 30, 0)
    path[:, 1] -= aside
    rollout = rollout_of({"av": AV, "b": path})
    case = in_traffic(case_of())
    alone = counterfactual(rollout, case, "b")
    assert alone.by == "lane"
    assert not alone.known[:NOW].any()
    np.testing.assert_allclose(alone.position_m[NOW:], straight(20, 3.8, 10)[NOW:, :2])
    np.testing.assert_allclose(alone.away_m(path[:, :2], 0)[NOW:], aside[NOW:], atol=1e-9)
    # speeds of the double are those of the step before, 12 m/s until it brakes
    braking = straight(60, 3.5, 12, accel=-3.0)
    alone = counterfactual(rollout_of({"av": AV, "b": braking}), case, "b")
    np.testing.assert_allclose(
        alone.away_m(braking[:, :2], 0)[NOW:], 1.5 * (0.1 * np.arange(81)) ** 2, atol=1e-9
    )


def test_lanes_go_on_at_junctions_and_past_the_end_of_the_map():
    road = crossing_road()
    through = straight(-60, 0, 20)
    case = replace(in_traffic(case_of()), road=road)
    for x, y, heading in [(-60, 0, 0.0), (0, -60, np.pi / 2), (290, 0, 0.0)]:
        rollout = rollout_of({"av": AV + 500, "b": straight(x, y, 20, heading=heading)})
        alone = counterfactual(rollout, case, "b")
        assert alone.known[NOW:].all()
        np.testing.assert_allclose(
            alone.position_m[NOW:], rollout.tracks.position_m[1, NOW:], atol=1e-9
        )
    turning = through.copy()
    turning[60:, 1] += np.arange(31)
    rollout = rollout_of({"av": AV + 500, "b": turning})
    alone = counterfactual(rollout, case, "b")
    np.testing.assert_allclose(alone.away_m(turning[:, :2], 0)[60:], np.arange(31), atol=1e-9)


def test_it_follows_the_lanes_where_they_bend_and_branch():
    """A quarter circle of 40 m to either side after a straight: the vehicle takes the left one."""
    angle = np.linspace(0, np.pi / 2, 41)
    bend = 40 * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    after = lane("before", (-100, 0), (0, 0), next=("left", "right"))
    left = replace(after, id="left", centre_m=bend, next=())
    right = replace(after, id="right", centre_m=bend * [1, -1], next=())
    road = RoadMap(lanes={one.id: one for one in (after, left, right)})
    way = 8 * 0.1 * (np.arange(91) - 40)
    turned = np.clip(way / 40, 0, np.pi / 2)
    beyond = np.maximum(way - 20 * np.pi, 0)
    x, y = np.minimum(way, 0) + 40 * np.sin(turned), 40 * (1 - np.cos(turned)) + beyond
    rollout = rollout_of({"av": AV + 500, "b": np.column_stack([x, y, turned])})
    alone = counterfactual(rollout, replace(in_traffic(case_of()), road=road), "b")
    assert alone.known[NOW:].all()
    assert alone.away_m(np.column_stack([x, y]), 0).max() < 0.02  # chords of 1.6 m
    late = np.arange(91) > 60
    cut = np.column_stack([x + late * np.sin(turned), y - late * np.cos(turned)])  # 1 m outwards
    gone = rollout_of({"av": AV + 500, "b": np.column_stack([cut, turned])})
    alone = counterfactual(gone, replace(in_traffic(case_of()), road=road), "b")
    np.testing.assert_allclose(alone.away_m(cut, 0)[61:], 1.0, atol=0.02)


@pytest.mark.parametrize(("z_m", "away_m"), [(6.0, 0.0), (0.0, 160 * np.sin(np.pi / 18))])
def test_the_lane_is_that_of_the_level_on_which_the_vehicle_is(z_m, away_m):
    """A bridge crosses a road by 20 degrees; the vehicle is 0.2 m beside the middle of both."""
    turn = np.pi / 9
    way = 200 * np.array([np.cos(turn), np.sin(turn)])
    under = lane("under", (-200, 0), (200, 0))
    bridge = replace(lane("bridge", -way, way), z_m=np.full(41, 6.0))
    road = RoadMap(lanes={"under": under, "bridge": bridge})
    path = straight(-0.2 * np.sin(turn), 0.2 * np.cos(turn), 10, heading=turn)
    rollout = rollout_of({"av": AV + 500, "b": path})
    tracks = replace(rollout.tracks, z_m=np.full(rollout.tracks.valid.shape, z_m))
    case = replace(in_traffic(case_of()), road=road)
    alone = counterfactual(replace(rollout, tracks=tracks), case, "b")
    found = alone.away_m(path[:, :2], 0)
    np.testing.assert_allclose(found[-1], away_m, atol=1e-6)


def test_on_no_lane_nothing_is_known():
    rollout = rollout_of({"av": AV, "b": slow_cut_in()})
    case = replace(in_traffic(case_of()), road=NO_ROAD)
    assert not counterfactual(rollout, case, "b").known.any()
    oncoming = rollout_of({"av": AV, "b": straight(60, 3.5, 10, heading=np.pi)})
    assert not counterfactual(oncoming, in_traffic(case_of()), "b").known.any()


def test_a_plan_of_another_shape_changes_nothing():
    """A rollout whose plan is missing is judged by its motion, too."""
    rollout, case = attack(AV, slow_cut_in(), log=BESIDE)
    case = replace(in_traffic(case), unattacked=tracks_of({"av": AV, "b": BESIDE}))
    short = Plan(agent_id="b", first_step=NOW + 1, position_m=slow_cut_in()[NOW + 1 : 40, :2],
                 heading_rad=np.zeros(29), speed_mps=np.full(29, 9.0))  # fmt: skip
    onsets = {
        grading.judge(replace(rollout, plans=plans), case).onset_step
        for plans in ((), (short,), rollout.plans)
    }
    assert onsets == {32}


def later(path, step, metres):
    """A path that is this much farther on from a step on."""
    moved = path.copy()
    moved[step:, 0] += metres
    return moved


@pytest.mark.parametrize(
    ("av_step", "other_step", "expected"),
    [
        (None, None, None),
        (12, None, (12, 0.5)),
        (12, 30, (12, 0.5)),
        (30, 30, (30, 0.5)),  # what the AV does in a step was decided before the step
        (31, 30, None),  # it answers to what is elsewhere
    ],
)
def test_a_planner_that_does_not_repeat_what_it_did_is_found(av_step, other_step, expected):
    """With the opponent where it is without the attack, the planner sees the same."""
    av = AV if av_step is None else later(AV, av_step, 0.5)
    other = BESIDE if other_step is None else later(BESIDE, other_step, 0.2)
    case = replace(in_traffic(case_of()), unattacked=tracks_of({"av": AV, "b": BESIDE}))
    found = unrepeated_m(rollout_of({"av": av, "b": other}), case)
    assert found == (expected if expected is None else pytest.approx(expected))
    assert unrepeated_m(rollout_of({"av": av, "b": other}), in_traffic(case_of())) is None
