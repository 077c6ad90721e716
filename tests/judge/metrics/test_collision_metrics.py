import math

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.judge import metrics
from deepmf_sumo.judge.metrics.conflict import MovingBox, time_to_collision
from deepmf_sumo.scene.geometry import boxes
from deepmf_sumo.scene.geometry.road import on_road

from tests.support.predictor_doubles import straight_road
from tests.support.rollout_doubles import case_of, contact_of, rollout_of, straight

PATHS = {"av": straight(0, 0, 10), "b": straight(-8, 3.5, 12)}


def measured(name, rollout, case=None):
    return plugins.load("metrics", name).measure(rollout, case or case_of())


@pytest.mark.parametrize(
    "rollout",
    [
        rollout_of(PATHS),
        rollout_of(PATHS, opponent_id=None),
        rollout_of(PATHS, contacts=[contact_of()]),
        rollout_of({key: path[:12] for key, path in PATHS.items()}, contacts=[contact_of(step=11)]),
        rollout_of({key: path[:11] for key, path in PATHS.items()}),
        rollout_of({"av": straight(0, 0, 0), "b": straight(1, 0.5, 0)}),
    ],
    ids=["missed", "nobody", "hit", "hit immediately", "short", "standing"],
)
def test_every_metric(rollout):
    """The exam: a value or a reason, whatever happened."""
    for value in metrics.measure(rollout, case_of()):
        metric = plugins.load("metrics", value.name)
        assert metric.better in {"lower", "higher", "neither"}
        assert metric.definition
        assert "\n" not in metric.definition
        assert (value.unit, value.better) == (metric.unit, metric.better)
        assert (value.value is None) == bool(value.reason)
        assert value.value is None or math.isfinite(value.value)


def test_collision_metrics():
    hit = rollout_of(PATHS, contacts=[contact_of(step=40)])
    assert measured("collision", hit).value == 1.0
    assert measured("collision_time_s", hit).value == pytest.approx(3.0)
    assert measured("collision_speed", hit).value == 4.5
    assert measured("delta_v", hit).value == 2.25
    miss = rollout_of(PATHS, contacts=[contact_of("opponent_other", 30, "b", "c")])
    assert measured("collision", miss).value == 0.0
    assert measured("collision_time_s", miss).value is None
    assert measured("third_party", miss).value == 1.0
    assert measured("third_party", hit).value == 0.0
    other = rollout_of(PATHS, contacts=[contact_of("av_other", 30, "av", "c")])
    assert measured("av_third_party", other).value == 1.0
    nobody = measured("collision", rollout_of(PATHS, opponent_id=None))
    assert (nobody.value, nobody.reason) == (None, "no vehicle was attacked")


def test_a_collision_after_another_contact_is_not_clean():
    hit = contact_of(step=40)
    others = [contact_of("opponent_other", 30, "b", "c"), contact_of("av_other", 30, "av", "c")]
    assert measured("collision_clean", rollout_of(PATHS, contacts=[hit])).value == 1.0
    for other in others:
        assert measured("collision_clean", rollout_of(PATHS, contacts=[other, hit])).value == 0.0
        assert measured("collision_clean", rollout_of(PATHS, contacts=[other])).value == 0.0
    # at the same step the AV is hit all the same
    late = contact_of("opponent_other", 40, "b", "c")
    assert measured("collision_clean", rollout_of(PATHS, contacts=[hit, late])).value == 1.0


def test_least_gap():
    assert measured("min_gap", rollout_of(PATHS)).value == pytest.approx(1.5)
    behind = {"av": straight(0, 0, 10), "b": straight(-10, 0, 8)}
    # From the first step after now; the gap grows by 2 m/s from 10 - 4.8 m.
    assert measured("min_gap", rollout_of(behind)).value == pytest.approx(5.2 + 0.2)


def test_least_time_to_collision():
    rear = {"av": straight(0, 0, 5), "b": straight(-44.8, 0, 10)}
    steps = {key: path[:31] for key, path in rear.items()}
    # Gap 40 m closes at 5 m/s: 8 s at now, 6 s at the last step, 2 s later.
    assert measured("ttc_min", rollout_of(steps)).value == pytest.approx(6.0)
    aside = {"av": straight(0, 0, 5), "b": straight(-44.8, 3.5, 10)}
    assert "course" in measured("ttc_min", rollout_of(aside)).reason


@pytest.mark.parametrize("seed", range(4))
def test_time_to_collision_against_stepping(seed):
    rng = np.random.default_rng(seed)
    count, seconds = 150, np.arange(0, 8, 0.01)
    size_a, size_b = np.array([4.8, 2.0]), np.array([9.0, 2.5])
    place = rng.uniform(-25, 25, (2, count, 2))
    heading, velocity = rng.uniform(-3, 3, (2, count)), rng.uniform(-8, 8, (2, count, 2))
    fast = time_to_collision(
        MovingBox(place[0], heading[0], velocity[0], size_a),
        MovingBox(place[1], heading[1], velocity[1], size_b),
    )
    moved = place[:, :, None] + velocity[:, :, None] * seconds[:, None]
    hit = boxes.overlap(
        moved[0], heading[0][:, None], size_a, moved[1], heading[1][:, None], size_b
    )
    slow = np.where(hit.any(1), seconds[hit.argmax(1)], np.inf)
    within = slow < 7.9
    assert within.sum() > 5
    np.testing.assert_allclose(fast[within], slow[within], atol=0.0101)
    assert (fast[~within] > 7.8).all()


def test_share_on_the_road():
    road = straight_road(lanes=2)  # centre lines at 0 and 3.5, 3.5 m wide
    points = np.array([[0, 0], [0, 2.2], [0, 5.7], [0, 5.8], [0, -2.3], [900, 0]], float)
    assert on_road(road, points).tolist() == [True, True, True, False, False, False]
    leaving = straight(0, 3.5, 10)
    leaving[51:, 1] = 7.0
    rollout = rollout_of({"av": straight(0, -30, 10), "b": leaving})
    assert measured("on_road", rollout).value == pytest.approx(40 / 80)
