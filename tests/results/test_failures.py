"""Failures: the words for a hit, errors of planners, and groups with the worst first."""

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepmf_sumo import files
from deepmf_sumo.cli import main
from deepmf_sumo.datatypes import Lane, RoadMap, SignalState
from deepmf_sumo.errors import PlannerError
from deepmf_sumo.judge import conflict_types
from deepmf_sumo.judge.conflict_types import Meeting
from deepmf_sumo.report import failures as words
from deepmf_sumo.results import failures as module
from deepmf_sumo.results.failures import Failure, failure_of
from deepmf_sumo.results.groups import grouped
from deepmf_sumo.results.reader import Results, Run

from tests.support import gate_doubles
from tests.support.result_folders import Folder
from tests.support.rollout_doubles import contact_of, rollout_of, straight

STEP = 50


def turning(x, y, speed, heading, turn, steps=STEP + 1, begin=20):
    """(T, 3) poses of a vehicle that begins to turn at a step, all of it within 2 s."""
    angle = heading + turn * np.clip((np.arange(steps) - begin) / 20, 0, 1)
    way = np.cumsum(0.1 * speed * np.column_stack([np.cos(angle), np.sin(angle)]), axis=0)
    return np.column_stack([way - way[0] + [x, y], angle])


def ending(path, x, y):
    """The path moved so that it ends at a place."""
    return path - [path[-1, 0] - x, path[-1, 1] - y, 0.0]


def shifting(x, y, speed, aside, steps=STEP + 1):
    """A vehicle to the east that changes its lane in the last 2 s."""
    path = straight(x, y, speed, steps=steps, now=steps - 1)
    share = np.clip((np.arange(steps) - (steps - 21)) / 20, 0, 1)
    path[:, 1] += aside * (share - 1)
    return path


EAST = straight(0, 0, 10, steps=STEP + 1, now=STEP)
MET = {
    "rear-end": (straight(4.7, 0, 5, steps=STEP + 1, now=STEP), "ahead"),
    "rear-end behind": (straight(-4.7, 0, 14, steps=STEP + 1, now=STEP), "behind"),
    "crossing": (straight(2, 2, 8, steps=STEP + 1, heading=-np.pi / 2, now=STEP), "left"),
    "crossing right": (straight(2, -2, 8, steps=STEP + 1, heading=np.pi / 2, now=STEP), "right"),
    "left turn across path": (
        ending(turning(0, 0, 8, np.pi, np.pi / 2, begin=30), 3.0, 1.5),
        "ahead",
    ),
    "right turn across path": (
        ending(turning(0, 0, 8, np.pi, -np.pi / 2, begin=30), 3.0, -1.5),
        "ahead",
    ),
    "merging": (ending(turning(0, 0, 8, np.pi / 2, -np.pi / 2, begin=29), 4.0, -1.0), "right"),
    "lane change": (shifting(4.5, 1.0, 8, -3.5), "left"),
    "head-on": (straight(4.7, 0.3, 9, steps=STEP + 1, heading=np.pi, now=STEP), "ahead"),
}


def pair_of(other, av=EAST, road=None):
    rollout = rollout_of({"av": av, "b": other})
    poses = {"pose_first": av[-1], "pose_second": other[-1]}
    rollout = replace(rollout, contacts=(replace(contact_of(step=STEP), **poses),))
    return rollout, Meeting.of(rollout.tracks, ("av", "b"), STEP, road)


@pytest.mark.parametrize("name", MET)
def test_the_conflict_and_where_the_opponent_came_from(name):
    other, side = MET[name]
    if name == "lane change":
        other = shifting(4.5, 1.0, 8, -2.5)
    _, pair = pair_of(other)
    assert pair.type == name.removesuffix(" behind").removesuffix(" right")
    assert pair.side(pair.first) == side


def test_a_turn_that_was_over_before_is_not_one_across_the_path():
    av = ending(turning(0, 0, 8, np.pi / 2, -np.pi / 2, begin=-5), 0.0, 0.0)
    _, pair = pair_of(MET["head-on"][0], av)
    assert pair.first == 0  # 4 s before the contact the AV was turning
    assert pair.type == "head-on"


