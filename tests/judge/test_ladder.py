"""The ladder: hits made by hand, whose rung is evident."""

from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.judge.hits import hit_of
from deepmf_sumo.judge.ladder import _av_error, verdict
from deepmf_sumo.judge.metrics import Episode, NotMeasurable
from deepmf_sumo.judge.metrics.findings import finding, rung
from deepmf_sumo.scene import Lane, Neighbour, Plan, RoadMap, SignalState
from deepmf_sumo.scene.geometry import boxes
from deepmf_sumo.scene.signals import STATE_OF

from tests.support.rollout_doubles import case_of, contact_of, in_traffic, rollout_of

STEPS = 91
NORTH, WEST = np.pi / 2, np.pi


def lane(name, *points, **more):
    return Lane(
        id=name, kind="street", centre_m=np.array(points, float), z_m=np.zeros(len(points)),
        width_m=3.5, speed_limit_mps=14.0, **more,
    )  # fmt: skip


def beside(name):
    return (Neighbour(lane_id=name, self_start=0, self_end=1, other_start=0, other_end=1),)


def road_of(*lanes):
    return RoadMap(lanes={one.id: one for one in lanes})


STREET = road_of(
    lane("east", (-200, 0), (300, 0), left=beside("fast")),
    lane("fast", (-200, 3.5), (300, 3.5), right=beside("east")),
    lane("back", (300, 7), (-200, 7)),
)
"""Two lanes to the east, one to the west."""


def junction(*, east_yields=False, north_yields=False):
    """A road to the east and one to the north meet at the origin."""
    return road_of(
        lane("west", (-200, 0), (-10, 0), next=("east",)),
        lane("east", (-10, 0), (200, 0), interpolating=True, previous=("west",),
             gives_way_to=("north",) * east_yields),
        lane("south", (0, -200), (0, -10), next=("north",)),
        lane("north", (0, -10), (0, 200), interpolating=True, previous=("south",),
             gives_way_to=("east",) * north_yields),
    )  # fmt: skip


def driven(*parts, x=0.0, y=0.0, heading=0.0):
    """(T, 3) a vehicle that is at x, y now; parts: (seconds, acceleration) after now."""
    first, *accelerations = parts
    speed = np.full(STEPS, float(first))
    at = 10
    for seconds, accel in accelerations:
        end = min(at + round(10 * seconds), STEPS - 1)
        for step in range(at, end):
            speed[step + 1 :] = max(speed[step] + 0.1 * accel, 0.0)
        at = end
    along = np.concatenate([[0.0], np.cumsum(0.1 * (speed[1:] + speed[:-1]) / 2)])
    along -= along[10]
    pose = np.stack([x + along * np.cos(heading), y + along * np.sin(heading)], -1)
    return np.concatenate([pose, np.full((STEPS, 1), heading)], axis=1)


def aside(path, metres, begin, seconds=2.0):
    """The path moved to the left in some seconds from a step on, with the headings for it."""
    share = np.clip((np.arange(STEPS) - begin) / (10 * seconds), 0, 1)
    smooth = share**2 * (3 - 2 * share)
    moved = path.copy()
    normal = np.stack([-np.sin(path[:, 2]), np.cos(path[:, 2])], -1)
    moved[:, :2] += metres * smooth[:, None] * normal
    step = np.gradient(moved[:, :2], axis=0)
    moving = np.hypot(*step.T) > 0.05
    moved[moving, 2] = np.arctan2(step[moving, 1], step[moving, 0])
    return moved


def episode_of(
    av, opponent, road=STREET, alone=None, lights=None, delta_v=4.0, others=(), sector=0,
    recorded=False,
):  # fmt: skip
    """The episode up to the first overlap; ``alone``: the opponent without the attack."""
    size = np.array([4.8, 2.0])
    touch = boxes.touching(av[:, :2], av[:, 2], size, opponent[:, :2], opponent[:, 2], size)
    assert touch[11:].any(), "they do not meet"
    step = 11 + int(touch[11:].argmax())
    contact = replace(
        contact_of(step=step),
        pose_first=av[step],
        pose_second=opponent[step],
        delta_v_mps=delta_v,
        sector=sector,
    )
    paths = {"av": av[: step + 1], "b": opponent[: step + 1]}
    rollout = rollout_of(paths, [*others, contact])
    if lights:
        rollout = replace(rollout, signals=(lights,) * (step - 10))
    expected = opponent if alone is None else alone
    case = replace(case_of({"av": av, "b": expected}), road=road)
    return Episode(rollout, in_traffic(case) if lights and not recorded else case)


def told(*args, **more):
    found = verdict(episode_of(*args, **more))
    return found.rung, found.reasons, found.av_error, found.opponent_error


AV = driven(10)


