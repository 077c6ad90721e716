import gzip

import numpy as np
import pytest

from deepmf_sumo.scene import SignalState
from deepmf_sumo.scene.readers import Refusal, read_by, womd

from tests.support.recordings_by_hand import AV_SIZE, add_lane, scenario, shard


@pytest.fixture
def read(tmp_path):
    def one(message):
        (found,) = read_by(womd, shard(tmp_path / "one.tfrecord", message))
        return found

    return one


def test_every_field_arrives(read):
    scene = read(scenario())
    tracks, road = scene.tracks, scene.road
    assert (scene.name, scene.now, scene.av_id, scene.repairs) == ("abc123", 10, "12", ())
    assert (scene.interest, scene.to_predict, scene.partner_id) == (("12", "7"), ("7",), "7")
    assert scene.source.record == 0
    assert tracks.ids == ("7", "9", "12")
    assert tracks.kinds == ("vehicle", "pedestrian", "vehicle")
    assert tracks.size_m[2] == pytest.approx(AV_SIZE)
    assert tracks.position_m[0, 20] == pytest.approx([5 + 12 * 2.0, 3.5])
    assert tracks.z_m[0, 20] == 1.0 - tracks.size_m[0, 2] / 2  # recorded: of the middle
    assert tracks.heading_rad[1, 5] == pytest.approx(np.pi / 2)
    assert tracks.velocity_mps[1, 5] == pytest.approx([0, 1.2])
    assert tracks.valid.sum(axis=1).tolist() == [91, 30, 91]
    assert not tracks.position_m[1, 30:].any()
    assert scene.timestamps_s[-1] == pytest.approx(9.0)
    lane = road.lanes["100"]
    assert (lane.kind, lane.next, lane.previous) == ("street", ("102",), ())
    assert lane.speed_limit_mps == pytest.approx(13.4112)
    assert lane.centre_m.shape == (201, 2)
    assert lane.centre_m[3] == pytest.approx([1.5, 0])
    assert (lane.left[0].lane_id, lane.left[0].self_end, lane.left[0].other_end) == (
        "101",
        200,
        201,
    )
    assert (lane.left_boundaries[0].feature_id, lane.left_boundaries[0].kind) == ("200", 1)
    assert road.lanes["102"].interpolating
    assert road.lanes["102"].previous == ("100",)
    assert (road.lines[0].kind, road.edges[0].kind, road.polygons[0].kind) == (1, 2, "crosswalk")
    assert road.stop_signs[0].lane_ids == ("102",)
    assert road.stop_signs[0].z_m == 2.0


def test_signals_are_seen_only_where_they_are_written(read):
    signals = read(scenario()).signals
    assert signals.lane_ids == ("102",)
    assert not signals.seen[0, [0, 10, 20]].any()
    assert signals.at(10) == {"102": SignalState.STOP}
    assert signals.at(41) == {"102": SignalState.GO}
    assert signals.at(0) == {}
    assert signals.stop_m[0].tolist() == [100, 0]


def test_a_recording_of_20_s_keeps_its_steps_and_gets_a_history(read):
    scene = read(scenario(steps=198, now=0))
    assert (scene.tracks.steps, scene.now) == (198, 10)


def test_size_is_that_of_the_current_step_else_of_the_nearest(read):
    message = scenario()
    for step, state in enumerate(message.tracks[0].states):
        state.length = 4.0 + step / 100
        state.valid = step > 12
    assert read(message).tracks.size_m[0, 0] == pytest.approx(4.13)


def zero_size_now(message):
    message.tracks[0].states[10].length = 0


def zero_size_always(message):
    for state in message.tracks[0].states:
        state.length = 0


def not_a_number(message):
    message.tracks[0].states[50].center_x = float("nan")


def jump(message):
    for state in message.tracks[0].states[60:]:
        state.center_y += 40


def jump_before(message):
    for state in message.tracks[0].states[:4]:
        state.center_y += 40


def never_seen(message):
    for state in message.tracks[1].states:
        state.valid = False


def dangling(message):
    message.map_features[0].lane.exit_lanes.append(999)


def lane_without_points(message):
    add_lane(message, 300, (0, 0), 10)
    del message.map_features[-1].lane.polyline[:]


def line_not_finite(message):
    message.map_features[3].road_line.polyline[2].y = float("inf")


def unknown_interest(message):
    message.objects_of_interest.append(4242)


def clock_backwards(message):
    message.timestamps_seconds[40] = 0.0


