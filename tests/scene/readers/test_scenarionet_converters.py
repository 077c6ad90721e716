"""What ScenarioNet's converters write differently from each other is read as the same scene."""

import pickle

import numpy as np
import pytest

from deepmf_sumo.scene import SignalState
from deepmf_sumo.scene.readers import Refusal, read_by, scenarionet

from tests.support import converted_by_hand as by_hand

CONVERTERS = [by_hand.nuscenes, by_hand.nuplan, by_hand.argoverse, by_hand.metadrive]


@pytest.fixture
def read(tmp_path):
    def read(described):
        file = tmp_path / "scene.pkl"
        file.write_bytes(pickle.dumps(described))
        (found,) = read_by(scenarionet, file)
        assert not isinstance(found, Refusal), found.reason
        return found

    return read


def said(scene, words):
    return any(words in one for one in scene.repairs)


@pytest.mark.parametrize("converted", CONVERTERS)
def test_lanes_are_where_they_are_and_linked_where_they_meet(read, converted):
    road = read(converted()).road
    for name, points in by_hand.LANES.items():
        found = road.lanes[name]
        assert found.centre_m[[0, -1]] == pytest.approx(points[[0, -1]], abs=1e-5)
        assert found.next == tuple(by_hand.NEXT.get(name, ()))
        assert found.previous == tuple(by_hand.PREVIOUS.get(name, ()))


@pytest.mark.parametrize("converted", CONVERTERS)
def test_lanes_side_by_side_are_neighbours(read, converted):
    scene = read(converted())
    beside = {
        (lane.id, side, one.lane_id)
        for lane in scene.road.lanes.values()
        for side in ("left", "right")
        for one in getattr(lane, side)
    }
    assert beside == {("right", "left", "left"), ("left", "right", "right")}
    lanes = scene.road.lanes
    (one,) = lanes["right"].left
    for start, end in ((one.self_start, one.other_start), (one.self_end, one.other_end)):
        away = lanes["left"].centre_m[end] - lanes["right"].centre_m[start]
        assert away == pytest.approx([0.0, 3.5], abs=1e-4)
    assert one.self_end == len(lanes["right"].centre_m) - 1
    assert said(scene, "2 neighbours were inferred from the geometry")


@pytest.mark.parametrize("converted", CONVERTERS)
def test_motion_is_as_recorded(read, converted):
    scene = read(converted())
    av = scene.tracks.row(scene.av_id)
    assert scene.tracks.velocity_mps[av] == pytest.approx(np.tile([10.0, 0.0], (91, 1)))
    assert scene.tracks.size_m[av].tolist() == [4.9, 1.9, 1.6]
    car = scene.tracks.row("car")
    seen = scene.tracks.valid[car]
    assert scene.tracks.velocity_mps[car][seen] == pytest.approx(
        np.tile([8.0, 0.0], (seen.sum(), 1))
    )
    assert scene.tracks.kinds[scene.tracks.row("cone")] == "other"
    assert said(scene, "1 tracks of the kinds TRAFFIC_CONE were read as 'other'.")


def test_neighbours_are_beside_each_other_wherever_they_start(read):
    described = by_hand.nuplan()
    described["map_features"]["left"]["polyline"] = by_hand.straight((60, 3.5), (160, 3.5))[::2]
    lanes = read(described).road.lanes
    for lane, listed in (
        (lanes["right"], lanes["right"].left),
        (lanes["left"], lanes["left"].right),
    ):
        (one,) = listed
        other = lanes[one.lane_id]
        for own, its in ((one.self_start, one.other_start), (one.self_end, one.other_end)):
            assert abs(lane.centre_m[own] - other.centre_m[its])[0] <= 2.0
        assert lane.centre_m[one.self_start, 0] == pytest.approx(60, abs=1.5)
        assert lane.centre_m[one.self_end, 0] == pytest.approx(100, abs=1.5)


def test_directions_in_place_of_heights_are_a_flat_road(read):
    scene = read(by_hand.nuscenes())
    assert not any(lane.z_m.any() for lane in scene.road.lanes.values())
    assert said(scene, "The third coordinate of the 5 lanes is their direction, not their height")


def test_directions_may_be_whole_turns_off(read):
    described = by_hand.nuscenes()
    described["metadata"]["dataset"] = "mine"
    for turns, name in enumerate(by_hand.LANES):
        described["map_features"][name]["polyline"][:, 2] += 2 * np.pi * (turns - 2)
    assert not read(described).road.lanes["west"].z_m.any()


