"""What every format's reader must do with the same faults of a recording."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.scene.readers import Refusal, gpudrive, npz, read_by, scenarionet, womd

from tests.support import recordings_by_hand as by_hand


def in_womd(message, folder):
    return one_of(read_by(womd, by_hand.shard(folder / "one.tfrecord", message)))


def in_scenarionet(message, folder):
    file = folder / "one.pkl"
    file.write_bytes(pickle.dumps(by_hand.scenarionet(message)))
    return one_of(read_by(scenarionet, file))


def in_gpudrive(message, folder):
    file = folder / "one.json"
    file.write_text(json.dumps(by_hand.gpudrive(message)))
    return one_of(read_by(gpudrive, file))


def one_of(scenes):
    (found,) = scenes
    return found


FORMATS = [in_womd, in_scenarionet, in_gpudrive]
WITH_CLOCK = [in_womd, in_scenarionet]


def reason(found):
    assert isinstance(found, Refusal), found.repairs
    return found.reason


def valid(scene, agent):
    return scene.tracks.valid[scene.tracks.row(agent)]


def clock(message, times):
    message.timestamps_seconds[:] = [float(time) for time in times]
    return message


def moves(message, seconds):
    """All road users move as far in a step as they would in so many seconds."""
    for track in message.tracks:
        first = track.states[0]
        x, y = first.center_x, first.center_y
        for step, state in enumerate(track.states):
            if state.valid:
                state.center_x = x + state.velocity_x * seconds * step
                state.center_y = y + state.velocity_y * seconds * step
    return message


def unseen(message, start, stop, away):
    """The car is not seen for some steps, and ``away`` metres farther on after them."""
    for step, state in enumerate(message.tracks[0].states):
        if start <= step < stop:
            state.valid = False
        elif step >= stop:
            state.center_x += away
    return message


@pytest.mark.parametrize("read", FORMATS)
@pytest.mark.parametrize(("start", "stop"), [(40, 41), (40, 60)])
def test_an_identity_that_jumps_while_unseen_is_another_one(read, start, stop, tmp_path):
    scene = read(unseen(by_hand.scenario(), start, stop, 200.0), tmp_path)
    assert valid(scene, "7").sum() == start
    assert any(
        f"Agent 7 jumps by up to {200 + 1.2 * (stop - start + 1):.1f} m within a step or a gap, "
        f"first after step {start - 1}; {91 - stop} states" in one
        for one in scene.repairs
    )


@pytest.mark.parametrize("read", FORMATS)
@pytest.mark.parametrize(
    ("start", "stop", "away"), [(40, 41, 2.0), (20, 60, 10.0), (20, 60, -10.0)]
)
def test_a_road_user_may_be_unseen_for_a_while(read, start, stop, away, tmp_path):
    scene = read(unseen(by_hand.scenario(), start, stop, away), tmp_path)
    assert valid(scene, "7").sum() == 91 - (stop - start)
    assert scene.repairs == ()


@pytest.mark.parametrize("read", FORMATS)
def test_the_av_may_not_jump_while_unseen(read, tmp_path):
    message = by_hand.scenario()
    for step, state in enumerate(message.tracks[2].states):
        state.valid = not 40 <= step < 50
        state.center_x += 200.0 * (step >= 50)
    assert "the AV (12) jumps by up to 211.0 m" in reason(read(message, tmp_path))


@pytest.mark.parametrize("read", WITH_CLOCK)
@pytest.mark.parametrize(
    ("seconds", "said"),
    [
        (0.5, "every 0.5 s (2 Hz)"),
        (0.125, "every 0.125 s (8 Hz)"),
        (0.12, "every 0.12 s (8.33 Hz)"),
        (0.105, "every 0.105 s (9.52 Hz)"),
        (0.075, "every 0.075 s (13.3 Hz)"),
        (0.03, "every 0.03 s (33.3 Hz)"),
    ],
)
def test_other_rates_are_refused_with_the_real_one(read, seconds, said, tmp_path):
    message = moves(clock(by_hand.scenario(), np.arange(91) * seconds), seconds)
    assert f"was recorded {said}; only 0.1 s can be used" in reason(read(message, tmp_path))


@pytest.mark.parametrize("read", WITH_CLOCK)
@pytest.mark.parametrize(("every", "now"), [(2, 20), (2, 21), (3, 31), (2, 5)])
def test_a_multiple_of_10_hz_is_the_same_scene_at_10_hz(read, every, now, tmp_path):
    step = 0.1 / every
    fine = by_hand.scenario(steps=90 * every + max(now, 10) % every + 1, now=now)
    fine = moves(clock(fine, np.arange(len(fine.timestamps_seconds)) * step), step)
    scene = read(fine, tmp_path)
    assert scene.now == max(now // every, 10)
    assert f"It was recorded at {10 * every} Hz; one of {every} steps was used." in scene.repairs
    assert scene.tracks.steps == scene.signals.state.shape[1] == 91
    for row, speed in ((0, 12.0), (2, 10.0)):
        assert np.diff(scene.tracks.position_m[row, :, 0]) == pytest.approx(0.1 * speed, abs=1e-4)
    x = fine.tracks[2].states[now].center_x if now >= 10 * every else 10.0
    assert scene.tracks.position_m[2, scene.now, 0] == pytest.approx(x, abs=1e-4)
    assert np.diff(scene.timestamps_s) == pytest.approx(0.1, abs=1e-5)
    shown = [bool(one.lane_states) for one in fine.dynamic_map_states][
        max(now, 10) % every :: every
    ]
    assert scene.signals.seen[0].tolist() == shown


@pytest.mark.parametrize("read", WITH_CLOCK)
@pytest.mark.parametrize(
    ("spacing", "at", "took"),
    [
        ([0.1] * 46 + [0.12] * 44, 46, 0.12),
        ([0.12] * 44 + [0.1] * 46, 0, 0.12),
        ([0.1] * 40 + [0.08] * 20 + [0.1] * 30, 40, 0.08),
        ([0.1015] * 85 + [0.112] * 5, None, None),
    ],
)
def test_the_rate_holds_over_the_whole_recording(read, spacing, at, took, tmp_path):
    message = clock(by_hand.scenario(), np.cumsum([0.0, *spacing]))
    found = read(message, tmp_path)
    if at is None:
        assert not isinstance(found, Refusal)
        return
    assert (
        f"not recorded every 0.1 s throughout: from step {at} on a step takes {took} s"
        in reason(found)
    )


@pytest.mark.parametrize("read", WITH_CLOCK)
def test_a_clock_that_is_a_little_off_for_long_is_refused(read, tmp_path):
    message = clock(by_hand.scenario(), np.cumsum([0.0, *[0.1] * 46, *[0.1075] * 44]))
    assert "was not recorded every 0.1 s throughout" in reason(read(message, tmp_path))


@pytest.mark.parametrize("read", WITH_CLOCK)
def test_lost_frames_are_reported(read, tmp_path):
    times = np.arange(91) * 0.1
    times[31:] += 0.1
    times[61:] += 0.2
    scene = read(clock(by_hand.scenario(), times), tmp_path)
    assert scene.repairs[0].startswith("The recorder lost 3 frames, the first after step 30;")


@pytest.mark.parametrize("read", FORMATS)
@pytest.mark.parametrize(("seconds", "share"), [(0.12, "1.2"), (0.5, "5"), (0.05, "0.5")])
def test_motion_that_contradicts_the_speeds_is_refused(read, seconds, share, tmp_path):
    said = f"moves its road users {share} times as far in 0.1 s as their speeds say"
    assert said in reason(read(moves(by_hand.scenario(), seconds), tmp_path))


@pytest.mark.parametrize("read", FORMATS)
def test_two_tracks_or_lanes_of_one_id_are_refused(read, tmp_path):
    message = by_hand.scenario()
    by_hand.add_lane(message, 100, (500, 500), 30)
    if read is not in_scenarionet:  # whose lanes are by id
        assert "two lanes have the id 100" in reason(read(message, tmp_path))
    message = by_hand.scenario()
    message.tracks[0].id = 9
    if read is not in_scenarionet:
        assert "two tracks have the id 9" in reason(read(message, tmp_path))


def test_ids_of_scenarionet_that_are_one_as_text_are_refused(tmp_path):
    for part, said in (("map_features", "two lanes have the id 100"), ("tracks", "id 7")):
        described = by_hand.scenarionet(by_hand.scenario())
        name = "100" if part == "map_features" else "7"
        described[part][int(name)] = described[part][name]
        (tmp_path / "one.pkl").write_bytes(pickle.dumps(described))
        assert said in reason(one_of(read_by(scenarionet, tmp_path / "one.pkl")))


def test_two_states_of_a_signal_at_a_step_are_reported(tmp_path):
    message = by_hand.scenario()
    assert in_womd(message, tmp_path).repairs == in_gpudrive(message, tmp_path).repairs == ()
    for step, same in ((15, True), (16, False)):
        state = message.dynamic_map_states[step].lane_states
        state.append(state[0])
        state[1].state = state[0].state if same else 1
    scene = in_womd(message, tmp_path)
    assert scene.repairs == (
        "1 signal states of a lane that has another one at the same step were used.",
    )
    assert scene.signals.state[0, [15, 16]].tolist() == [4, 1]
    drive = by_hand.gpudrive(by_hand.scenario())
    light = drive["tl_states"]["102"]
    light["time_index"][5] = light["time_index"][50]
    (tmp_path / "two.json").write_text(json.dumps(drive))
    scene = one_of(read_by(gpudrive, tmp_path / "two.json"))
    assert "1 signal states of a lane that has another one" in scene.repairs[0]


@pytest.mark.parametrize("read", FORMATS)
@pytest.mark.parametrize("field", ["center_x", "heading", "velocity_y"])
def test_states_that_are_not_finite_are_dropped_and_counted(read, field, tmp_path):
    message = by_hand.scenario()
    for step in (3, 70):
        setattr(message.tracks[0].states[step], field, np.nan)
    scene = read(message, tmp_path)
    assert np.flatnonzero(~valid(scene, "7")).tolist() == [3, 70]
    assert "Agent 7: 2 states that are not finite numbers" in scene.repairs[0]


@pytest.mark.parametrize("read", FORMATS)
@pytest.mark.parametrize("metres", [0.0, -4.5, 1e-6, 1e6, float("nan"), float("inf")])
def test_what_is_no_size_of_a_road_user_is_not_used(read, metres, tmp_path):
    message = by_hand.scenario()
    for state in message.tracks[0].states:
        state.length = metres
    scene = read(message, tmp_path)
    assert tuple(scene.tracks.size_m[0, :2]) == (4.7, 2.0)
    assert any("typical of its kind (vehicle)" in repair for repair in scene.repairs)
    for state in message.tracks[2].states:
        state.width = metres
    assert "the AV (12) has no size" in reason(read(message, tmp_path))


@pytest.mark.parametrize("read", FORMATS)
@pytest.mark.parametrize("metres", [-1.5, 1e6])
def test_what_is_no_height_of_a_road_user_is_unknown(read, metres, tmp_path):
    """And does not lift or sink it: the other car stands where it stood, at its middle's height."""
    message = by_hand.scenario()
    for state in message.tracks[0].states:
        state.height = metres
    scene = read(message, tmp_path)
    assert scene.tracks.size_m[0, 2] == 0.0
    assert scene.tracks.z_m[0, 20] == 1.0
    assert f"Agent 7 has a height of {metres:g} m; it is unknown." in scene.repairs


