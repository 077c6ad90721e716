"""Rungs of hits by pedestrians and cyclists, drawn by hand so that the rung is evident."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.judge.causes import cause_of
from deepmf_sumo.judge.hits import hit_of
from deepmf_sumo.judge.impact import first_touch
from deepmf_sumo.judge.ladder import verdict
from deepmf_sumo.judge.metrics import Episode, NotMeasurable
from deepmf_sumo.judge.metrics.av_rules import av_crossing_taken
from deepmf_sumo.judge.metrics.avoidability import avoided_by_cc, avoided_by_vru
from deepmf_sumo.scene import Polygon, SignalState

from tests.judge.test_ladder import STREET, driven, junction, lane, road_of
from tests.support.drawn_people import NOW, TRUCK, Drawn, episode, stands, walks
from tests.support.rollout_doubles import contact_of, straight

RIDER = (1.8, 0.8, 1.75)


def crossing(x, road=STREET, width=4.0):
    corners = np.array([[x - width / 2, -3], [x + width / 2, -3], [x + width / 2, 10],
                        [x - width / 2, 10]], float)  # fmt: skip
    zebra = Polygon(id="zebra", kind="crosswalk", points_m=corners, z_m=np.zeros(4))
    return replace(road, polygons=(zebra,))


def crossing_to_the_north(road):
    corners = np.array([[-8, 16], [8, 16], [8, 20], [-8, 20]], float)
    zebra = Polygon(id="zebra", kind="crosswalk", points_m=corners, z_m=np.zeros(4))
    return replace(road, polygons=(zebra,))


def told(found):
    one = verdict(found)
    return one.rung, one.reasons, one.av_error, one.opponent_error


def far_walker(x):
    """Comes over the whole road from the left: in sight and on the road for 5 s."""
    return Drawn(walks(x, 8.0, (9, 1.4), heading=-np.pi / 2))


AV = straight(0, 0, 10)


@pytest.mark.parametrize("heading_deg", [-20, -28, -60, -90, -120])
def test_who_comes_from_beside_crosses(heading_deg):
    """Whichever way: people on foot neither change lanes nor merge."""
    heading = np.deg2rad(heading_deg)
    hits = []
    for end_m in range(54, 76, 2):
        begin_m = end_m + 9.6 / np.tan(heading)
        walk = walks(begin_m, 9.6, (9, -1.4 / np.sin(heading)), heading=heading)
        hits.append(hit_of(episode(AV, Drawn(walk), road=STREET)))
    told = {(one.conflict, one.side) for one in hits if one is not None}
    assert told == {("crossing", "left")}


def test_who_steps_out_in_time_to_be_avoided_erred_and_so_did_the_av_to_hit_him():
    found = episode(AV, far_walker(58), road=STREET)
    assert told(found) == ("B", ("stepped_out",), "", "stepped_out")
    assert verdict(found).avoided_by == ("vru", "search")
    assert avoided_by_vru.compute(found) == 1
    with pytest.raises(NotMeasurable, match="by vehicles"):
        avoided_by_cc.compute(found)


def test_at_a_crossing_the_av_gives_way():
    found = episode(AV, far_walker(58), road=crossing(58))
    assert told(found) == ("A", ("took_crossing",), "took_crossing", "")
    assert hit_of(found).priority == "opponent"
    assert hit_of(episode(AV, far_walker(58), road=STREET)).priority == "AV"


def test_nobody_gives_way_to_whom_nobody_could_see():
    person = Drawn(walks(20, -8.0, (9, 3.4), begin=0))
    truck = [Drawn(stands(13.4, -4.1), "vehicle", TRUCK)]
    found = episode(straight(0, 0, 14), person, truck, road=crossing(20))
    assert told(found)[0] == "D"
    assert verdict(found).av_error == ""


def test_lights_of_the_av_tell_who_may_cross():
    """A crossing behind the junction: the AV goes straight on, its light is green or red."""
    road = crossing(30, junction())
    av, person = driven(10, x=-30), far_walker(30)
    found = episode(av, person, road=road)
    steps = found.rollout.tracks.steps - 1 - NOW

    def at(state):
        lit = replace(found.rollout, signals=({"east": state},) * steps)
        one = Episode(lit, found.case)
        return *told(one)[2:], hit_of(one).priority, av_crossing_taken.compute(one)

    assert at(SignalState.GO) == ("", "crossed_on_red", "AV", 0.0)
    assert at(SignalState.STOP) == ("ran_light", "", "opponent", 1.0)
    # it is off; no driver of reference comes to a stand in time
    assert at(SignalState.FLASHING_CAUTION) == ("", "", "opponent", 1.0)


@pytest.mark.parametrize(("crossing_id", "red"), [(":c_c0", True), (":x_c0", False)])
def test_a_light_stops_who_uses_crossings_of_its_own_junction(crossing_id, red):
    """A zebra behind a signalled junction belongs to another one, at which the AV gives way."""
    road = road_of(
        lane("wc_0", (-200, 0), (-10, 0), next=(":c_14_0",)),
        lane(":c_14_0", (-10, 0), (10, 0), interpolating=True, previous=("wc_0",), next=("ce_0",)),
        lane("ce_0", (10, 0), (200, 0), previous=(":c_14_0",)),
    )
    zebra = replace(crossing(30, road).polygons[0], id=crossing_id)
    found = episode(driven(10, x=-30), far_walker(30), road=replace(road, polygons=(zebra,)))
    lights = ({":c_14_0": SignalState.GO},) * (found.rollout.tracks.steps - 1 - NOW)
    one = Episode(replace(found.rollout, signals=lights), found.case)
    assert told(one)[3] == "crossed_on_red" * red
    assert hit_of(one).priority == ("AV" if red else "opponent")
    assert av_crossing_taken.compute(one) == float(not red)


@pytest.mark.parametrize("light", [None, SignalState.GO])
def test_who_rides_along_the_road_over_a_crossing_does_not_use_it(light):
    """As where no crossing is: the AV ran into the bicycle ahead."""
    rider = Drawn(straight(10, 0, 4), "cyclist", RIDER)

    def judged(road):
        found = episode(straight(-16, 0, 10), rider, road=road, alone=rider.path)
        rollout = found.rollout
        if light is not None:
            lights = ({"east": light},) * (rollout.tracks.steps - 1 - NOW)
            rollout = replace(rollout, signals=lights)
        one = Episode(rollout, found.case)
        hit = hit_of(one)
        return *told(one), hit.priority, hit.on_crossing

    met_at = 10 + 4 * 3.8
    found = judged(crossing(met_at, junction()))
    assert found == judged(junction())
    assert found[2:] == ("struck_ahead", "", "opponent", False)


def test_hit_and_monitor_agree_on_who_goes_first_where_the_av_turns_at_green():
    """The AV turns left at a green light, onto a crossing behind the junction: people go first."""
    road = crossing_to_the_north(junction())
    bend = np.linspace(0, np.pi / 2, 32)
    turn = np.stack([-10 + 10 * np.sin(bend), 10 * (1 - np.cos(bend)), bend], -1)
    before = np.stack([-10 - 0.5 * np.arange(40, 0, -1), np.zeros(40), np.zeros(40)], -1)
    after = np.stack([np.zeros(19), 10 + 0.5 * np.arange(1, 20), np.full(19, np.pi / 2)], -1)
    person = walks(11.6, 18.0, (9, 1.3), heading=np.pi, begin=0)
    found = episode(np.concatenate([before, turn, after]), Drawn(person), road=road)
    steps = found.rollout.tracks.steps - 1 - NOW
    lit = replace(found.rollout, signals=({"east": SignalState.GO},) * steps)
    one = Episode(lit, found.case)
    assert hit_of(one).priority == "opponent"
    assert av_crossing_taken.compute(one) == 1.0


def test_who_stood_on_the_road_in_sight_was_to_be_seen():
    assert told(episode(AV, Drawn(stands(58, 0)), road=STREET)) == (
        "A", ("struck_standing",), "struck_standing", "",
    )  # fmt: skip


def test_who_stood_out_of_sight_was_not():
    """A truck drives ahead of the AV and turns off just before it comes to who stands there."""
    truck = np.zeros((91, 3))
    truck[:, 0] = 10 + np.arange(91) * 1.0
    truck[:, 1] = np.interp(np.arange(91), [38, 41], [0, 4.5])
    person = Drawn(stands(55, 0))
    found = episode(AV, person, [Drawn(truck, "vehicle", TRUCK)], road=STREET)
    assert verdict(found).av_error == ""
    assert verdict(found).opponent_error == "stepped_out"


@pytest.mark.parametrize(("speed", "contrived"), [(1.3, True), (1.5, False)])
def test_pushing_somebody_at_walking_speed_is_no_finding(speed, contrived):
    av = straight(20, 0, speed)
    reasons = told(episode(av, Drawn(stands(26, 0)), road=STREET))[1]
    assert ("low_impact_speed" in reasons) == contrived


def test_a_small_change_of_velocity_of_the_av_means_nothing():
    found = episode(AV, Drawn(stands(58, 0)), road=STREET)
    assert found.rollout.first("av_opponent").delta_v_mps < 5 / 3.6
    assert verdict(found).rung == "A"


def test_who_runs_into_side_or_rear_says_little():
    """The AV passes at 10 m/s; he arrives at its door, and at its rear at 3 m/s more than it."""
    seconds = 3.0
    x = 10 * seconds - 0.5
    door = Drawn(walks(x, 1.3 + 2.0 * seconds, (9, 2.0), heading=-np.pi / 2))
    found = episode(AV, door, road=STREET)
    assert first_touch(found.rollout, found.rollout.first("av_opponent")).ran_into == "left"
    assert told(found)[:2] == ("C", ("ran_into_side",))
    behind = Drawn(straight(-9, 0, 7), "cyclist", RIDER)
    found = episode(straight(0, 0, 4), behind, road=STREET)
    assert told(found)[:2] == ("C", ("ran_into_rear",))


def test_a_side_that_sweeps_into_a_cyclist_struck_him():
    """The AV moves over to the right, where a cyclist rides beside it."""
    av = straight(0, 0, 6)
    av[:, 1] = np.interp(np.arange(91), [20, 40], [3.5, 0.0])
    rider = Drawn(straight(-0.5, 0.2, 6), "cyclist", RIDER)
    found = episode(av, rider, road=STREET)
    assert first_touch(found.rollout, found.rollout.first("av_opponent")).ran_into is None
    assert told(found)[2:] == ("moved_over", "")


def test_cyclists_on_the_road_have_the_rights_of_vehicles():
    ahead = Drawn(straight(25, 0, 4), "cyclist", RIDER)
    assert told(episode(AV, ahead, road=STREET)) == ("A", ("struck_ahead",), "struck_ahead", "")


def test_a_cyclist_who_rides_onto_the_road_or_against_the_traffic_errs():
    out = Drawn(walks(58, 13.0, (9, 2.6), heading=-np.pi / 2), "cyclist", RIDER)
    found = told(episode(AV, out, road=STREET))
    assert (found[0], found[3]) == ("B", "rode_out")
    against = Drawn(straight(80, 0.4, 4, heading=np.pi), "cyclist", RIDER)
    found = told(episode(AV, against, road=STREET))
    assert (found[0], found[3]) == ("B", "rode_against")


def test_no_place_is_off_the_road_for_people():
    """A vehicle that goes on beside the road for so long would be contrived."""
    person = Drawn(walks(40, 12.0, (9, 3.2), heading=-np.pi / 2))
    assert "off_road" not in told(episode(AV, person, road=STREET))[1]


def test_who_leaves_the_road_errs_and_who_stands_there_does_not():
    av = straight(0, 0, 8)
    av[:, 1] = np.interp(np.arange(91), [30, 50], [0, -4.5])
    found = told(episode(av, Drawn(walks(44, -6.5, (9, 0.5))), road=STREET))
    assert found[2:] == ("left_road", "")


def test_no_person_moves_like_that_and_what_touched_before_is_no_finding():
    bolt = Drawn(walks(58, 28, (9, 5.0), heading=-np.pi / 2))
    assert "infeasible" in told(episode(AV, bolt, road=STREET))[1]
    found = episode(AV, far_walker(58), road=STREET)
    before = contact_of(kind="opponent_other", step=20, first="b", second="c")
    rollout = replace(found.rollout, contacts=(before, *found.rollout.contacts))
    assert told(Episode(rollout, found.case))[:2] == ("C", ("touched_another",))


def test_a_standing_av_is_not_blamed():
    person = Drawn(walks(2.0, -4.0, (9, 1.4)))
    assert "av_stood" in told(episode(straight(0, 0, 0), person, road=STREET))[1]


def test_causes_of_hits_by_people_are_found():
    found = episode(AV, far_walker(58), road=STREET)
    cause = cause_of(found)
    assert cause.change != "none"
    assert {*cause.last_moment_s} == {"vru", "search"}
    onset = hit_of(found).onset_s
    assert all(at is None or at <= onset + 1e-9 for at in cause.last_moment_s.values())
