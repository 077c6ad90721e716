import dataclasses

import numpy as np
import pytest
import scipy.spatial.distance
import scipy.stats

from deepmf_sumo import plugins
from deepmf_sumo.deepmf.policy import Settings, build
from deepmf_sumo.judge import metrics
from deepmf_sumo.judge.metrics import _slices, naturalness
from deepmf_sumo.judge.metrics.driving import possible
from deepmf_sumo.scene import Driver, Plan
from deepmf_sumo.scene.road_users import ROAD_USERS

from tests.support import drawn_people
from tests.support.one_attacker import plan_of
from tests.support.predictor_doubles import Doubles, view_of
from tests.support.rollout_doubles import case_of, contact_of, rollout_of, straight

AV = straight(0, 0, 10)


def measured(name, rollout, case=None):
    return plugins.load("metrics", name).measure(rollout, case or case_of())


def with_opponent(path):
    return rollout_of({"av": AV, "b": path})


def test_accelerations_along_and_across():
    seconds = np.arange(40) * 0.1
    radius, speed = 20.0, 8.0
    angle = speed * seconds / radius
    circle = radius * np.stack([np.cos(angle), np.sin(angle)], -1)
    along, across = _slices.accelerations(circle, angle + np.pi / 2, 0.1)
    assert len(along) == 36
    np.testing.assert_allclose(across, speed**2 / radius, rtol=0.01)
    np.testing.assert_allclose(along, 0, atol=1e-6)
    line = straight(0, 0, 5, steps=30, accel=2.0, now=0)
    along, across = _slices.accelerations(line[:, :2], line[:, 2], 0.1)
    np.testing.assert_allclose(along, 2.0, atol=1e-9)
    np.testing.assert_allclose(across, 0.0, atol=1e-9)
    assert len(_slices.accelerations(line[:4, :2], line[:4, 2], 0.1).along) == 0


def test_runs():
    mask = np.array([1, 0, 1, 1, 0, 0, 1], bool)
    assert _slices.runs(mask) == [slice(0, 1), slice(2, 4), slice(6, 7)]
    assert _slices.runs(np.zeros(3, bool)) == []


@pytest.mark.parametrize(("accel", "expected"), [(0.0, 1.0), (7.5, 1.0), (8.5, 0.0), (-8.5, 0.0)])
def test_feasible_along(accel, expected):
    path = straight(-8, 3.5, 80, accel=accel)
    assert measured("feasible", with_opponent(path)).value == expected


@pytest.mark.parametrize(("speed", "expected"), [(9.5, 1.0), (10.5, 0.0)])
def test_feasible_across(speed, expected):
    angle = speed * (np.arange(91) - 10) * 0.1 / 20.0  # 5 m/s2 at 10 m/s
    circle = 20 * np.stack([np.cos(angle), np.sin(angle)], -1)
    path = np.concatenate([circle, (angle + np.pi / 2)[:, None]], axis=1)
    assert measured("feasible", with_opponent(path)).value == expected


def test_a_jump_to_the_first_pose_is_not_feasible():
    path = straight(-8, 3.5, 12)
    path[11:, 1] += 0.4
    assert measured("feasible", with_opponent(path)).value == 0.0


def test_a_jump_right_before_the_contact_is_not_feasible():
    path = straight(-8, 3.5, 12)[:13]
    path[12, 1] = 0.0  # the second driven pose: too few for second differences over 0.2 s
    hit = rollout_of({"av": AV[:13], "b": path}, contacts=[contact_of(step=12)])
    assert measured("feasible", hit).value == 0.0
    assert measured("feasible", rollout_of({"av": AV[:12], "b": path[:12]})).value == 1.0


def test_jumping_to_and_fro_is_not_feasible():
    path = straight(-8, 3.5, 12)
    path[12::2, 1] += 0.3  # unseen by differences over 0.2 s
    assert measured("feasible", with_opponent(path)).value == 0.0