def test_directions_are_those_of_4_s_but_the_onset_may_be_earlier():
    paths = [straight(x, 0, v, steps=81, now=80) for x, v in ((0, 10), (4.7, 5))]
    rollout = rollout_of(dict(zip(("av", "b"), paths, strict=True)))
    pair = Meeting.of(rollout.tracks, ("av", "b"), 80, None)
    assert (pair.since, pair.first) == (0, 40)


def lanes_of(**lines):
    """A map of lanes by name: points, and which lanes follow."""
    return RoadMap(
        lanes={
            name: Lane(
                id=name, kind="street", centre_m=np.array(points, float),
                z_m=np.zeros(len(points)), **more,
            )
            for name, (points, more) in lines.items()
        }
    )  # fmt: skip


def test_vehicles_of_roads_that_join_merge():
    on = ([(-10, 0), (200, 0)], {})
    ramp, onward = [(-200, 3.0), (-10, 3.0)], {"next": ("on",)}
    road = lanes_of(main=([(-200, 0), (-10, 0)], onward), ramp=(ramp, onward), on=on)
    assert conflict_types._ahead(road, "main") == {"main", "on"}
    other = shifting(4.5, 1.0, 8, -2.5)
    assert pair_of(other)[1].type == "lane change"
    _, pair = pair_of(other, road=road)
    assert (pair.type, pair.turned()) == ("merging", "opponent")


def test_a_road_that_bends_is_not_a_turn():
    """Both keep to the lanes of a road that bends by 40 degrees, until they meet head-on."""
    bend = np.radians(40)
    east = ending(turning(0, 0, 10, 0, bend), 0.0, 0.0)
    line = np.concatenate([east[:, :2], 30 * np.array([[np.cos(bend), np.sin(bend)]])])
    x, y = 4.6 * np.cos(bend), 4.6 * np.sin(bend)
    back = straight(x, y, 9, steps=STEP + 1, heading=bend - np.pi, now=STEP)
    assert pair_of(back, east)[1].type == "left turn across path"  # by directions alone
    _, pair = pair_of(back, east, lanes_of(mine=(line, {}), theirs=(line[::-1], {})))
    assert (pair.type, pair.side(pair.first)) == ("head-on", "ahead")


def test_a_begun_turn_counts_on_a_lane_that_turns():
    """The oncoming vehicle has turned by 17 degrees only, on a lane that bends by 90."""
    other = ending(turning(0, 0, 8, np.pi, np.radians(17), begin=30), 4.6, 0.6)
    turn = [(12, 1.5), (4, 1.2), (0, -3), (0, -30)]
    assert pair_of(other)[1].type == "head-on"
    inside = {"interpolating": True, "previous": ("west",)}
    road = lanes_of(west=([(90, 1.5), (12, 1.5)], {"next": ("left",)}), left=(turn, inside))
    _, pair = pair_of(other, road=road)
    assert (pair.type, pair.turned()) == ("left turn across path", "opponent")


def test_an_opponent_beside_its_lane_has_left_it():
    """It drives 1 m left of its lane, into the AV, which keeps to its own."""
    mine, theirs = [(-100, 0), (60, 0)], [(60, 2.4), (-60, 2.4)]
    road = lanes_of(mine=(mine, {}), theirs=(theirs, {}))
    assert pair_of(straight(4.7, 0.7, 9, steps=51, heading=np.pi, now=STEP), road=road)[1].strayed()
    beside = straight(4.7, 2.2, 9, steps=51, heading=np.pi, now=STEP)
    assert not pair_of(beside, road=road)[1].strayed()


def test_that_which_stands_has_not_changed_lanes():
    """The other drives past obliquely and touches the side of the standing AV."""
    av = straight(0, 0, 0, steps=STEP + 1, now=STEP)
    _, pair = pair_of(shifting(1.0, 1.7, 8, -2.0), av)
    assert (pair.type, pair.turned()) == ("lane change", "opponent")
    _, pair = pair_of(av, shifting(-1.0, 1.7, 8, -2.0))
    assert (pair.type, pair.turned()) == ("lane change", "AV")


def test_a_vehicle_that_evades_has_not_moved_over():
    """Both move to the right; the one that moves toward the other is named."""
    _, pair = pair_of(shifting(1.0, 1.7, 10, -3.0), shifting(0, 0, 10, -1.0))
    assert (pair.type, pair.turned()) == ("lane change", "opponent")


def braking():
    return straight(0, 0, 10, steps=51, accel=-4.0)


