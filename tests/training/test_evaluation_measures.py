"""Measures by hand: ranking, displacement, calibration, likelihood, plausibility, baselines."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.scene import Forecast, Futures
from deepmf_sumo.training.evaluation import forecasts, marginal, measures, opponent
from deepmf_sumo.training.evaluation.forecasts import targets
from deepmf_sumo.training.evaluation.measures import (
    difference,
    expected_error,
    final_errors,
    mean,
    nearest_modes,
    path_errors,
    standard_error,
)
from deepmf_sumo.training.evaluation.opponent import (
    Ranking,
    auroc,
    average_precision,
    vehicles_near,
)
from deepmf_sumo.training.evaluation.table import Key, ObjectValues
from deepmf_sumo.training.samples import windows
from deepmf_sumo.training.samples.windows import Future

from tests.support.synthetic import scene

STRAIGHT = np.stack([np.arange(1, 81) * 1.0, np.zeros(80)], 1)


def the(given, agent_id):
    view = windows.view_at(given, given.now)
    return next(each for each in targets(given, view) if each.agent_id == agent_id)


def forecast_of(modes_m, probability):
    futures = Futures(agent_id="a", position_m=modes_m, heading_rad=np.zeros(modes_m.shape[:2]))
    return Forecast(futures=futures, probability=np.array(probability))


def future_of(position_m, valid=None):
    valid = np.ones(80, bool) if valid is None else valid
    level, ahead = np.zeros((2, 80))
    return Future(agent_id="a", position_m=position_m, z_m=level, heading_rad=ahead, valid=valid)


def test_auroc_counts_pairs_and_halves_ties():
    scores = np.array([3.0, 2.0, 2.0, 1.0])
    labels = np.array([True, True, False, False])
    assert auroc(scores, labels) == pytest.approx(3.5 / 4)
    assert auroc(scores, np.ones(4, bool)) is None


def test_average_precision_by_hand():
    scores = np.array([4.0, 3.0, 2.0, 1.0])
    labels = np.array([True, False, True, False])
    assert average_precision(scores, labels) == pytest.approx((1 + 2 / 3) / 2)
    assert average_precision(scores, np.zeros(4, bool)) is None


def test_average_precision_does_not_depend_on_the_order_of_ties():
    scores = np.array([2.0, -np.inf, -np.inf, -np.inf])
    first = average_precision(scores, np.array([True, True, False, False]))
    last = average_precision(scores, np.array([True, False, False, True]))
    assert first == last == pytest.approx((1 + 2 / 4) / 2)


def test_the_partner_s_place_counts_and_a_vehicle_without_a_score_is_never_found():
    ranking = Ranking()
    scores = np.array([0.5, 2.0, -np.inf])
    ranking.add(scores, np.array([False, True, True]))
    for partner in (1, 0, 2, None):
        ranking.add_partner(scores, partner)
    assert ranking.places == [0.0, 1.0, np.inf, np.inf]
    found = ranking.by_partner()
    assert (found["partner_top1"].value, found["partner_top3"].value) == (0.25, 0.5)
    assert found["partner_top1"].objects == 4
    assert found["partner_top3_scenes"].value == 2
    assert ranking.by_label()["top1_positive_scenes"].value == 1


def test_a_positive_may_be_second_or_third():
    ranking = Ranking()
    for place in range(4):
        ranking.add(np.array([4.0, 3.0, 2.0, 1.0]), np.arange(4) == place)
    found = ranking.by_label()
    assert (found["top1_positive"].value, found["top3_positive"].value) == (0.25, 0.75)
    assert found["top3_positive_scenes"].value == 3


def test_a_scene_without_scored_candidates_has_no_first():
    ranking = Ranking()
    ranking.add(np.array([-np.inf]), np.array([True]))
    ranking.add(np.zeros(0), np.zeros(0, bool))
    assert ranking.by_label()["top1_positive"].value == 0.0


def test_errors_and_misses_by_hand():
    modes = np.stack([STRAIGHT + np.array([0, 4.0]), STRAIGHT + np.array([7.0, 0])])
    future = future_of(STRAIGHT)
    fde = final_errors(modes, future, "min_fde")
    assert fde["min_fde", 8.0] == fde["min_fde", 1.0] == 4.0
    found = path_errors(modes, future, 20.0)
    assert found["min_ade", 3.0] == 4.0
    assert found["miss_rate", 8.0] == 1.0  # 4 m beside, 7 m ahead: outside 3 and 6
    ahead = STRAIGHT[None] + [5.0, 0]
    assert path_errors(ahead, future, 20.0)["miss_rate", 8.0] == 0.0
    assert path_errors(ahead, future, 20.0)["miss_rate", 3.0] == 1.0
    assert path_errors(ahead, future, 0.0)["miss_rate", 8.0] == 1.0  # half thresholds at low speed
    cut = future_of(STRAIGHT, np.arange(80) < 60)
    assert ("min_fde", 8.0) not in final_errors(STRAIGHT[None], cut, "min_fde")
    assert ("min_fde", 5.0) in final_errors(STRAIGHT[None], cut, "min_fde")
    assert ("miss_rate", 8.0) not in path_errors(STRAIGHT[None], cut, 0.0)
    assert path_errors(STRAIGHT[None], cut, 0.0)["min_ade", 8.0] == 0.0


def test_figures_have_standard_errors_and_no_miss_rule_before_three_seconds():
    samples, future = ObjectValues("marginal"), future_of(STRAIGHT)
    for off in (1.0, 3.0):
        modes = STRAIGHT[None] + [0, off]
        samples.add(final_errors(modes, future, "min_fde"), 1)
        samples.add(path_errors(modes, future, 0.0), 1)
    figures = samples.figures()
    assert figures[Key("marginal", "min_fde", 8.0, 1)] == (2.0, 1.0, 2)
    assert figures[Key("marginal", "miss_rate", 8.0, 1)].value == 0.5
    assert Key("marginal", "min_fde", 2.0, 1) in figures
    assert Key("marginal", "miss_rate", 2.0, 1) not in figures


def test_gains_are_paired_and_need_the_same_objects():
    samples = ObjectValues("conditional")
    for condition, values in (("a", (1.0, 5.0)), ("b", (0.0, 4.0)), ("c", (3.0,))):
        for value in values:
            samples.add({("min_fde", 8.0): value}, 6, condition)
    gains = samples.gains("min_fde", -1, "gain", "a")
    assert gains == {
        Key("conditional", "gain", 8.0, 6, "b"): (1.0, 0.0, 2),
        Key("conditional", "gain", 8.0, 6, "c"): (None, None, 1),
    }


def test_differences_are_paired():
    assert difference([1.0, 5.0, 9.0], [0.0, 4.0, 8.0]) == (1.0, 0.0)
    assert difference([1.0], []) == (None, None)
    assert mean([]) is None
    assert standard_error([1.0]) is None


def test_calibration_error_by_hand():
    probability = np.array([0.75, 0.75, 0.25, 0.25])
    assert expected_error(probability, np.array([True, True, False, False])) == pytest.approx(0.25)
    assert expected_error(probability, np.array([True, False, True, False])) == pytest.approx(0.25)
    assert expected_error(np.ones(2), np.array([True, True])) == 0.0
    assert expected_error(np.zeros(0), np.zeros(0, bool)) is None


def test_the_event_of_a_mode_is_to_be_nearest_at_the_horizon():
    samples = ObjectValues("marginal")
    slower = STRAIGHT * 0.5
    modes = np.stack([STRAIGHT, slower])
    truth = np.where(np.arange(80)[:, None] < 40, STRAIGHT, slower)
    found = nearest_modes(forecast_of(modes, [0.9, 0.1]), future_of(truth, np.arange(80) < 60))
    assert found["nearest", 3.0].tolist() == [True, False]
    assert found["nearest", 5.0].tolist() == [False, True]
    samples.add(found, 2)
    figures = samples.figures()
    assert figures[Key("marginal", "ece", 3.0)].value == pytest.approx(0.1)
    assert figures[Key("marginal", "ece", 5.0)].value == pytest.approx(0.9)
    assert Key("marginal", "ece", 8.0) not in figures


def test_likelihood_of_modes_is_a_density_and_grows_with_probability():
    modes = np.stack([STRAIGHT, STRAIGHT + np.array([0, 8.0])])
    step = 29
    place = STRAIGHT[step]
    axis = np.linspace(-60, 60, 401)
    grid = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2) + place
    forecast = forecast_of(modes, [0.8, 0.2])
    total = sum(np.exp(measures.of_modes(forecast, step, p, 1.25)) for p in grid[::7])
    assert total * 7 * 0.3**2 == pytest.approx(1.0, abs=0.02)
    other = forecast_of(modes, [0.2, 0.8])
    gain = measures.of_modes(forecast, step, place, 0.75) - measures.of_modes(
        other, step, place, 0.75
    )
    assert gain == pytest.approx(np.log(4), abs=0.05)


def test_the_end_is_judged_by_all_goals_and_what_is_unknown_not_at_all():
    asked = []

    def density(ends, kernel):
        asked.append((ends, kernel))
        return np.array([-3.0])

    forecast = forecast_of(STRAIGHT[None], [1.0])
    known = measures.log_likelihoods(forecast, future_of(STRAIGHT), density)
    assert known["log_likelihood", 8.0] == -3.0
    assert asked[0][0].tolist() == [[80.0, 0.0]]
    cut = measures.log_likelihoods(forecast, future_of(STRAIGHT, np.arange(80) < 30), density)
    assert cut.keys() == {("log_likelihood", 3.0)}


def test_modes_that_meet_others_are_not_clear():
    target = the(scene(), "av")  # from (-50, 0) eastward at 10 m/s
    steps = np.arange(1, 81)
    waits = np.stack([np.full(80, -50.0), np.zeros(80)], 1)
    rushes = np.stack([-50.0 + steps * 2.0, np.zeros(80)], 1)  # 20 m/s
    modes = np.stack([target.future.position_m, rushes, waits])
    first = forecasts.first_overlap(target, modes, np.zeros((3, 80)))
    # as it drove it meets `south` at the crossing, from x = -3, y = -2.7 on, after 4.7 s; faster it
    # passes before, and meets the one that waits at x = 55.2, after 5.3 s
    assert first.tolist() == [46, 52, forecasts.NEVER]
    unknown = np.full((1, 80, 2), np.nan)
    assert forecasts.first_overlap(target, unknown, unknown[..., 0])[0] == forecasts.NEVER


def test_modes_off_the_lanes_are_found_at_half_seconds():
    target = the(scene(), "av")
    steps = np.arange(1, 81)
    leaves = target.future.position_m + np.stack([np.zeros(80), 0.1 * steps], 1)
    modes = np.stack([target.future.position_m, leaves])
    # off beyond 1.85 + 0.5 m: at step index 23 (2.4 m), seen at 24; then `left` is far
    assert forecasts.first_off_road(target, modes).tolist() == [forecasts.NEVER, 24]


def test_baselines_go_straight_and_along_the_lane():
    given = scene(turn=0.4)
    target = the(given, "av")
    straight = marginal.constant_velocity(target)[0]
    assert straight == pytest.approx(target.future.position_m, abs=1e-6)
    lane = marginal.lane_following(target)[0]
    assert lane == pytest.approx(target.future.position_m, abs=0.3)
    tilted = tilted_scene()
    lane = marginal.lane_following(the(tilted, "av"))[0]
    assert np.abs(lane[-20:, 1]).max() < 0.2  # back on the lane y = 0
    assert np.abs(marginal.constant_velocity(the(tilted, "av"))[0, -1, 1]) > 10


def tilted_scene():
    """The AV turned by 0.2 rad against its lane."""
    given = scene()
    row = given.tracks.row("av")
    heading, velocity = given.tracks.heading_rad.copy(), given.tracks.velocity_mps.copy()
    heading[row] = 0.2
    velocity[row] = 10 * np.array([np.cos(0.2), np.sin(0.2)])
    return replace(given, tracks=replace(given.tracks, heading_rad=heading, velocity_mps=velocity))


def test_opponent_rules_by_hand():
    view = windows.view_at(scene(), 10)
    rows = np.array([view.history.row(name) for name in ("south", "parked", "far")])
    # relative to the AV at (-50, 0): (50, -45), (20, 12), (-90, 0)
    assert opponent.corridor(view, rows).tolist() == pytest.approx([-100.0, -28.0, -18.0])
    assert opponent.nearest(view, rows)[1] == pytest.approx(-np.hypot(20, 12))
    assert opponent.nearest_moving(view, rows)[1] == -np.inf
    assert np.isfinite(opponent.nearest_moving(view, rows)[[0, 2]]).all()
    # they meet at the crossing at 5 s; the AV passes 12 m beside the parked one
    approach = opponent.constant_velocity(view, rows)
    assert approach[0] == pytest.approx(0.0, abs=4.0)
    assert approach[1] == pytest.approx(-12.0, abs=0.1)


def test_candidates_are_all_vehicles_within_80_m():
    view = windows.view_at(scene(), 10)
    found = {view.history.ids[row] for row in vehicles_near(view)}
    assert found == {"south", "parked"}  # `waiting` and `far` are 110 and 90 m away