@pytest.mark.parametrize(("degrees", "expected"), [(0, 1.0), (25, 1.0), (35, 0.0), (180, 1.0)])
def test_a_car_does_not_slide_sideways(degrees, expected):
    path = straight(-8, 3.5, 12)
    path[:, 2] += np.radians(degrees)  # 180: it drives backwards
    assert measured("feasible", with_opponent(path)).value == expected


@pytest.mark.parametrize(("radius", "expected"), [(4.0, 1.0), (2.5, 0.0)])
def test_a_car_does_not_turn_on_the_spot(radius, expected):
    angle = 3.0 * (np.arange(91) - 10) * 0.1 / radius
    circle = radius * np.stack([np.cos(angle), np.sin(angle)], -1)
    path = np.concatenate([circle, (angle + np.pi / 2)[:, None]], axis=1)
    assert measured("feasible", with_opponent(path)).value == expected
    standing = straight(-8, 3.5, 0)
    standing[11:, 2] = np.linspace(0, 2 / radius, 80)
    assert measured("feasible", with_opponent(standing)).value == 1.0
    standing[40:, 2] += np.pi / 2
    assert measured("feasible", with_opponent(standing)).value == 0.0


def test_rms_acceleration():
    slowing = straight(-8, 3.5, 40, accel=-1.5)
    value = measured("opponent_rms_acceleration", with_opponent(slowing)).value
    assert value == pytest.approx(1.5, abs=0.01)


def test_hardest_braking_of_the_av():
    path = straight(0, 0, 10)
    seconds = np.clip((np.arange(91) - 30) * 0.1, 0, 1.0)
    path[:, 0] -= 3.0 * seconds**2  # 6 m/s2 for a second, then constant speed again
    path[41:, 0] -= 6.0 * (np.arange(41, 91) - 40) * 0.1
    rollout = rollout_of({"av": path, "b": straight(-8, 3.5, 12)})
    assert measured("planner_hardest_braking", rollout).value == pytest.approx(6.0, abs=0.01)
    assert measured("planner_hardest_braking", with_opponent(AV)).value == pytest.approx(0.0)


def test_distance_to_the_recording():
    away = straight(0, 0, 10)
    away[11:, 1] = 2.0
    rollout = rollout_of({"av": away, "b": straight(-8, 3.5, 12)})
    assert measured("av_ade", rollout).value == pytest.approx(2.0)
    shorter = rollout_of({"av": away[:31], "b": straight(-8, 3.5, 12)[:31]})
    assert measured("av_ade", shorter).value == pytest.approx(2.0)


def test_paths_of_plan_and_recording():
    beside = straight(-8, 3.5, 12)
    beside[11:, 1] += 1.0
    rollout = with_opponent(beside)
    assert measured("path_sspd", rollout).value == pytest.approx(1.0, abs=0.02)
    assert measured("path_hausdorff", rollout).value == pytest.approx(1.0, abs=0.02)
    assert measured("acceleration_wasserstein", rollout).value == pytest.approx(0.0, abs=1e-6)
    assert measured("acceleration_kl", rollout).value == pytest.approx(0.0, abs=1e-6)


def test_the_last_plan_completes_a_path_cut_off_by_the_contact():
    whole = straight(-8, 3.5, 12)
    plan = Plan(
        agent_id="b",
        first_step=11,
        position_m=whole[11:, :2],
        heading_rad=whole[11:, 2],
        speed_mps=np.full(80, 12.0),
    )
    cut = {"av": AV[:31], "b": whole[:31]}
    rollout = rollout_of(cut, contacts=[contact_of(step=30)], plans=[plan])
    assert measured("path_hausdorff", rollout).value == pytest.approx(0.0, abs=1e-9)
    late = dataclasses.replace(plan, position_m=plan.position_m + np.array([0.0, 2.0]))
    rollout = rollout_of(cut, contacts=[contact_of(step=30)], plans=[late])
    assert measured("path_hausdorff", rollout).value == pytest.approx(2.0, abs=1e-9)
    assert measured("path_hausdorff_cut", rollout).value == pytest.approx(0.0, abs=1e-9)