def test_a_miss_has_no_rung():
    episode = Episode(rollout_of({"av": AV, "b": driven(10, y=3.5)}), case_of())
    assert verdict(episode) is None
    assert finding.compute(episode) == 0
    with pytest.raises(NotMeasurable, match="did not collide"):
        rung.compute(episode)


def braking_leader(mps2, gap=25.0):
    return driven(10, (1, 0.0), (8, -mps2), x=gap)


def test_an_av_that_drives_into_the_one_ahead_errs():
    episode = episode_of(AV, braking_leader(4), alone=driven(10, x=25))
    assert told(AV, braking_leader(4)) == ("A", ("struck_ahead",), "struck_ahead", "")
    assert (finding.compute(episode), rung.compute(episode)) == (1, 0)


def test_drivers_hardly_brake_harder_than_6_mps2():
    """At 30 m the careful AV stops in time behind either."""
    assert told(AV, braking_leader(5.8, 30))[0] == "A"
    hard = told(AV, braking_leader(7.5, 30), alone=driven(10, x=30))
    assert hard == ("B", ("braked_hard",), "struck_ahead", "braked_hard")


def test_a_manoeuvre_is_enough_where_both_erred():
    """At 14 m no reference driver can stop in time; without the AV's small gap it would."""
    found = verdict(episode_of(AV, braking_leader(7.5, 14), alone=driven(10, x=14)))
    assert (found.rung, found.av_error, found.avoided_by) == ("B", "struck_ahead", ("search",))


def test_an_av_that_drives_into_what_stands_errs():
    """Whatever stands there: the other stands across the lane."""
    ahead = driven(0, x=70, heading=NORTH)
    assert told(AV, ahead) == ("A", ("struck_standing",), "struck_standing", "")


def from_south(speed, y, *more):
    return driven(speed, *more, y=y, heading=NORTH)


MEETS = from_south(10, -40)
AV_MEETS = driven(10, x=-40)


def test_what_crawled_for_long_enough_to_be_seen_stood():
    """The AV reaches it after 6.7 s; it is slower than 1 m/s since 2.4 or 2.7 s before."""
    for crawls_s, error in ((2.3, ""), (2.6, "struck_standing")):
        begin_s = 5.7 - crawls_s
        y = -4 * begin_s - 2.3 - 0.6 * crawls_s
        slows = driven(4, (begin_s, 0), (1.0, -3.4), x=70, y=y, heading=NORTH)
        assert told(AV, slows)[2] == error


def test_what_was_not_there_for_long_enough_was_not_seen_to_stand():
    episode = episode_of(AV, driven(0, x=70, heading=NORTH))
    contact = hit_of(episode).meeting.step
    for there_s, error in ((2.4, ""), (2.5, "struck_standing")):
        tracks = episode.rollout.tracks
        valid = tracks.valid.copy()
        valid[tracks.row("b"), : contact - round(10 * there_s)] = False
        rollout = replace(episode.rollout, tracks=replace(tracks, valid=valid))
        assert verdict(Episode(rollout, episode.case)).av_error == error


def test_who_turns_across_gives_way_even_to_who_leaves_its_lane():
    episode = episode_of(AV_MEETS, MEETS, road=junction())
    hit = replace(hit_of(episode), conflict="left turn across path", strayed=True, priority="")
    assert _av_error(episode, replace(hit, turned="AV")) == "took_priority"
    assert _av_error(episode, replace(hit, turned="opponent")) == ""
    assert _av_error(episode, replace(hit, turned="AV", priority="AV")) == ""


def test_who_takes_the_priority_errs():
    """Two roads cross; both arrive at the same time."""
    yields = told(AV_MEETS, MEETS, road=junction(east_yields=True))
    assert yields == ("A", ("took_priority",), "took_priority", "")
    has = told(AV_MEETS, MEETS, road=junction(north_yields=True))
    assert has == ("B", ("took_priority",), "", "took_priority")
    assert told(AV_MEETS, MEETS, road=junction()) == ("B", ("neither_erred",), "", "")


GO, STOP = SignalState.GO, SignalState.STOP


def test_who_passes_a_red_light_errs():
    def at(mine, theirs):
        lights = {"east": mine, "north": theirs}
        return told(AV_MEETS, MEETS, road=junction(), lights=lights)

    assert at(STOP, GO) == ("A", ("ran_light",), "ran_light", "")
    assert at(GO, STOP) == ("B", ("ran_light",), "", "ran_light")
    assert at(STOP, STOP) == ("B", ("ran_light",), "ran_light", "ran_light")
    assert at(SignalState.CAUTION, GO)[2] == ""  # yellow is no red


