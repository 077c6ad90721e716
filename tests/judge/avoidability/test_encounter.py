"""How a rollout becomes a question: onset, the opponent's motion, the AV's path."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.judge.avoidability import av_path, grading, reference_drivers
from deepmf_sumo.judge.avoidability.av_path import route_ahead
from deepmf_sumo.judge.avoidability.counterfactual import counterfactual
from deepmf_sumo.judge.avoidability.encounter import AFTER_S, encounter_of, third_parties_of
from deepmf_sumo.scene import Plan, Scene, readers
from deepmf_sumo.scene.geometry import polylines

from tests.support.drawn_attacks import NO_ROAD, NOW, attack, cut_in
from tests.support.rollout_doubles import (
    case_of,
    contact_of,
    in_traffic,
    rollout_of,
    straight,
    tracks_of,
)


class Unaware:
    """Never sees a risk."""

    def respond(self, sight, since_s):
        return np.zeros(len(since_s), bool), np.zeros(len(since_s))


def bent(radius=40.0, speed=8.0, steps=91):
    """(T, 3) of a car on a circle to the left that slows down a little."""
    seconds = np.arange(steps) * 0.1
    turn = (speed * seconds - 0.2 * seconds**2) / radius
    return np.stack([radius * np.sin(turn), radius * (1 - np.cos(turn)), turn], -1)


@pytest.mark.parametrize(
    ("av", "opponent"),
    [
        (straight(0, 0, 16), cut_in(8.3, 8)),
        (straight(0, 0, 12, accel=-1.0), straight(25, 0, 2)),
        (bent(), bent()[::-1] + np.array([0.3, 0, np.pi])),
        (straight(0, 0, 0), straight(-40, 0, 12)),
    ],
)
def test_a_driver_who_sees_nothing_has_the_same_contact(av, opponent):
    rollout, case = attack(av, opponent)
    found = encounter_of(rollout, case)
    driven = reference_drivers.drive([Unaware()], found.approach, found.av_along_m, found.onset)[0]
    hits = reference_drivers.overlaps(found.approach, *found.path.at(driven))[0]
    assert found.contact == rollout.contacts[0].step - NOW
    assert np.flatnonzero(hits)[0] == found.contact


@pytest.mark.parametrize(
    ("av", "opponent"),
    [
        (straight(0, 0, 16), cut_in(8.3, 8)),
        (straight(0, 0, 12, accel=-1.0), straight(25, 0, 2)),
        (straight(0, 0, 10), straight(60, 0, 8, accel=-2.0)),
        (bent(), bent()[::-1] + np.array([0.3, 0, np.pi])),
    ],
)
def test_futures_have_the_onset_of_the_judgement(av, opponent):
    """What `fair` asks before anything is driven is what the judgement asks afterwards."""
    rollout, case = attack(av, opponent)
    found = encounter_of(rollout, case)
    alone = counterfactual(rollout, case, rollout.opponent_id)
    expected_m = np.full((found.approach.steps, 2), np.nan)
    shown = slice(found.first_step, found.first_step + found.approach.steps)
    known = alone.position_m[shown]
    expected_m[: len(known)] = np.where(alone.known[shown, None], known, np.nan)
    onset = grading._onsets(found.path, found.approach, found.av_along_m, expected_m)
    # velocities of futures are those of the last 0.2 s
    assert onset == pytest.approx([found.onset], abs=2)


def test_the_opponent_drives_on_as_planned_and_then_straight():
    opponent = cut_in(8.3, 8)
    rollout, case = attack(straight(0, 0, 16), opponent)
    short = replace(rollout.plans[0], position_m=opponent[11:40, :2],
                    heading_rad=opponent[11:40, 2], speed_mps=np.full(29, 8.0))  # fmt: skip
    found = encounter_of(replace(rollout, plans=(short,)), case)
    steps = rollout.contacts[0].step - NOW + round(AFTER_S / 0.1) + 1
    assert found.approach.steps == steps
    np.testing.assert_allclose(found.approach.position_m[0, :30], opponent[10:40, :2])
    rest = np.diff(found.approach.position_m[0, 29:], axis=0)
    np.testing.assert_allclose(rest, np.tile([0.8, 0.0], (len(rest), 1)), atol=1e-9)


def test_onset_is_a_departure_from_the_recording_or_a_collision_course():
    log = straight(60, 3.5, 10)
    seconds = np.maximum(np.arange(91) - 20, 0) * 0.1
    leaving = log.copy()
    leaving[:, 1] -= np.minimum(1.0 * seconds, 3.5)
    leaving[:, 0] -= 2.0 * np.maximum(seconds - 3, 0) ** 2
    rollout, case = attack(straight(0, 0, 14), leaving, log=log)
    found = encounter_of(rollout, case)
    assert found.onset + found.first_step == 26  # 0.6 m aside
    rollout, case = attack(straight(0, 0, 14), leaving)
    later = encounter_of(rollout, case)
    assert later.onset > found.onset


def test_an_opponent_that_appears_late_cannot_be_answered_before():
    rollout, case = attack(straight(0, 0, 12), straight(80, 0, 0))
    valid = rollout.tracks.valid.copy()
    valid[1, :40] = False
    found = encounter_of(replace(rollout, tracks=replace(rollout.tracks, valid=valid)), case)
    assert found.first_step == 40
    assert found.onset >= 0


def test_the_way_ahead_is_recorded_or_a_lane_or_none():
    av = straight(0, 0, 10)
    rollout, case = attack(av, straight(60, 0, 0))
    recorded = route_ahead(rollout, case, 30)
    assert recorded[0, 0] == pytest.approx(av[30, 0] + 1, abs=1.0)
    assert recorded[-1, 0] == pytest.approx(av[-1, 0])
    elsewhere = replace(
        case, scene=replace(case.scene, tracks=attack(straight(0, 30, 10), av)[0].tracks)
    )
    lane = route_ahead(rollout, elsewhere, 30)
    assert lane[-1, 0] == pytest.approx(300.0)
    assert np.abs(lane[:, 1]).max() < 1e-9
    assert len(route_ahead(rollout, replace(elsewhere, road=NO_ROAD), 30)) == 0


def test_the_way_over_short_lanes_is_as_long_as_over_long_ones():
    """Lanes of 0.4 m, as in junctions of recorded maps: there points are closer than a metre."""
    rollout, case = attack(straight(0, 0, 10), straight(60, 0, 0))
    long = next(iter(case.road.lanes.values()))
    ends = np.arange(0.0, 300.0, 0.4)
    lanes = {
        str(number): replace(
            long,
            id=str(number),
            centre_m=np.array([[x, 0.0], [x + 0.4, 0.0]]),
            z_m=np.zeros(2),
            next=(str(number + 1),),
        )
        for number, x in enumerate(ends)
    }
    lanes["0"] = replace(lanes["0"], centre_m=np.array([[-20.0, 0.0], [0.4, 0.0]]))
    road = replace(case.road, lanes=lanes)
    aside = replace(case.scene, tracks=attack(straight(0, 30, 10), straight(60, 0, 0))[0].tracks)
    far = replace(case, road=road, scene=aside)
    way = route_ahead(rollout, far, NOW)
    assert way[-1, 0] - way[0, 0] >= 148.0


def test_path_is_where_the_boxes_were_and_goes_on():
    poses = bent()
    path = av_path.AvPath.through(poses[:, :2], poses[:, 2], np.empty((0, 2)))
    along = polylines.arc_lengths(poses[:, :2])
    centre, heading = path.at(along)
    np.testing.assert_allclose(centre, poses[:, :2], atol=1e-9)
    np.testing.assert_allclose(heading, poses[:, 2], atol=1e-9)
    beyond = path.at(along[-1] + 50.0)[0]
    ahead = poses[-1, :2] + 50 * np.array([np.cos(poses[-1, 2]), np.sin(poses[-1, 2])])
    np.testing.assert_allclose(beyond, ahead, atol=1e-6)
    foot = path.project(centre)
    np.testing.assert_allclose(foot.along_m, along, atol=0.1)
    assert np.abs(foot.left_m).max() < 0.1


def test_a_standing_av_has_a_path():
    path = av_path.AvPath.through(
        np.zeros((5, 2)), np.full(5, 0.3), np.array([[0.5, 0.0], [-3.0, 0.0]])
    )
    centre, heading = path.at(np.array([0.0, 10.0]))
    np.testing.assert_allclose(centre[1], 10 * np.array([np.cos(0.3), np.sin(0.3)]))
    np.testing.assert_allclose(heading, 0.3)


@pytest.mark.sumo
def test_the_way_ahead_of_a_recorded_av_is_the_one_it_took(womd):
    found = readers.scenes([min((womd / "val").glob("*.gz"))])
    scene = next(one for one in found if isinstance(one, Scene) and _moves(one))
    rollout, case = attack(straight(0, 0, 10), straight(60, 0, 0))
    row = scene.tracks.row(scene.av_id)
    case = replace(case, scene=scene, road=scene.road)
    rollout = replace(rollout, tracks=scene.tracks, av_id=scene.av_id,
                      driver=np.zeros(scene.tracks.valid.shape))  # fmt: skip
    way = route_ahead(rollout, case, 30)
    later = scene.tracks.position_m[row, 35:]
    assert polylines.project(way, later).distance_m.max() < 0.2


def _moves(scene):
    path = scene.tracks.position_m[scene.tracks.row(scene.av_id)]
    return np.hypot(*(path[-1] - path[10])) > 30


def test_a_supporter_does_not_jump_back_into_the_recording():
    """It left its recorded path for the attack; when the rollout ends it keeps its velocity."""
    recorded = {"av": straight(0, 0, 10), "b": straight(30, 0, 10), "s": straight(0, 3.5, 10)}
    case = case_of(recorded)
    driven = {name: path[:31] for name, path in recorded.items()}
    driven["s"] = straight(0, 3.5, 10, accel=3.0)[:31]
    plan = Plan(
        agent_id="s", first_step=11, position_m=driven["s"][11:, :2],
        heading_rad=driven["s"][11:, 2], speed_mps=np.zeros(20), supports="b",
    )  # fmt: skip
    for plans, goes_on_m in (([], 21.0), ([plan], 26.0 + 0.1 * 15.85)):
        rollout = rollout_of(driven, [contact_of(step=30)], plans=plans)
        others = third_parties_of(rollout, case, 10, 40, ["s"])
        assert others.position_m.shape == (1, 40, 2)
        assert others.position_m[0, 20, 0] == pytest.approx(26.0)
        assert others.position_m[0, 21, 0] == pytest.approx(goes_on_m)


@pytest.mark.parametrize(("aside_m", "follows"), [(0.0, True), (0.3, True), (0.8, False)])
def test_a_third_road_user_goes_on_around_the_ring(aside_m, follows):
    """As without the attack, at its last speed; straight on only where it has left its way."""
    angle = 8.0 * (np.arange(91) - 10) * 0.1 / 20.0
    ring = np.column_stack([20 * np.cos(angle), 20 * np.sin(angle), angle + np.pi / 2])
    paths = {"av": straight(-60, 0, 5), "b": straight(-30, 0, 5), "ring": ring}
    case = replace(in_traffic(case_of(paths)), unattacked=tracks_of(paths))
    driven = {name: path[:41].copy() for name, path in paths.items()}
    driven["ring"][:, :2] *= (20 + aside_m) / 20
    others = third_parties_of(rollout_of(driven, [contact_of(step=40)]), case, 10, 60, ["ring"])
    away = np.hypot(*others.position_m[0].T) - 20
    assert others.position_m.shape == (1, 60, 2)
    assert (abs(away[31:]).max() < 0.05) == follows
    if follows:
        ahead = np.hypot(*np.diff(others.position_m[0, 31:], axis=0).T)
        np.testing.assert_allclose(ahead, 0.8, rtol=0.05)
        turned = np.diff(np.unwrap(others.heading_rad[0, 31:]))
        assert turned.min() > 0.0