def test_hausdorff_against_scipy_on_dense_points():
    rng = np.random.default_rng(3)
    a, b = (rng.normal(size=(400, 2)).cumsum(0) * 0.02 for _ in range(2))
    both = [scipy.spatial.distance.directed_hausdorff(*pair)[0] for pair in ((a, b), (b, a))]
    assert naturalness.hausdorff(a, b) == pytest.approx(max(both), abs=0.05)
    assert naturalness.symmetric_mean(a, b) <= naturalness.hausdorff(a, b)


def test_metrics_of_plans():
    view = view_of({"av": (0, 0, 0, 10.0), "b": (-8, 3.5, 0, 12.0)})
    policy = build(Settings(), Doubles())
    policy.reset(view, np.random.default_rng(0))
    plans = [
        plan_of(policy, view),
        plan_of(policy, view_of({"av": (0, 0, 0, 10.0), "b": (-8, 3.5, 0, 12.0)}, steps_left=5)),
    ]
    rollout = rollout_of({"av": AV, "b": straight(-8, 3.5, 12)}, plans=plans)
    assert measured("colliding_plans", rollout).value == 0.5
    reason = plans[0].reason
    mass = reason.reactions[reason.chosen].probability @ reason.collides[reason.chosen]
    assert 0.0 < mass < 1.0
    assert measured("predicted_contact", rollout).value == pytest.approx(mass)
    shares = [plan.reason.candidates.probability for plan in plans]
    expected = np.mean([np.exp(scipy.stats.entropy(share)) for share in shares])
    assert measured("candidate_perplexity", rollout).value == pytest.approx(expected)
    assert (
        "does not report"
        in measured("colliding_plans", with_opponent(straight(-8, 3.5, 12))).reason
    )
    assert measured("predicted_contact", with_opponent(straight(-8, 3.5, 12))).value is None


def test_a_gap_in_the_recording_is_no_change_of_speed():
    case, steady = case_of(), straight(-8, 3.5, 12)
    tracks = case.scene.tracks
    valid = tracks.valid.copy()
    valid[tracks.row("b"), 40:50] = False
    scene = dataclasses.replace(case.scene, tracks=dataclasses.replace(tracks, valid=valid))
    gappy = dataclasses.replace(case, scene=scene)
    found = naturalness.samples(with_opponent(steady), gappy, smooth=False)
    assert len(found.unattacked) == (29 - 2) + (41 - 2)
    np.testing.assert_allclose(found.unattacked, 0.0, atol=1e-9)
    assert len(naturalness.speed_changes(steady[:1, :2], 0.1)) == 0


def test_reasons_tell_a_missing_recording_from_one_that_is_too_short():
    paths_to = {"av": AV[:13], "b": straight(-8, 3.5, 12)[:13]}
    soon = rollout_of(paths_to, contacts=[contact_of(step=12)])
    assert measured("path_sspd_cut", soon).reason == _slices.TOO_SHORT
    assert measured("acceleration_kl", soon).reason == _slices.TOO_SHORT  # no plan, two poses
    unknown = case_of({"av": AV, "c": straight(-8, 3.5, 12)})
    waits = dataclasses.replace(soon, driver=np.full(soon.driver.shape, Driver.LOG))
    for name in ("path_sspd", "acceleration_kl"):
        assert measured(name, soon, unknown).reason == _slices.NO_REFERENCE
        assert measured(name, waits).reason == _slices.NEVER_DRIVEN


def person_driven(path, kind="pedestrian"):
    size = {"pedestrian": (0.5, 0.5, 1.75), "cyclist": (1.8, 0.8, 1.75)}[kind]
    return drawn_people.episode(AV, drawn_people.Drawn(path, kind, size)).rollout