@pytest.mark.parametrize(
    ("path", "action"),
    [
        (straight(0, 0, 10, steps=51), "held speed"),
        (straight(0, 0, 10, steps=51, accel=-2.0), "braked"),
        (straight(0, 0, 10, steps=51, accel=2.0), "accelerated"),
        (straight(0, 0, 0, steps=51), "stood"),
        (braking()[np.minimum(np.arange(51), 33)], "stopped"),
        (np.where(np.arange(51)[:, None] < 45, 0, straight(0, 0, 1, steps=51, now=44)), "set off"),
        (shifting(40, 0, 10, -2.0), "steered"),
    ],
)
def test_what_the_av_did(path, action):
    line = np.array([[-50.0, 0.0], [200.0, 0.0]])
    lane = Lane(id="a", kind="street", centre_m=line, z_m=np.zeros(2))
    tracks = rollout_of({"av": path, "b": straight(20, 0, 5, steps=51)}).tracks
    assert module._action(tracks, 0, 20, STEP, RoadMap(lanes={"a": lane})) == action


@pytest.mark.parametrize(
    ("mine", "theirs", "priority"),
    [
        (SignalState.STOP, SignalState.GO, "opponent"),
        (SignalState.GO, SignalState.STOP, "AV"),
        (SignalState.GO, SignalState.CAUTION, ""),
        (SignalState.GO, SignalState.GO, ""),
        (SignalState.STOP, None, ""),
    ],
)
def test_that_whose_light_let_it_go_has_priority(mine, theirs, priority):
    """Both pass their stop lines 10 m before they meet."""
    rollout, pair = pair_of(MET["crossing"][0])
    lanes = {
        "av": np.array([[-10.0, 0.0], [20.0, 0.0]]),
        "b": np.array([[2.0, 12.0], [2.0, -20.0]]),
    }
    road = RoadMap(
        lanes={
            name: Lane(id=name, kind="street", centre_m=line, z_m=np.zeros(2))
            for name, line in lanes.items()
        }
    )
    lights = {name: state for name, state in (("av", mine), ("b", theirs)) if state is not None}
    rollout = replace(rollout, signals=(lights,) * (STEP - rollout.now))
    assert module._by_lights(rollout, pair, road) == priority


def test_who_yields_by_the_map_has_no_priority():
    other, _ = MET["crossing right"]
    east = Lane(id="east", kind="street", centre_m=np.array([[-60.0, 0], [60, 0]]), z_m=np.zeros(2))
    north = Lane(
        id="north",
        kind="street",
        centre_m=np.array([[2.0, -60], [2, 60]]),
        z_m=np.zeros(2),
        gives_way_to=("east",),
    )
    swapped = replace(east, gives_way_to=("north",)), replace(north, gives_way_to=())
    neither = east, replace(north, gives_way_to=())
    for lanes, priority in (((east, north), "AV"), (swapped, "opponent"), (neither, "")):
        _, pair = pair_of(other, road=RoadMap(lanes={one.id: one for one in lanes}))
        assert module._by_map(pair) == priority


def run(run_id, status="ok", error="", folder=Path("nowhere")):
    names = ("run_id", "method", "planner", "scene", "adversary", "version", "outcome")
    values = dict.fromkeys(names, "") | {"run_id": run_id, "part": "main", "seed": 0}
    return Run(folder=folder, row={"error": error}, status=status, **values)


@pytest.mark.parametrize(
    ("status", "error", "kind"),
    [
        ("failed", "planner_error: ZeroDivisionError: a bug (see log.txt)", "planner crashed"),
        ("failed", "planner_error: the planner ended its process (SIGSEGV; see log.txt).",
         "planner crashed"),
        ("failed", "planner_error: p.py ended with exit code 3 before it answered step 12.",
         "planner crashed"),
        ("failed", "planner_error: p.py did not answer step 12 within 1 s.", "planner hung"),
        ("failed", "planner_error: RuntimeError: the lidar did not answer (see log.txt)",
         "planner crashed"),
        ("timeout", "longer than 600 s", "run timed out"),
        ("failed", "planner_error: speed_mps at step 12 is nan, not a finite number.",
         "planner answered nonsense"),
        ("failed", "SUMO refused something", None),
        ("skipped", "no such record", None),
    ],
)  # fmt: skip
def test_errors_of_a_planner_are_failures_of_their_own(status, error, kind):
    found = failure_of(run("a", status, error))
    assert (found and found.kind) == kind
    if found:
        assert words.sentence(grouped([found], 4)[0]).startswith(f"The {kind}: ")


