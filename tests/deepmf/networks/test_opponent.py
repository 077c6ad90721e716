from dataclasses import replace

import numpy as np
import pytest
import torch

from deepmf_sumo.deepmf.networks import torch_networks
from deepmf_sumo.deepmf.networks.config import LIGHT, UNPAIRED
from deepmf_sumo.deepmf.networks.densetnt import as_batch
from deepmf_sumo.deepmf.networks.lanes import road_index
from deepmf_sumo.deepmf.networks.opponent import (
    OTHERS,
    SPACING_M,
    Opponent,
    Pair,
    lane_routes,
    opponent_features,
    pair_columns,
    surroundings,
)
from deepmf_sumo.errors import WeightsError
from deepmf_sumo.scene import SignalState

from tests.support.synthetic import crossing, scene, view


def pair(seen, agent_id):
    """What is known of a vehicle and the AV, by column."""
    around = surroundings(seen)
    row, count = around.ids(seen).index(agent_id), around.vehicles
    return {
        column: float(np.broadcast_to(values, count)[row])
        for column, values in pair_columns(seen, around).items()
    }


@pytest.fixture(scope="module")
def net():
    """Random weights, those that begin at zero too."""
    torch.manual_seed(0)
    made = torch_networks.build("opponent", LIGHT).eval()
    for member in made.members:
        torch.nn.init.normal_(member.scene[-1].weight, std=0.1)
    return made


def poses(seen, *ids):
    rows = [seen.history.row(each) for each in ids]
    tracks = seen.history
    return tracks.position_m[rows, -1], tracks.heading_rad[rows, -1], tracks.speed_mps[rows, -1]


def test_routes_follow_the_lane_graph():
    seen = view()
    found = lane_routes(seen.road, *poses(seen, "av", "parked", "south"), seen.signals)
    assert found.owner.tolist() == [0, 0, 2]  # straight on and left; none off the lanes; straight
    assert found.rank.tolist() == [0, 1, 0]
    assert found.node_m[0, 0] == pytest.approx([-50, 0], abs=0.1)
    assert found.node_m[0, 20] == pytest.approx([30, 0], abs=0.5)
    assert found.direction[1, 25] == pytest.approx([0, 1], abs=1e-6)  # turned to the north
    step = np.linalg.norm(np.diff(found.node_m, axis=1), axis=-1)
    assert step == pytest.approx(np.full_like(step, SPACING_M), abs=0.1)
    assert found.end_m[0] == pytest.approx(180.0)
    assert found.end_m[2] == pytest.approx(180.0)


def test_routes_know_the_signal_ahead():
    seen = view()
    found = lane_routes(seen.road, *poses(seen, "av"), {"through": SignalState.STOP})
    assert found.stop_m == pytest.approx([40.0, 200.0], abs=0.1)
    assert found.signal.tolist() == [[1, 0, 0, 0], [0, 0, 0, 0]]


def test_a_vehicles_routes_do_not_depend_on_the_others():
    seen = view()
    alone = lane_routes(seen.road, *poses(seen, "south"), seen.signals)
    many = lane_routes(seen.road, *poses(seen, "av", "far", "south"), seen.signals)
    assert many.node_m[many.owner == 2] == pytest.approx(alone.node_m)


def test_a_road_without_lanes_has_no_routes():
    seen = view()
    road = replace(crossing(), lanes={})
    found = lane_routes(road, *poses(seen, "av", "south"), {})
    assert len(found.owner) == 0
    assert not road_index(road).on_lanes(*poses(seen, "av", "south")[:2], 2.0, 0.7).any()


def test_who_stands_across_a_lane_is_not_on_it():
    place = np.array([[-50.0, 1.0], [-50.0, 1.0], [-50.0, 3.0], [900.0, 900.0]])
    heading = np.array([0.1, 1.5, 0.0, 0.0])
    found = road_index(crossing()).on_lanes(place, heading, 2.0, 0.7)
    assert found.tolist() == [True, False, False, False]


