"""Where on the AV's front a hit is, and what it means for a person."""

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.judge.metrics import NotMeasurable
from deepmf_sumo.judge.metrics.impact import (
    impact_share,
    pedestrian_fatality_risk,
    person_impact_speed,
)

from tests.support.drawn_people import CAR, TRUCK, Drawn, episode, stands, walks
from tests.support.rollout_doubles import straight


@pytest.mark.parametrize("share", [0.1, 0.25, 0.5, 0.75, 0.9])
@pytest.mark.parametrize("from_right", [True, False])
def test_a_walker_is_hit_where_ncap_would_have_put_him(share, from_right):
    """By hand: the front arrives after (40 - 2.4 - 0.25) m at 14 m/s, and the walker with it."""
    reach_s = (40 - CAR[0] / 2 - 0.25) / 14
    y = (0.5 - share) * CAR[1]  # to the left
    side = -1 if from_right else 1
    begin_y = y + side * 1.4 * reach_s
    person = walks(40, begin_y, (9, 1.4), heading=-side * np.pi / 2)
    found = episode(straight(0, 0, 14), Drawn(person))
    assert impact_share.compute(found) == pytest.approx(share, abs=0.01)
    assert person_impact_speed.compute(found) == pytest.approx(14.0)


def test_turned_boxes_of_people_have_no_corners():
    for turn in (0.0, 0.2, -0.2):
        person = stands(40, 0.5, turn)
        found = episode(straight(0, 0, 14), Drawn(person))
        assert impact_share.compute(found) == pytest.approx(0.25)


def test_a_car_is_hit_where_the_boxes_overlap():
    """Its right half stands 0.4 m inside the AV's left half: 0.6 m to 1 m from the middle."""
    found = episode(straight(0, 0, 14), Drawn(stands(40, 1.6), "vehicle", (4.8, 2.0, 1.5)))
    assert impact_share.compute(found) == pytest.approx(0.5 - 0.8 / 2.0, abs=0.005)
    with pytest.raises(NotMeasurable, match="neither"):
        person_impact_speed.compute(found)
    with pytest.raises(NotMeasurable, match="not a pedestrian"):
        pedestrian_fatality_risk.compute(found)


def test_who_runs_into_the_side_was_not_hit_by_the_front():
    person = walks(10, 3.0, (9, 2.0), heading=-np.pi / 2)
    found = episode(straight(9, 0, 0.5), Drawn(person))
    for name in ("impact_share", "pedestrian_fatality_risk"):
        assert "front" in plugins.load("metrics", name).measure(found.rollout, found.case).reason
    assert person_impact_speed.compute(found) == pytest.approx(0.5)


@pytest.mark.parametrize(("kmh", "risk"), [(30, 0.0148), (50, 0.0832), (76.7, 0.5), (100, 0.891)])
def test_the_curve_gives_the_published_risks(kmh, risk):
    """Rosen and Sander: at 50 km/h above 2 times that at 40 and 5 times that at 30."""
    found = episode(straight(0, 0, kmh / 3.6), Drawn(stands(40, 0)))
    assert pedestrian_fatality_risk.compute(found) == pytest.approx(risk, abs=0.001)


def test_there_is_no_curve_for_cyclists_and_for_trucks():
    rider = Drawn(stands(40, 0), "cyclist", (1.8, 0.8, 1.75))
    with pytest.raises(NotMeasurable):
        pedestrian_fatality_risk.compute(episode(straight(0, 0, 10), rider))
    assert person_impact_speed.compute(episode(straight(0, 0, 10), rider)) == pytest.approx(10)
    found = episode(straight(0, 0, 10), Drawn(stands(40, 0)))
    found.rollout.tracks.size_m.setflags(write=True)
    found.rollout.tracks.size_m[0] = TRUCK
    with pytest.raises(NotMeasurable, match="of cars"):
        pedestrian_fatality_risk.compute(found)