@pytest.mark.parametrize("read", FORMATS)
def test_a_lane_without_points_is_dropped(read, tmp_path):
    message = by_hand.scenario()
    del message.map_features[1].lane.polyline[:]
    scene = read(message, tmp_path)
    assert set(scene.road.lanes) == {"100", "102"}
    assert "Lanes without points were dropped: 101." in scene.repairs


@pytest.mark.parametrize("read", FORMATS)
def test_a_scene_of_a_step_is_told_how_many_it_needs(read, tmp_path):
    message = by_hand.scenario(steps=1, now=0)
    assert "has 1 steps, and at least 12 are needed" in reason(read(message, tmp_path))


@pytest.mark.parametrize("read", FORMATS)
def test_heights_are_as_recorded(read, tmp_path):
    message = by_hand.scenario()
    for state in message.tracks[0].states:
        state.center_z = 8.0
    for point in message.map_features[1].lane.polyline:
        point.z = 7.5
    scene = read(message, tmp_path)
    row = scene.tracks.row("7")
    ground = 8.0 - scene.tracks.size_m[row, 2] / 2
    assert scene.tracks.z_m[row].tolist() == [ground] * 91, "the middle is half a height above"
    assert set(scene.road.lanes["101"].z_m) == {7.5}
    assert set(scene.road.lanes["100"].z_m) == {0.5}