@pytest.mark.parametrize(("kind", "accel", "expected"), [
    ("pedestrian", 3.5, 1.0), ("pedestrian", 4.5, 0.0), ("pedestrian", -3.5, 1.0),
    ("pedestrian", -4.5, 0.0), ("cyclist", 3.5, 1.0), ("cyclist", 4.5, 0.0),
    ("cyclist", -6.5, 1.0), ("cyclist", -7.5, 0.0),
])  # fmt: skip
def test_people_speed_up_and_brake_within_limits_of_their_class(kind, accel, expected):
    """A pulse of 1 s: second differences over 0.5 s see it at full height in its middle."""
    speed = np.full(91, 8.0 if accel < 0 and kind == "cyclist" else 4.0 if accel < 0 else 0.0)
    if accel > 0:
        change = np.clip((np.arange(91) - 20) * 0.1, 0, 0.95) * accel
    else:
        change = np.clip((np.arange(91) - 20) * 0.1, 0, speed[0] / -accel) * accel
    along = np.cumsum(speed + change) * 0.1
    path = np.stack([along, np.full(91, 20.0), np.zeros(91)], -1)
    assert measured("feasible", person_driven(path, kind)).value == expected


def test_a_pedestrian_turns_on_the_spot_and_walks_back_but_a_cyclist_does_not():
    speed = np.interp(np.arange(91), [0, 20, 28, 36, 90], [1.4, 1.4, 0.0, -1.4, -1.4])
    along = np.cumsum(speed) * 0.1
    path = np.stack([along, np.full(91, 20.0), np.where(speed < 0, np.pi, 0.0)], -1)
    assert measured("feasible", person_driven(path)).value == 1.0
    angle = 3.0 * np.arange(91) * 0.1 / 0.9  # 3 m/s on a circle of 0.9 m: 10 m/s2 across
    circle = 0.9 * np.stack([np.cos(angle), np.sin(angle)], -1) + [0, 20]
    path = np.concatenate([circle, (angle + np.pi / 2)[:, None]], axis=1)
    assert measured("feasible", person_driven(path, "cyclist")).value == 0.0


@pytest.mark.parametrize(("kind", "speed", "expected"), [
    ("pedestrian", 4.3, 1.0), ("pedestrian", 4.5, 0.0), ("cyclist", 10.3, 1.0),
    ("cyclist", 10.5, 0.0),
])  # fmt: skip
def test_nobody_is_faster_than_its_class(kind, speed, expected):
    assert measured("feasible", person_driven(straight(0, 20, speed), kind)).value == expected


def test_a_measured_box_trembles_but_a_driven_one_does_not():
    for step, expected in ((10, 1.0), (30, 0.0)):  # the last measured pose, a driven one
        path = straight(0, 20, 1.4)
        path[step, 1] += 0.1  # 0.1 m to where its speed leads, and 0.2 m back
        assert measured("feasible", person_driven(path)).value == expected


@pytest.mark.parametrize(
    ("kind", "size"), [("pedestrian", (0.5, 0.5, 1.75)), ("cyclist", (1.8, 0.8, 1.75))]
)
def test_no_metric_fails_for_people(kind, size):
    for path in (
        drawn_people.walks(30, -4.0, (9, 1.4)),
        drawn_people.stands(30, 0),
        drawn_people.walks(30, 40, (9, 1.4)),
    ):
        found = drawn_people.episode(AV, drawn_people.Drawn(path, kind, size))
        for one in metrics.measure(found.rollout, found.case):
            assert (one.value is None) == bool(one.reason), one.name
            assert one.value is None or np.isfinite(one.value), one.name


def test_boxes_of_people_tremble_by_centimetres():
    """4.5 cm to and fro every 0.2 s: 4.5 m/s2 over 0.2 s, and at most 0.72 over 0.5 s."""
    path = straight(0, 20, 1.4)
    path[:, 1] += 0.045 * np.where(np.arange(91) % 4 < 2, 1, -1)
    pose = path[:, :2], path[:, 2], 0.1
    assert possible(ROAD_USERS["pedestrian"], *pose)
    _, across = _slices.accelerations(*pose)
    assert np.abs(across).max() > ROAD_USERS["pedestrian"].motion.possible.lateral