def test_turning_right_at_a_red_light_is_no_error_by_itself_in_recordings():
    """Where it is allowed after a stop, SUMO's light is not red, but flashes (its letter s)."""
    corner = np.array([(-10, 0), (-6, -0.5), (-2, -3), (0, -8), (0, -10)], float)
    road = road_of(
        lane("west", (-200, 0), (-10, 0), next=("right",)),
        lane("right", *corner, next=("out",), previous=("west",), interpolating=True),
        lane("north", (0, 200), (0, 10), next=("down",)),
        lane("down", (0, 10), (0, -10), next=("out",), previous=("north",), interpolating=True),
        lane("out", (0, -10), (0, -200), previous=("right", "down")),
    )
    way = np.concatenate([[(-40, 0)], corner, [(0, -80)]])
    along = np.concatenate([[0.0], np.hypot(*np.diff(way, axis=0).T).cumsum()])
    at = 8.0 * 0.1 * np.arange(STEPS)
    av = np.stack([np.interp(at, along, way[:, axis]) for axis in (0, 1)], -1)
    step = np.gradient(av, axis=0)
    av = np.column_stack([av, np.arctan2(step[:, 1], step[:, 0])])
    straight_on = driven(8, x=0, y=27, heading=-NORTH)

    def error(light, **more):
        lights = {"right": light, "down": GO}
        return told(av, straight_on, road=road, lights=lights, **more)[2]

    assert error(STOP, recorded=True) == "took_priority"
    assert error(STATE_OF["s"]) == "took_priority"
    assert error(STATE_OF["r"]) == "ran_light"


def test_an_av_that_moves_over_into_a_vehicle_errs():
    over = aside(AV, 3.5, 30)
    assert told(over, driven(10, x=2, y=3.5)) == ("A", ("moved_over",), "moved_over", "")
    both = told(aside(AV, 1.75, 30), aside(driven(10, x=2, y=3.5), -1.75, 30))
    assert both[3] == "cut_in"


def test_an_av_that_comes_into_the_oncoming_lane_errs():
    oncoming = driven(10, x=120, y=7, heading=WEST)
    assert told(aside(AV, 7, 30, 3.0), oncoming) == ("A", ("left_lane",), "left_lane", "")


def test_a_cut_in_that_a_careful_driver_avoids():
    """It moves over 13 m ahead, at 6 m/s."""
    path = driven(6, x=18, y=3.5)
    found = verdict(episode_of(AV, aside(path, -3.5, 11, 2.5), alone=path))
    assert (found.rung, found.reasons, found.av_error) == ("B", ("cut_in",), "")
    assert found.avoided_by == ("cc", "fsm", "rss", "search")


def test_who_drives_far_above_the_limit_errs():
    """The limit is 14 m/s, and SUMO's drivers exceed it somewhat."""
    crossing = junction(east_yields=True)
    fast, quick = (from_south(speed, -4 * speed) for speed in (20, 16))
    assert told(AV_MEETS, quick, road=crossing)[0] == "A"
    assert told(AV_MEETS, fast, road=crossing)[2:] == ("took_priority", "sped")


def test_nothing_is_found_by_running_into_an_av_that_stands_or_creeps():
    for speed, contrived in ((0.0, True), (1.3, True), (1.6, False)):
        av = driven(speed, x=-2 - 4 * speed)
        reasons = told(av, MEETS, road=junction(east_yields=True))[1]
        assert ("av_stood" in reasons) == contrived
    sets_off = driven(0, (2.85, 0), (5, 2.2), x=-4.2)  # 1.65 m/s at the contact, after 0.7 m
    assert "av_stood" in told(sets_off, MEETS, road=junction(east_yields=True))[1]
    brakes = driven(10, (1.85, 0), (5, -5), x=-30.5)  # 1 m/s at the contact, 6 m/s before
    assert "av_stood" not in told(brakes, MEETS, road=junction(east_yields=True))[1]


def test_a_touch_is_no_finding():
    for kmh, reasons in ((4.9, ("low_delta_v",)), (5.1, ("struck_ahead",))):
        assert told(AV, braking_leader(4), delta_v=kmh / 3.6)[1] == reasons


def test_a_car_behind_can_ram_anybody_anywhere():
    behind = driven(10, (8, 2.0), x=-15)
    assert told(AV, behind)[:2] == ("C", ("rammed",))


JOINED = road_of(
    lane("main", (-200, 0), (-10, 0), next=("on",)),
    lane("ramp", (-200, 3.5), (-10, 3.5), next=("on",)),
    lane("on", (-10, 0), (200, 0)),
)


@pytest.mark.parametrize(("sector", "contrived"), [(1, False), (2, False), (3, True), (5, True)])
@pytest.mark.parametrize("road", [STREET, JOINED])
def test_who_moves_over_or_merges_into_the_rear_of_the_av_rams_it(road, sector, contrived):
    path = driven(10, x=-38, y=3.5)
    more = {"alone": path, "road": road, "sector": sector}
    episode = episode_of(driven(10, x=-36), aside(path, -3.5, 30, 2.5), **more)
    assert hit_of(episode).conflict == ("merging" if road is JOINED else "lane change")
    assert ("rammed" in verdict(episode).reasons) == contrived


