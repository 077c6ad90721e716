from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.deepmf.networks.config import LIGHT
from deepmf_sumo.training.samples import opponent, windows

from tests.support.synthetic import scene


def interacts(scene, agent_id):
    return bool(opponent.interacting(scene.tracks, scene.road, scene.av_id, [agent_id])[0])


def test_ways_that_cross_at_different_times_interact():
    late = scene(shift=-20.0)
    assert interacts(late, "south")


def test_ways_that_do_not_cross_do_not_interact():
    assert not interacts(scene(), "parked")
    assert interacts(scene(), "waiting") == (-50 + 80 + 4.8 > 60)  # the AV ends at x = 30: too far


def test_closer_than_the_avs_length_is_an_interaction():
    given = scene()
    row = given.tracks.row("parked")
    position = given.tracks.position_m.copy()
    position[row] = [-30.0, 4.5]
    beside = replace(given, tracks=replace(given.tracks, position_m=position))
    assert interacts(beside, "parked")
    position[row] = [-30.0, 5.0]
    assert not interacts(
        replace(given, tracks=replace(given.tracks, position_m=position)), "parked"
    )


def on_a_bridge(given, height, *raised):
    """The road from the south passes over the other one, ``raised`` agents are on it."""
    upper = {"south", "up", "north"}
    lanes = {
        name: replace(one, z_m=one.z_m + height * (name in upper))
        for name, one in given.road.lanes.items()
        if name != "left"
    }
    z_m = given.tracks.z_m.copy()
    z_m[[given.tracks.row(agent) for agent in raised]] = height
    return replace(
        given,
        road=replace(given.road, lanes=lanes),
        tracks=replace(given.tracks, z_m=z_m),
    )


@pytest.mark.parametrize(("raised", "meet"), [(("south",), False), ((), True)])
def test_ways_on_two_levels_do_not_interact(raised, meet):
    assert interacts(on_a_bridge(scene(shift=-20.0), 6.0, *raised), "south") is meet


def test_closer_than_the_avs_length_on_two_levels_is_no_interaction():
    given = scene()
    position = given.tracks.position_m.copy()
    position[given.tracks.row("parked")] = [-30.0, 4.5]  # beside the AV's way, without overlap
    beside = replace(given, tracks=replace(given.tracks, position_m=position))
    assert interacts(on_a_bridge(beside, 6.0), "parked")
    assert not interacts(on_a_bridge(beside, 6.0, "parked"), "parked")


def test_samples_on_two_levels_have_no_label_of_the_other_level(monkeypatch):
    monkeypatch.setattr(opponent, "AV_STEPS", (10,))
    monkeypatch.setattr(opponent, "STAND_IN_STEPS", ())
    found = {}
    for raised in ((), ("south",)):
        given = on_a_bridge(scene(), 6.0, *raised)
        (sample,) = opponent.opponent_samples(given, LIGHT)
        found[raised] = sample["interacts"].sum() - sample["interacts"][sample["partner"] > 0].sum()
        assert sample["interacts"][sample["partner"] > 0].item() == (not raised)
    assert found[()] == found["south",]  # labels of the others stay


def test_heights_count_only_where_a_road_passes_over_another():
    given = scene(shift=-20.0)
    z_m = given.tracks.z_m.copy()
    z_m[given.tracks.row("south")] = 6.0  # of another origin, say: nothing passes over anything
    apart = replace(given, tracks=replace(given.tracks, z_m=z_m))
    assert interacts(apart, "south")
    assert windows.partner_of(replace(apart, interest=()), "av", 10).agent_id == "south"


def test_a_vehicle_on_the_bridge_ahead_is_no_partner():
    below = on_a_bridge(scene(labelled=False), 6.0)
    assert windows.partner_of(below, "av", 10).agent_id == "south"
    above = on_a_bridge(scene(labelled=False), 6.0, "south")
    given = windows.partner_of(above, "av", 10)
    assert given is None or given.agent_id != "south"


def test_only_frames_that_are_valid_count():
    given = scene()
    valid = given.tracks.valid.copy()
    valid[given.tracks.row("south"), 50:] = False  # before it reaches the crossing
    cut = replace(given, tracks=replace(given.tracks, valid=valid))
    assert not interacts(cut, "south")


def test_targets_move_or_are_labelled():
    found = {each.agent_id for each in windows.targets(scene(av_speed=0.0), 10)}
    assert found == {"av", "south", "far"}


def test_a_view_holds_no_future():
    given = scene()
    view = windows.view_at(given, 10)
    assert view.history.steps == 11
    assert view.history.position_m[0, -1] == pytest.approx([-50, 0])


def test_futures_past_the_end_are_masked():
    future = windows.future_of(scene(), "av", 40)
    assert future.valid.sum() == 50
    assert future.position_m[0] == pytest.approx([-50 + 31.0, 0])


def test_the_partner_is_the_labelled_one_else_the_nearest_in_space_and_time():
    assert windows.partner_of(scene(), "av", 10).agent_id == "south"
    unlabelled = windows.partner_of(scene(labelled=False), "av", 10)
    assert unlabelled.agent_id == "south"


def test_a_given_future_is_complete():
    given = windows.partner_of(scene(labelled=False), "south", 40)
    assert given.valid.all()
    step = np.linalg.norm(np.diff(given.position_m, axis=0), axis=-1)
    assert step == pytest.approx(np.full(79, step[0]), abs=1e-6)


def test_tracks_that_jump_are_no_targets():
    given = scene()
    position = given.tracks.position_m.copy()
    position[given.tracks.row("far"), 60:] += 30.0
    jumping = replace(given, tracks=replace(given.tracks, position_m=position))
    assert "far" not in {each.agent_id for each in windows.targets(jumping, 10)}


def test_a_planner_takes_over_at_the_first_window_of_an_attack():
    given = scene()
    attacked = replace(given, source=replace(given.source, dataset=windows.ROLLOUT, sha256="a"))
    told = [windows.view_at(attacked, step).av_recorded_steps for step in (10, 15, 20, 40)]
    assert told == [10, 5, 0, 0]
    assert windows.view_at(given, 10).av_recorded_steps == 0
    driven_before = replace(attacked, source=replace(attacked.source, sha256=""))  # by SUMO
    assert windows.view_at(driven_before, 10).av_recorded_steps == 0


def test_an_av_under_attack_is_a_target_until_just_before_the_contact():
    given = scene()
    valid = given.tracks.valid.copy()
    valid[given.tracks.row("av"), 45:] = False
    logged = replace(given, tracks=replace(given.tracks, valid=valid))
    attacked = replace(logged, source=replace(given.source, dataset=windows.ROLLOUT))
    assert "av" not in {each.agent_id for each in windows.targets(logged, 30)}
    assert [each.agent_id for each in windows.targets(attacked, 30)] == ["av"]
    assert not list(windows.targets(attacked, 40))