def test_ways_at_constant_velocity_meet_where_they_do():
    seen = view(scene(shift=0.0))
    south = pair(seen, "south")
    assert south[Pair.STRAIGHT_SAME] == pytest.approx(0.0, abs=1e-6)
    times = Pair.STRAIGHT_SAME_TIME, Pair.STRAIGHT_TIME, Pair.STRAIGHT_AV_TIME
    assert [south[each] for each in times] == pytest.approx([10 / 16] * 3)  # at the crossing, 5 s
    assert south[Pair.STRAIGHT_LEAST] == pytest.approx(0.0, abs=1e-6)
    ways = south[Pair.RAY_AHEAD], south[Pair.RAY_AV_AHEAD], south[Pair.RAY_CROSSES]
    assert ways == pytest.approx((45 / 50, 1.0, 1.0))


def test_routes_that_cross_meet_at_the_crossing():
    seen = view()
    south = pair(seen, "south")
    assert south[Pair.MEETING_LEAST] * 10 < 2.5
    assert south[Pair.MEETING_AHEAD] * 50 == pytest.approx(45, abs=SPACING_M)
    assert south[Pair.MEETING_AV_AHEAD] * 50 == pytest.approx(50, abs=SPACING_M)
    flags = Pair.MEETING_SIN, Pair.MEETING_MET, Pair.MEETING_SOON, Pair.MEETING_AV_SOON
    assert [south[each] for each in flags] == pytest.approx([1.0] * 4, abs=1e-6)
    assert pair(seen, "parked")[Pair.MEETING_MET] == 0  # it has no route


def test_columns_of_pairs_have_one_name_each_and_are_all_made():
    seen = view()
    made = pair_columns(seen, surroundings(seen))
    assert set(Pair) - set(made) == {Pair.STANDS_IN, Pair.KNOWN}
    arrays, around = opponent_features(seen, LIGHT)
    for column, values in made.items():
        wanted = np.broadcast_to(values, around.vehicles).astype(np.float32)
        assert arrays["pair"][: around.vehicles, column].tolist() == wanted.tolist(), column


def test_columns_of_pairs_stand_where_trained_weights_read_them():
    seen = view()
    arrays, around = opponent_features(seen, LIGHT)
    south = arrays["pair"][around.ids(seen).index("south")]
    apart = np.hypot(50, 45)
    by_hand = {
        0: 50 / 30, 1: -45 / 30, 2: 4.0, 3: apart / 30, 4: np.log1p(apart) / 2, 6: 50 / apart,
        7: -45 / apart, 8: 0.0, 9: 1.0, 10: 0.0, 11: 9 / 15, 12: 9 / 15, 13: np.log1p(9), 18: 1.0,
        20: 4.8 / 5, 21: 2 / 2, 22: 45 / 30, 23: 50 / 30, 25: -1 / 15, 26: 10 / 15,
        27: np.log1p(10), 30: 1.0, 31: 4.8 / 5, 32: 2 / 30, 33: 1 / 15, 34: 0.0, 35: 10 / 16,
        36: 0.0, 37: 10 / 16, 38: 10 / 16, 39: 0.0, 41: 10 / 16, 46: 45 / 50, 47: 50 / 50,
        48: 5 / 8, 49: 5 / 8, 51: 1.0, 52: 0.0, 54: 180 / 100, 55: 0.0, 57: 1 / 5, 58: 1.0,
        66: 13.9 / 15, 68: 2 / 5, 69: 1.0, 72: 4.0, 75: -4.0, 78: 1.0, 79: 4.0, 83: 1.0, 91: 1.0,
        92: 1.0, 93: 1.0, 94: 1.0, 101: 0.0, 102: np.log1p(1), 109: 0.0, 110: 0.0, 111: 1.0,
    }  # fmt: skip
    found = {number: float(south[number]) for number in by_hand}
    assert found == pytest.approx(by_hand, abs=1e-5)


def test_vehicles_come_first_and_the_nearest_before_others():
    seen = view(scene(av_speed=10.0), step=60)
    around = surroundings(seen)
    assert around.ids(seen) == ("south", "parked", "waiting")
    assert around.parked.tolist() == [False, True, False]
    assert seen.history.ids[around.rows[4]] == "walker"
    arrays, _ = opponent_features(seen, LIGHT)
    assert arrays["vehicle"].sum() == 3
    assert arrays["pair"].shape == (OTHERS, len(Pair))
    assert not arrays["pair"][3:].any()


def test_more_agents_than_slots_are_cut():
    seen = view()
    many = seen.history.select([0] + [1] * 80)
    ids = ("av", *(f"v{number}" for number in range(80)))
    around = surroundings(replace(seen, history=replace(many, ids=ids)))
    assert around.vehicles == OTHERS