@pytest.mark.parametrize("read", FORMATS)
def test_heights_that_are_missing_are_those_of_the_nearest_step(read, tmp_path):
    message = by_hand.scenario()
    for state in message.tracks[0].states[:20]:
        state.center_z = np.nan
    message.tracks[0].states[20].center_z = 2.0
    for point in message.map_features[1].lane.polyline:
        point.z = np.nan
    scene = read(message, tmp_path)
    assert valid(scene, "7").all()
    ground = 1.0 - scene.tracks.size_m[0, 2] / 2
    assert scene.tracks.z_m[0].tolist() == [ground + 1.0] * 21 + [ground] * 70
    assert set(scene.road.lanes["101"].z_m) == {0.5}, "of the lane beside it"
    assert set(scene.repairs) == {
        "20 states without a height have that of the nearest step, or 0 where the track has none.",
        "1 lanes without heights have those of the nearest lanes: 101.",
    }


def on_a_hill(height_m, climbs):
    """A scenario whose tracks are at 0; its lanes rise by ``climbs`` from a height on."""
    message = by_hand.scenario()
    for track in message.tracks:
        for state in track.states:
            state.center_z = 0.0
    for feature in message.map_features:
        for point in feature.lane.polyline:
            point.z = height_m + climbs * point.x
    return message


