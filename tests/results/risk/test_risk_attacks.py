import json

import pytest

from deepmf_sumo.errors import UsageError
from deepmf_sumo.results import risk
from deepmf_sumo.sumo.network import sumo_tools

from tests.support import worth_doubles
from tests.support.risk_doubles import LEFT_IN, NET, Attacks, eastward, straight

ENDED = {"ended": "longest", "outcome": "none", "hit_speed_mps": None}


def only(out):
    [network] = risk.read([out])
    [attack] = network.attacks
    return attack


def test_a_hit_counts_where_the_av_was_at_the_contact(tmp_path):
    """10 m/s from x = -150 m: after 90 steps of 0.1 s the AV has come to -60 m."""
    out = Attacks(tmp_path / "out")
    out.add("a", av=eastward(), opponent=eastward(x=-160), hit=90)
    attack = only(tmp_path / "out")
    assert (attack.decided.edge, attack.decided.lane) == ("w_in", "w_in_1")
    assert attack.place_m == pytest.approx((-60.0, -4.8))
    assert attack.hit
    assert attack.finding
    assert attack.worth.avoided_by == ("cc", "search")
    assert attack.delta_v_mps == 6.0


def test_without_a_contact_the_least_gap_counts(tmp_path):
    """The opponent stands beside the road at x = -120 m: boxes of 4.5 m are nearest from -124 m."""
    out = Attacks(tmp_path / "out")
    out.add("a", av=eastward(), opponent=straight((-120.0, -14.0), 0.0, 0.0))
    attack = only(tmp_path / "out")
    assert attack.place_m[0] == pytest.approx(-124.0)
    assert attack.decided.edge == "w_approach"
    assert not attack.hit
    assert attack.worth is None


def test_a_touch_of_somebody_else_is_no_hit(tmp_path):
    out = Attacks(tmp_path / "out")
    out.add("a", av=eastward(), opponent=eastward(x=-200), other=20)
    attack = only(tmp_path / "out")
    assert attack.other
    assert not attack.hit
    assert attack.place_m[0] == pytest.approx(-130.0)


def test_it_began_before_the_movement_that_was_ahead(tmp_path):
    out = Attacks(tmp_path / "out")
    left = straight((-80.0, -1.6), 5.0, 0.0, steps=60)
    out.add("a", av=left, opponent=eastward(), hit=40, moment=(*LEFT_IN, "left"))
    attack = only(tmp_path / "out")
    assert attack.began.movement == "centre: w_in -> n_out"
    assert attack.began.edge == "w_in"
    assert attack.decided.movement == ""


def test_without_moments_the_movement_that_it_came_to(tmp_path):
    out = Attacks(tmp_path / "out")
    out.add("a", av=eastward(x=-40.0), opponent=eastward(x=-60.0), hit=45)
    attack = only(tmp_path / "out")
    assert attack.began.edge == "w_in"
    assert attack.began.movement == attack.decided.movement == "centre: w_in -> e_out"


def test_lanes_over_each_other_are_told_apart_by_the_route(tmp_path):
    """Right and straight leave the rightmost lane as one: two metres on, only the route knows."""
    path = straight((-60.0, -8.0), 10.0, 0.0, steps=46)
    for name, following, turn in (("straight", "e_out", "straight"), ("right", "s_out", "right")):
        out = Attacks(tmp_path / name)
        moment = "w_in", following, turn
        out.add("a", av=path, opponent=eastward(), hit=44, moment=moment)
        assert only(tmp_path / name).decided.movement == f"centre: w_in -> {following}"


def test_what_is_beside_all_roads_is_at_no_place(tmp_path):
    out = Attacks(tmp_path / "out")
    out.add("a", av=straight((100.0, 100.0), 5.0, 0.0), opponent=eastward(), hit=30)
    assert only(tmp_path / "out").decided.of("edge") == ""


def test_it_is_known_where_the_opponent_was(tmp_path):
    """The AV goes straight from the west, the opponent turns left before it from the east."""
    out = Attacks(tmp_path / "out")
    turning = straight((2.0, -2.6), 4.0, -2.5, steps=20)
    out.add("a", av=straight((-28.0, -4.8), 12.0, 0.0, steps=20), opponent=turning, hit=19)
    [network] = risk.read([tmp_path / "out"])
    assert network.attacks[0].decided.movement == "centre: w_in -> e_out"
    [conflict] = risk.conflicts(network)
    assert conflict.place == "centre: from west to east (straight, protected)"
    assert conflict.against == "centre: from east to south (left, permissive)"
    assert (conflict.attacks, conflict.hits, conflict.findings, conflict.judged) == (1, 1, 1, 1)


@pytest.fixture(scope="module")
def without_lanes_inside(tmp_path_factory, starts_sumo):
    """The junction as a network that has no lanes in it."""
    net = tmp_path_factory.mktemp("net") / "bare.net.xml"
    sumo_tools.run("netconvert", "-s", str(NET), "--no-internal-links", "-o", str(net))
    return net


@pytest.mark.parametrize("moment", [None, ("w_in", "e_out", "straight")])
def test_networks_without_lanes_in_junctions(without_lanes_inside, tmp_path, moment):
    """Without a route the edges before and behind tell; on the way out the AV is on an edge."""
    out = Attacks(tmp_path / "out", net=without_lanes_inside)
    path = straight((-60.0, -4.8), 12.0, 0.0, steps=91)
    out.add("a", av=path, opponent=straight((0.0, 5.0), 0.0, 0.0), hit=50, moment=moment)
    attack = only(tmp_path / "out")
    assert attack.place_m == pytest.approx((0.0, -4.8))
    assert attack.decided.movement == "centre: w_in -> e_out"
    assert attack.decided.edge == ""