@pytest.mark.parametrize("slope", [0.0, 0.02])
def test_heights_stay_heights(read, slope):
    described = by_hand.nuscenes()
    for name, points in by_hand.LANES.items():
        height = 0.05 + slope * points[:, 0]
        described["map_features"][name]["polyline"] = np.column_stack([points, height])
    lane = read(described).road.lanes["west"]
    assert lane.z_m == pytest.approx(0.05 + slope * by_hand.LANES["west"][:, 0])


def test_a_nearly_flat_road_that_leads_one_way_east_keeps_its_heights(read):
    described = by_hand.nuscenes()
    described["metadata"]["dataset"] = "mine"
    described["map_features"] = {
        name: by_hand.lane(
            name,
            exit_lanes=[],
            polyline=np.column_stack([by_hand.LANES[name], np.linspace(0, 0.05, 101)]),
        )
        for name in ("right", "left")
    }
    assert read(described).road.lanes["left"].z_m[-1] == pytest.approx(0.05)


def test_sidewalks_are_left_out_and_counted(read):
    scene = read(by_hand.nuscenes())
    assert [one.kind for one in scene.road.polygons] == ["crosswalk"]
    assert said(scene, "Left out: 2 sidewalks; a scene contains the road alone.")


def test_outlines_of_the_drivable_area_are_road_edges(read):
    road = read(by_hand.nuplan()).road
    assert [(one.id, one.kind) for one in road.edges] == [("boundary_0", 1)]
    assert [(one.id, one.kind) for one in road.lines] == [("divider", 1)]


@pytest.mark.parametrize(
    ("converted", "limit"),
    [
        (by_hand.nuscenes, None),
        (by_hand.nuplan, 11.0),
        (by_hand.argoverse, None),
        (by_hand.metadrive, None),
    ],
)
def test_limits_have_their_unit_and_made_up_ones_are_none(read, converted, limit):
    lanes = read(converted()).road.lanes
    assert lanes["turn"].speed_limit_mps == limit
    assert lanes["west"].speed_limit_mps is None


def test_limits_in_km_per_hour(read):
    described = by_hand.metadrive()
    described["map_features"]["right"]["speed_limit_kmh"] = 36
    assert read(described).road.lanes["right"].speed_limit_mps == pytest.approx(10.0)


def test_made_up_limits_are_reported(read):
    assert said(
        read(by_hand.argoverse()), "The limit of 5 lanes is unknown: the converter writes 85 mph"
    )
    assert said(
        read(by_hand.nuscenes()), "The limit of 1 lanes is unknown: the converter writes 100 kmh"
    )


@pytest.mark.parametrize(
    ("converted", "inside"),
    [
        (by_hand.nuscenes, {"turn"}),
        (by_hand.nuplan, {"turn"}),
        (by_hand.argoverse, set()),
        (by_hand.metadrive, {"turn"}),
    ],
)
def test_lanes_inside_junctions(read, converted, inside):
    scene = read(converted())
    assert {lane.id for lane in scene.road.lanes.values() if lane.interpolating} == inside
    assert said(scene, "All lanes are marked as 'interpolating'") == (not inside)


def test_lanes_after_a_split_or_before_a_merge_are_inside_where_all_are_marked(read):
    described = by_hand.argoverse()
    lanes = described["map_features"]
    lanes["left"]["exit_lanes"] = ["turn", "on"]
    lanes["on"] = by_hand.lane("left", interpolating=True, entry_lanes=["left"], exit_lanes=[])
    assert read(described).road.lanes["turn"].interpolating
    assert not read(described).road.lanes["on"].interpolating  # it leads nowhere
    lanes["left"]["exit_lanes"] = ["turn"]
    assert not read(described).road.lanes["turn"].interpolating
    lanes["north"]["entry_lanes"] = ["turn", "on"]
    assert read(described).road.lanes["turn"].interpolating


def test_lights_of_nuplan(read):
    scene = read(by_hand.nuplan())
    signals = scene.signals
    assert signals.lane_ids == ("turn",)
    assert not signals.seen[0, :10].any()
    assert signals.seen[0, 10:].all()
    states = [signals.state[0, step] for step in (10, 49, 50, 79, 80, 90)]
    assert states == [
        *(SignalState.STOP, SignalState.STOP),
        *(SignalState.GO, SignalState.GO),
        *(SignalState.CAUTION, SignalState.CAUTION),
    ]
    assert signals.stop_m.tolist() == [[100.0, 3.5]]
    assert said(scene, "1 signals have no stop point; the start of their lane was used: turn.")