def test_features_turn_with_the_scene():
    plain, _ = opponent_features(view(), LIGHT)
    turned, _ = opponent_features(view(scene(turn=0.7)), LIGHT)
    assert turned["pair"] == pytest.approx(plain["pair"], abs=0.02)


def test_parked_vehicles_are_scored_on_demand_alone(net):
    seen = view(scene(av_speed=10.0), step=60)
    opponent = Opponent(net, 1.0, 1.0)
    some, everyone = opponent.score(seen), opponent.score(seen, everyone=True)
    assert some.ids == ("south", "waiting")
    assert everyone.ids == ("south", "parked", "waiting")
    assert some.logits == pytest.approx(everyone.logits[[0, 2]])
    assert some.partner_logits == pytest.approx(everyone.partner_logits[[0, 2]])


def test_scores_do_not_depend_on_what_else_is_in_the_batch(net):
    first, _ = opponent_features(view(), LIGHT)
    second, _ = opponent_features(view(scene(av_speed=10.0), step=60), LIGHT)
    both = {name: torch.from_numpy(np.stack([first[name], second[name]])) for name in first}
    with torch.inference_mode():
        alone, together = net(as_batch(first)), net(both)
    assert together.shape == (2, 2, OTHERS, 2)
    assert together[:, 0].numpy() == pytest.approx(alone[:, 0].numpy(), abs=1e-4)
    free = first["vehicle"] < 1
    assert not together[:, 0, free].any()


@pytest.mark.parametrize("branch", ["raster", "vectors"])
def test_each_encoder_acts_and_can_be_left_out(net, branch):
    preset = replace(LIGHT, **{branch: False})
    whole, _ = opponent_features(view(), LIGHT)
    arrays, _ = opponent_features(view(), preset)
    assert set(arrays) < set(whole)
    without = torch_networks.build("opponent", preset).eval()
    kept = {name: value for name, value in net.state_dict().items() if name in without.state_dict()}
    without.load_state_dict(kept)
    with torch.inference_mode():
        changed = (net(as_batch(whole)) - without(as_batch(arrays))).abs().max()
    assert changed > 1e-4


def test_without_pairs_vectors_and_image_alone_score_each_vehicle():
    torch.manual_seed(0)
    made = torch_networks.build("opponent", UNPAIRED).eval()
    whole, _ = opponent_features(view(), LIGHT)
    arrays, around = opponent_features(view(), UNPAIRED)
    assert set(whole) - set(arrays) == {"pair"}
    given = made.scored(arrays)
    assert np.array_equal(made.scored(whole), given)  # as in training, where all have all features
    assert len(set(given[: around.vehicles, 0])) == around.vehicles > 1
    for changed in ("agents", "lanes", "raster"):
        other = {**arrays, changed: np.zeros_like(arrays[changed])}
        assert np.abs(made.scored(other) - given).max() > 1e-4


def test_without_mixing_the_head_sees_one_vehicle_at_a_time():
    preset = replace(LIGHT, raster=False, vectors=False)
    arrays, around = opponent_features(view(), preset)
    other = {**arrays, "pair": arrays["pair"].copy()}
    other["pair"][0] += 1.0
    for mixing in (True, False):
        torch.manual_seed(0)
        made = torch_networks.build("opponent", replace(preset, mixing=mixing)).eval()
        moved = np.abs(made.scored(other) - made.scored(arrays))[: around.vehicles]
        assert moved[0].max() > 1e-4
        assert (moved[1:].max() > 1e-6) == mixing


def test_an_opponent_network_needs_something_of_each_vehicle():
    with pytest.raises(WeightsError, match="needs 'pairs' or 'vectors'"):
        torch_networks.build("opponent", replace(LIGHT, pairs=False, vectors=False))


def test_the_network_begins_as_one_on_pairs_alone():
    torch.manual_seed(0)
    made = torch_networks.build("opponent", LIGHT).eval()
    arrays, _ = opponent_features(view(), LIGHT)
    batch = as_batch(arrays)
    other = {**batch, "raster": torch.zeros_like(batch["raster"])}
    with torch.inference_mode():
        assert torch.equal(made(batch), made(other))