def test_turns_are_attacks_of_their_own(tmp_path):
    """Turn 1 without a hit up to 2 s, turn 2 with one at 5 s."""
    turns = [
        {"opponent": "foe", "begin_s": 0.0, "end_s": 2.0, **ENDED, "metrics": {"ttc_min": 3.0}},
        {
            "opponent": "foe",
            "begin_s": 4.0,
            "end_s": 5.0,
            **ENDED,
            "metrics": worth_doubles.metrics("C", by=()),
        },
    ]
    out = Attacks(tmp_path / "out")
    out.add("a", av=eastward(), opponent=eastward(x=-155.0), hit=60, turns=turns)
    [network] = risk.read([tmp_path / "out"])
    first, second = network.attacks
    assert (first.turn, first.hit, first.ttc_s) == (1, False, 3.0)
    assert (second.turn, second.hit, second.finding, second.worth.rung) == (2, True, False, "C")
    assert first.place_m[0] < -120 < second.place_m[0]


def test_what_is_not_counted_is_told(tmp_path):
    out = Attacks(tmp_path / "out")
    out.add("a", av=eastward(), opponent=eastward(x=-160), hit=90)
    out.add("b", av=eastward())
    out.add("c", av=eastward(), opponent=eastward(), status="failed")
    out.add("d", av=eastward(), opponent=eastward(), network=None)
    damaged = out.add("e", av=eastward(), opponent=eastward())
    (tmp_path / "out" / "runs" / damaged / "tracks.csv.gz").write_bytes(b"no gzip")
    out.keys["never-begun"] = "x"
    out.write()
    [network] = risk.read([tmp_path / "out"])
    assert len(network.attacks) == 1
    assert network.left_out == {
        "with no vehicle to attack": 1,
        "failed": 1,
        "on recorded scenes": 1,
        "without readable tracks": 1,
        "without a result": 1,
    }


def test_folders_of_folders(tmp_path):
    for seed in range(3):
        out = Attacks(tmp_path / "all" / str(seed))
        out.add("a", seed, av=eastward(), opponent=eastward(x=-160), hit=90)
    [network] = risk.read([tmp_path / "all"])
    assert [one.seed for one in network.attacks] == [0, 1, 2]


def test_what_cannot_be_mapped_is_refused(tmp_path):
    with pytest.raises(UsageError, match=r"no manifest\.json"):
        risk.read([tmp_path])
    out = Attacks(tmp_path / "out")
    out.add("a", av=eastward(), opponent=eastward(), network=None)
    with pytest.raises(UsageError, match="1 on recorded scenes"):
        risk.read([tmp_path / "out"])
    broken = Attacks(tmp_path / "broken")
    broken.add("a", av=eastward(), opponent=eastward(), contacts=None)
    with pytest.raises(UsageError, match="is not a result of this version"):
        risk.read([tmp_path / "broken"])
    (tmp_path / "out" / "manifest.json").write_text(json.dumps({"runs": 3}))
    with pytest.raises(UsageError, match="names no runs"):
        risk.read([tmp_path / "out"])


def test_what_ends_a_turn_is_not_the_next_ones_too(tmp_path):
    """The AV touches somebody else at the step at which one turn ends and the next begins."""
    turns = [
        {"opponent": "foe", "begin_s": begin, "end_s": begin + 2.0, **ENDED, "metrics": {}}
        for begin in (0.0, 2.0)
    ]
    out = Attacks(tmp_path / "out")
    out.add("a", av=eastward(), opponent=eastward(x=-155.0), other=30, turns=turns)
    [network] = risk.read([tmp_path / "out"])
    assert [one.other for one in network.attacks] == [True, False]


def test_a_folder_that_is_named_twice_counts_once(tmp_path):
    out = Attacks(tmp_path / "all" / "0")
    out.add("a", av=eastward(), opponent=eastward(x=-160), hit=90)
    [network] = risk.read([tmp_path / "all", tmp_path / "all" / "0", tmp_path / "all"])
    assert len(network.attacks) == 1


def test_a_network_without_a_readable_attack_is_told_and_no_network(tmp_path):
    out = Attacks(tmp_path / "out")
    run_id = out.add("a", av=eastward(), opponent=eastward())
    (tmp_path / "out" / "runs" / run_id / "tracks.csv.gz").unlink()
    with pytest.raises(UsageError, match="1 without readable tracks"):
        risk.read([tmp_path / "out"])
    out.add("b", av=eastward(), opponent=eastward(x=-160), hit=90, network="other")
    [network] = risk.read([tmp_path / "out"])
    assert (network.name, network.left_out) == ("other", {"without readable tracks": 1})


def test_damaged_tables_are_refused(tmp_path):
    out = Attacks(tmp_path / "out")
    out.add("a", av=eastward(), opponent=eastward(x=-160), hit=90)
    (tmp_path / "out" / "moments.csv").write_text("av,start_s\ncar,3.0\n")
    with pytest.raises(UsageError, match=r"moments\.csv is not a table of moments"):
        risk.read([tmp_path / "out"])
    (tmp_path / "out" / "moments.csv").unlink()
    (tmp_path / "out" / "manifest.json").write_text("[]")
    with pytest.raises(UsageError, match="it is not a mapping"):
        risk.read([tmp_path / "out"])