@pytest.mark.parametrize(
    ("fault", "kind"),
    [
        ("crashed", "planner crashed"),
        ("hung", "planner hung"),
        ("nonsense", "planner answered nonsense"),
        ("", None),
    ],
)
def test_a_fault_is_what_was_raised_whatever_the_words(tmp_path, fault, kind):
    """Words of a planner or an adversary may be those of any of our messages."""
    words_of_all = "planner_error: the planner ended its process, did not answer step 1 within 1 s."
    values = gate_doubles.failed() | {"error": words_of_all, "planner_fault": fault}
    (tmp_path / "result.json").write_text(json.dumps(values))
    found = failure_of(run("a", "failed", words_of_all, tmp_path))
    assert (found and found.kind) == kind


def test_a_fault_survives_the_way_between_processes():
    error = pickle.loads(pickle.dumps(PlannerError("late", kind="hung")))
    assert (error.kind, str(error)) == ("hung", "planner_error: late")
    assert PlannerError("what").kind == "nonsense"


def hit(name, grade="C", delta_v=5.0, ordinary=1.0, **more):
    values = {
        "conflict": "crossing", "side": "left", "action": "held speed", "onset_s": 2.0,
        "grade": grade, "delta_v_mps": delta_v, "ordinary_mps2": ordinary,
    }  # fmt: skip
    return Failure(run=run(name), kind="hit", **values | more)


def test_groups_are_ranked_by_error_avoidability_severity_and_ordinary_motion():
    crash = Failure(run=run("crash"), kind="planner crashed", reason="a bug")
    found = [
        hit("fated", "A", 20.0),
        hit("wild", "C", 5.0, 4.0, side="right"),
        hit("calm", "C", 5.0, 0.5),
        hit("same", "C", 3.0),
        hit("fast", "C", 9.0, conflict="head-on"),
        hit("all", "D", 1.0, conflict="rear-end"),
        crash,
        Failure(run=run("slow"), kind="run timed out", reason="it took longer than 600 s"),
    ]
    groups = grouped(found, 40)
    names = [[one.run.run_id for one in group.failures] for group in groups]
    assert names == [["crash"], ["all"], ["fast"], ["calm", "same"], ["wild"], ["fated"], ["slow"]]
    values = groups[3].values()
    assert (values["runs"], values["of"], values["example"]) == (2, 40, "calm")
    assert values["avoided_by"] == "careful driver"
    assert words.row(groups[3])[0] == "2 of 40"


def test_an_error_at_another_step_is_the_same_and_another_error_is_not():
    found = [
        Failure(run=run(name), kind="planner crashed", reason=reason)
        for name, reason in (("a", "bug at step 12"), ("b", "bug at step 3"), ("c", "other bug"))
    ]
    names = [[one.run.run_id for one in group.failures] for group in grouped(found, 3)]
    assert names == [["a", "b"], ["c"]]


def sentence(**more):
    return words.sentence(grouped([hit("a", **more)], 1)[0])


def test_the_sentence_is_that_of_an_engineer():
    assert sentence(conflict="left turn across path", turned="AV", onset_s=2.1, side="ahead") == (
        "The AV turned left in front of an oncoming car. The danger showed 2.1 s before the hit; a"
        " careful driver would have waited."
    )
    assert sentence(priority="AV", grade="B") == (
        "A car from the left without priority crossed in front of the AV, and the AV held its"
        " speed. The danger showed 2.0 s before the hit; only braking or steering at once would"
        " have avoided it."
    )
    assert sentence(
        conflict="rear-end", turned="AV", side="behind", action="braked", braking_mps2=3.2,
        late=True, onset_s=None, grade="A",
    ) == (
        "A car behind ran into the AV, which braked late with up to 3 m/s2; no driver could have"
        " avoided it."
    )  # fmt: skip
    assert "braked with up to 1 m/s2" in sentence(action="braked", braking_mps2=0.4)
    turning = {"conflict": "left turn across path", "turned": "AV", "side": "ahead"}
    assert sentence(**turning, action="stood", grade="A") == (
        "The AV waited to turn left, and an oncoming car came into its way. The danger showed 2.0 s"
        " before the hit; no driver could have avoided it."
    )
    assert sentence(**turning, action="stopped").startswith(
        "The AV turned left in front of an oncoming car and stopped. The danger"
    )
    assert sentence(**turning, strayed=True).startswith(
        "The AV turned left, and an oncoming car left its lane and came into its way."
    )
    assert sentence(conflict="crossing", strayed=True).startswith(
        "A car from the left left its lane and came into the way of the AV, and the AV held"
    )
    assert sentence(grade="A", ran_red=True).endswith(" avoided it. The car ran a red light.")