def test_nobody_drives_against_the_traffic_for_more_than_a_moment():
    """An oncoming car comes over the middle: late, it has met the AV after a moment."""
    oncoming, av = driven(10, x=120, y=7, heading=WEST), driven(10, y=3.5)
    late = told(av, aside(oncoming, 3.5, 55, 2.2), alone=oncoming)
    assert late == ("D", ("only_search",), "", "left_lane")
    moment = verdict(episode_of(av, aside(oncoming, 3.5, 53, 2.2), alone=oncoming))
    assert "against_traffic" not in moment.reasons
    early = told(av, aside(oncoming, 3.5, 25, 2.2), alone=oncoming)
    assert early[:2] == ("C", ("against_traffic",))


def test_nobody_drives_beside_the_road_for_more_than_a_moment():
    path = driven(6, x=25, y=3.5)
    detour = aside(aside(path, 12.0, 15), -15.5, 40)
    assert "off_road" in told(AV, detour, alone=path)[1]
    drive = told(AV, driven(4, x=45, y=-20, heading=NORTH))  # out of a drive, which no map knows
    assert drive[0] == "B"


def test_no_car_accelerates_like_that():
    assert "infeasible" in told(AV_MEETS, from_south(2, -50, (1, 0), (6, 10)), road=junction())[1]


def test_what_has_touched_another_before_is_no_finding():
    before = contact_of(kind="opponent_other", step=20, first="b", second="c")
    assert told(AV, braking_leader(4), others=[before])[1] == ("touched_another",)
    assert told(AV, braking_leader(4), others=[replace(before, step=89)])[0] == "A"


def test_what_nobody_avoids_is_no_finding():
    """It moves over from beside the AV."""
    narrow = replace(STREET.lanes["east"], width_m=2.4)
    road = road_of(narrow, STREET.lanes["fast"], STREET.lanes["back"])
    path = driven(10, x=1, y=2.8)
    found = verdict(episode_of(AV, aside(path, -2.8, 11, 2.0), alone=path, road=road))
    assert (found.rung, found.reasons, found.avoided_by) == ("D", ("unavoidable",), ())


def with_supporter(path, contacts=()):
    """A hit that drivers avoid by braking, with a supporter ``s`` on a path."""
    episode = episode_of(
        AV, braking_leader(7.5, 30), alone=driven(10, x=30), others=contacts, road=STREET
    )
    tracks = episode.rollout.tracks
    poses = np.concatenate([tracks.position_m, tracks.heading_rad[..., None]], axis=-1)
    paths = {**dict(zip(tracks.ids, poses, strict=True)), "s": path[: tracks.steps]}
    plan = Plan(
        agent_id="s", first_step=11, position_m=path[11:, :2], heading_rad=path[11:, 2],
        speed_mps=np.full(STEPS - 11, 10.0), supports="b",
    )  # fmt: skip
    rollout = rollout_of(paths, episode.rollout.contacts, plans=[plan])
    return verdict(Episode(rollout, episode.case))


BESIDE_IT = driven(10, y=3.5)


def test_a_supporter_that_touches_nobody_takes_nothing_from_a_finding():
    found = with_supporter(BESIDE_IT)
    assert (found.rung, found.reasons) == ("B", ("braked_hard",))
    assert "cc" in found.avoided_by


@pytest.mark.parametrize(
    ("kind", "first", "second"),
    [("supporter_other", "s", "c"), ("opponent_other", "b", "s"), ("av_other", "av", "s")],
)
def test_a_hit_whose_supporter_touched_anybody_is_contrived(kind, first, second):
    touched = contact_of(kind, step=20, first=first, second=second)
    found = with_supporter(BESIDE_IT, [touched])
    assert (found.rung, found.reasons[-1]) == ("C", "supporter_touched")
    own = {"touched_another"} if kind != "supporter_other" else set()
    assert {*found.reasons} == own | {"supporter_touched"}


def test_drivers_that_brake_into_a_supporter_avoid_nothing():
    """It follows 7 m behind, does not brake, and hits whoever does; swerving still helps."""
    found = with_supporter(driven(10, x=-12))
    assert found.avoided_by == ("search",)


def test_an_av_between_two_lanes_has_not_left_its_own():
    """An oncoming car drives on the AV's side; the AV evades to the lane beside."""
    oncoming = driven(8, x=70, y=3.2, heading=np.pi)
    av = aside(driven(8), 1.7, 20)
    one = episode_of(av, oncoming)
    hit = hit_of(one)
    assert (hit.conflict, hit.strayed) == ("head-on", True)
    assert verdict(one).opponent_error == "left_lane"
    assert verdict(one).av_error == ""