@pytest.mark.parametrize("stop", [None, np.zeros(3), [np.nan, np.nan]])
def test_lights_of_metadrive_name_their_lane_and_may_lack_the_stop_point(read, stop):
    described = by_hand.metadrive()
    light = by_hand.nuplan()["dynamic_map_states"]["turn"] | {"stop_point": stop}
    described["dynamic_map_states"] = {"light 7": light, "light 8": light}
    scene = read(described)
    assert scene.signals.lane_ids == ("turn",)
    assert scene.signals.stop_m.tolist() == [[100.0, 3.5]]
    assert said(scene, "Second signals of a lane were dropped: turn.")


def test_scenes_of_metadrive_itself_are_read(read):
    scene = read(by_hand.metadrive())
    assert (scene.name, scene.now, scene.source.dataset) == ("3", 10, "scenarionet")
    assert scene.tracks.size_m[scene.tracks.row("cone"), :2].tolist() == [1.0, 1.0]
    assert said(scene, "2 links to lanes that start beside a lane's end were dropped")
    assert not said(scene, "mirrored")


@pytest.mark.parametrize("has_neighbours", [True, False])
def test_early_scenes_of_metadrive_are_mirrored(read, has_neighbours):
    described = by_hand.metadrive()
    if not has_neighbours:
        described["version"] = "MetaDrive v0.3.0.1"
        for one in described["map_features"].values():
            one.pop("left_neighbor", None), one.pop("right_neighbor", None)
    described["tracks"]["car"]["state"]["heading"][:] = 0.05
    described["tracks"]["car"]["state"]["velocity"][:, 1] = 0.4
    if has_neighbours:
        expected = read(described)
        scene = read(by_hand.mirrored(described))
        for name in ("position_m", "heading_rad", "velocity_mps"):
            assert getattr(scene.tracks, name) == pytest.approx(getattr(expected.tracks, name))
    else:
        scene = read(by_hand.mirrored(described))
    assert scene.road.lanes["left"].centre_m == pytest.approx(by_hand.LANES["left"])
    assert [one.lane_id for one in scene.road.lanes["right"].left] == ["left"]
    assert scene.tracks.heading_rad[scene.tracks.row("car"), 20] == pytest.approx(0.05)
    assert said(scene, "the scene was mirrored")


def test_the_current_step_of_argoverse_is_recorded(read):
    assert read(by_hand.argoverse()).now == 49


@pytest.mark.parametrize("missing", [0.0, np.nan])
def test_headings_that_are_missing_throughout_are_those_of_the_motion(read, missing):
    described = by_hand.nuplan()
    state = described["tracks"]["car"]["state"]
    state["position"][:, :2] = np.column_stack([np.full(91, 110.0), 14 + 0.5 * np.arange(91)])
    state["velocity"] = np.tile([0.0, 5.0], (91, 1))
    state["heading"] = np.full(91, missing)
    scene = read(described)
    assert scene.tracks.heading_rad[scene.tracks.row("car")] == pytest.approx(np.pi / 2)
    assert said(
        scene, "91 headings are missing; the direction of motion was used for 1 agents: car."
    )


def test_speeds_that_are_missing_are_those_of_the_motion_and_counted(read):
    assert said(
        read(by_hand.nuscenes()),
        "3 speeds are missing; the motion between steps was used for 2 agents: ego, car.",
    )
    described = by_hand.nuplan()
    del described["tracks"]["car"]["state"]["velocity"]
    scene = read(described)
    assert scene.tracks.velocity_mps[scene.tracks.row("car"), 40] == pytest.approx([8.0, 0.0])


def test_features_without_points_are_left_out_and_counted(read):
    described = by_hand.nuplan()
    del described["map_features"]["zebra"]["polygon"], described["map_features"]["west"]["polyline"]
    scene = read(described)
    assert "west" not in scene.road.lanes
    assert said(scene, "2 map features without points were dropped: west, zebra.")


def test_lists_that_are_none_are_empty(read):
    described = by_hand.metadrive()
    links = ("entry_lanes", "exit_lanes", "left_neighbor", "right_neighbor")
    for one in described["map_features"].values():
        if one["type"].startswith("LANE_"):
            one.update(dict.fromkeys(links))
    assert read(described).road.lanes["right"].next == ()