@pytest.mark.parametrize("conflict", words._CAREFUL)
@pytest.mark.parametrize("turned", ["AV", "opponent", ""])
@pytest.mark.parametrize("grade", ["A", "B", "C", "D", None])
def test_each_failure_has_a_sentence(conflict, turned, grade):
    told = sentence(conflict=conflict, turned=turned, grade=grade)
    assert told.endswith(".")
    assert "None" not in told


@pytest.fixture
def folder(tmp_path, starts_sumo):  # recordings are read in a process of their own
    made = Folder(tmp_path)
    metrics = {"avoidance_grade": 2.0, "opponent_rms_acceleration": 0.8, "accident_type": 1.0}
    for scene in ("one", "two"):
        made.add(scene, metrics=metrics)
    made.add("miss", hit=False)
    made.fail("failed")
    return made.out


def test_failures_of_a_result_folder(folder):
    found = list(module.failures(Results.open(folder)))
    assert [one is not None for _, one, _ in found] == [True, True, False, False]
    failure = found[0][1]
    assert failure.grade == "C"
    assert 0 < failure.onset_s <= 3.0
    assert failure.conflict in words._CAREFUL


@pytest.mark.sumo
def test_the_onset_of_a_turn_is_not_before_it(tmp_path):
    """The opponent was elsewhere since 0.3 s; its turn began at 1.5 s."""
    made = Folder(tmp_path)
    made.add("one", speed=14.0)
    (run,) = Results.open(made.out).runs
    assert failure_of(run).onset_s == pytest.approx(3.0 - 0.3)
    turn = {"opponent": "b", "begin_s": 1.5, "end_s": 3.0, "ended": "contact",
            "outcome": "av_opponent", "hit_speed_mps": 1.0, "metrics": {}}  # fmt: skip
    file = run.folder / "result.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"turns": [turn]}))
    (run,) = Results.open(made.out).runs
    assert failure_of(run).onset_s == pytest.approx(1.5)


def test_a_run_that_cannot_be_read_is_named(folder, capsys):
    file = folder / "runs" / "00-one" / "tracks.csv.gz"
    files.write(file, file.read_bytes()[:40])
    assert main._run(["show", str(folder), "--failures"]) == 0
    said = capsys.readouterr()
    assert "00-one cannot be described" in said.err
    assert "1 of 4" in said.out


def test_the_groups_are_data(folder, capsys):
    assert main._run(["show", str(folder), "--failures", "--format", "json"]) == 0
    [group] = json.loads(capsys.readouterr().out)
    assert group["run_ids"] == ["00-one", "01-two"]
    assert (group["runs"], group["of"], group["kind"]) == (2, 4, "hit")
    assert group["sentence"].endswith("; a careful driver would have made room.")
    assert group["folder"] == str(folder / "runs" / "00-one")
    assert main._run(["show", str(folder), "--failures", "--format", "csv"]) == 0
    assert "00-one 01-two" in capsys.readouterr().out
    assert main._run(["show", str(folder), "--failures", "--all"]) == 2


def test_a_folder_without_failures_says_so(tmp_path, capsys):
    made = Folder(tmp_path)
    made.add("miss", hit=False)
    assert main._run(["show", str(made.out), "--failures"]) == 0
    assert capsys.readouterr().out.strip() == "no failures in 1 run"


def test_groups_of_several_folders_name_the_folder_of_their_example(folder, capsys):
    assert main._run(["show", str(folder), "--failures"]) == 0
    assert str(folder) not in capsys.readouterr().out
    assert main._run(["show", str(folder), str(folder), "--failures"]) == 0
    said = capsys.readouterr().out
    assert str(folder / "runs" / "00-one") in said.replace("\n", "")
    assert "4 of 8" in said