@pytest.mark.parametrize(
    ("damage", "said", "left"),
    [
        (
            zero_size_now,
            "no size at step 10; that of step 9",
            lambda s: s.tracks.size_m[0, 0] == 4.5,
        ),
        (zero_size_always, "typical of its kind", lambda s: s.tracks.size_m[0, 0] == 4.7),
        (not_a_number, "Agent 7: 1 states", lambda s: s.tracks.valid[0].sum() == 90),
        (jump, "first after step 59; 31 states", lambda s: s.tracks.valid[0].sum() == 60),
        (jump_before, "first after step 3; 4 states", lambda s: s.tracks.valid[0].sum() == 87),
        (never_seen, "dropped: 9", lambda s: s.tracks.ids == ("7", "12")),
        (dangling, "100 to 999", lambda s: s.road.lanes["100"].next == ("102",)),
        (lane_without_points, "dropped: 300", lambda s: "300" not in s.road.lanes),
        (line_not_finite, "1 lines", lambda s: s.road.lines == ()),
        (unknown_interest, "4242", lambda s: s.interest == ("12", "7")),
        (clock_backwards, "backwards", lambda s: s.timestamps_s[40] == pytest.approx(4.0)),
    ],
)
def test_what_can_be_mended_is_mended_and_said(read, damage, said, left):
    message = scenario()
    damage(message)
    scene = read(message)
    assert len(scene.repairs) == 1
    assert said in scene.repairs[0]
    assert left(scene)
    assert np.isfinite(scene.tracks.position_m).all()


def no_lanes(message):
    del message.map_features[:3]


def lane_not_finite(message):
    message.map_features[0].lane.polyline[2].y = float("nan")


def av_not_there(message):
    message.tracks[2].states[10].valid = False


def av_not_finite(message):
    message.tracks[2].states[10].heading = float("nan")


def av_jumps(message):
    for state in message.tracks[2].states[60:]:
        state.center_y += 40


def av_flat(message):
    for state in message.tracks[2].states:
        state.width = 0


def av_unknown(message):
    message.sdc_track_index = 3


def ragged(message):
    del message.tracks[1].states[-1]


def no_tracks(message):
    del message.tracks[:]


def twice(message):
    message.tracks[0].id = 9


def no_future(message):
    del message.timestamps_seconds[11:]
    del message.dynamic_map_states[11:]
    for track in message.tracks:
        del track.states[11:]


def other_rate(message):
    message.timestamps_seconds[:] = [step * 0.5 for step in range(91)]


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (no_lanes, "no lanes"),
        (av_not_finite, "states that are not finite numbers"),
        (lane_not_finite, "lane 100 has points that are not finite"),
        (av_not_there, r"AV \(12\) has no valid state at the current step 10"),
        (av_not_finite, r"AV \(12\) has no valid state"),
        (av_jumps, r"AV \(12\) jumps by up to 40.0 m"),
        (av_flat, r"AV \(12\) has no size"),
        (av_unknown, "sdc_track_index is 3, but there are 3 tracks"),
        (ragged, "track 9 has 90 states, but there are 91 timestamps"),
        (no_tracks, "no tracks"),
        (twice, "two tracks have the id 9"),
        (no_future, "no future was recorded"),
        (other_rate, "every 0.5 s"),
    ],
)
def test_what_cannot_be_used_is_refused_with_the_reason(read, damage, said):
    message = scenario()
    damage(message)
    refusal = read(message)
    assert isinstance(refusal, Refusal)
    assert (refusal.name, refusal.record, refusal.dataset) == ("abc123", 0, "womd")
    with pytest.raises(AssertionError, match=said):
        raise AssertionError(refusal.reason)
    assert "one.tfrecord record 0" in refusal.reason


def test_a_damaged_record_does_not_cost_the_next(tmp_path):
    file = shard(tmp_path / "shard.tfrecord", scenario(name="a"), scenario(name="b"))
    content = bytearray(file.read_bytes())
    content[1000] ^= 1
    file.write_bytes(content)
    first, second = read_by(womd, file)
    assert isinstance(first, Refusal)
    assert "checksum of its content" in first.reason
    assert second.name == "b"
    assert [ref.name for ref in womd.recordings(file)] == ["", "b"]


def test_a_cut_gzip_shard_gives_what_is_whole(tmp_path):
    whole = shard(tmp_path / "whole", scenario(name="a"), scenario(name="b")).read_bytes()
    file = tmp_path / "cut.tfrecord.gz"
    file.write_bytes(gzip.compress(whole)[:-300])
    assert any(womd.recordings(file))
    first, second = read_by(womd, file)
    assert first.name == "a"
    assert isinstance(second, Refusal)


def test_records_of_another_kind_are_refused(tmp_path):
    file = tmp_path / "other.tfrecord"
    file.write_bytes(womd.framed(b"\x0a\x03abc") + womd.framed(b"\xff\xff"))
    example, noise = read_by(womd, file)
    assert "'tf_example'" in example.reason
    assert "not a Scenario message" in noise.reason