@pytest.mark.parametrize("read", FORMATS)
def test_a_lane_far_away_beside_one_without_heights_is_refused(read, tmp_path):
    """Heights are looked for before the map is checked, on points along all lanes."""
    message = by_hand.scenario()
    for point in message.map_features[1].lane.polyline:
        point.z = np.nan
    message.map_features[0].lane.polyline[-1].x = 1e13
    assert "too far away" in reason(read(message, tmp_path))


@pytest.mark.parametrize("read", FORMATS)
def test_tracks_without_heights_stand_on_a_road_that_climbs(read, tmp_path):
    scene = read(on_a_hill(20.0, 0.1), tmp_path)
    for row in range(len(scene.tracks.ids)):
        seen = scene.tracks.valid[row]
        x = scene.tracks.position_m[row, seen, 0]
        assert scene.tracks.z_m[row, seen] == pytest.approx(20 + 0.1 * x, abs=0.6)
    assert "The tracks have no heights; those of the lanes below were used." in scene.repairs


@pytest.mark.parametrize("read", FORMATS)
@pytest.mark.parametrize(("height_m", "climbs"), [(20.0, 0.0), (0.2, 0.001)])
def test_on_a_road_without_slopes_they_stay_at_0(read, tmp_path, height_m, climbs):
    scene = read(on_a_hill(height_m, climbs), tmp_path)
    assert not scene.tracks.z_m.any()
    assert not any("heights" in one for one in scene.repairs)


def test_the_native_format_has_the_same_clock_and_no_signal_twice(tmp_path):
    scene = in_womd(by_hand.scenario(), tmp_path)
    slow = replace(scene, timestamps_s=np.arange(91) * 0.12)
    light = scene.signals
    twice = replace(
        light,
        lane_ids=light.lane_ids * 2,
        **{
            name: np.concatenate([getattr(light, name)] * 2)
            for name in ("state", "seen", "stop_m", "stop_z_m")
        },
    )
    for bad, said in (
        (slow, "was recorded every 0.12 s (8.33 Hz)"),
        (replace(scene, signals=twice), "two signals are of lane 102"),
    ):
        npz.write(bad, tmp_path / "one.npz")
        assert said in reason(one_of(read_by(npz, tmp_path / "one.npz")))
