import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from importlib import resources

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepmf_sumo.cli import main
from deepmf_sumo.errors import UsageError
from deepmf_sumo.report import page
from deepmf_sumo.report.page import columns, roads
from deepmf_sumo.report.page.replay import packed, replay, steady, stepwise
from deepmf_sumo.results.quantities import QUANTITIES
from deepmf_sumo.results.statistics import rate
from deepmf_sumo.scene import Lane, RoadMap

from tests.support import worth_doubles
from tests.support.result_folders import Folder
from tests.support.rollout_doubles import contact_of, rollout_of, straight

ASSETS = resources.files("deepmf_sumo.report.page") / "assets"
NODE = shutil.which("node")
BROWSER = shutil.which("chromium-headless-shell") or shutil.which("chromium")


class Parsed(HTMLParser):
    """Elements with their attributes, and the text of each script."""

    def __init__(self, file):
        super().__init__()
        self.elements, self.scripts, self.inside = [], {}, None
        self.feed(file.read_text("utf-8"))

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag == "script":
            self.inside = dict(attrs).get("id", "run")
            self.scripts[self.inside] = ""

    def handle_endtag(self, tag):
        if tag == "script":
            self.inside = None

    def handle_data(self, data):
        if self.inside:
            self.scripts[self.inside] += data

    @property
    def rows(self):
        names = [column["name"] for column in self.content["columns"]]
        return [dict(zip(names, row, strict=True)) for row in self.content["rows"]]

    @property
    def content(self):
        return json.loads(self.scripts["content"])

    def details(self, number):
        return unpacked(self.scripts[f"run-{number}"])


def unpacked(text):
    import base64
    import zlib

    return json.loads(zlib.decompress(base64.b64decode(text)))


def restored(differences, unit):
    return np.cumsum(np.cumsum(differences)) * unit


def javascript(names, expression):
    """Value of an expression over some of the page's scripts."""
    if NODE is None:
        pytest.skip("no node to run JavaScript with")
    code = "\n".join((ASSETS / f"{name}.js").read_text("utf-8") for name in names)
    code += f"\n;(async () => console.log(JSON.stringify({expression})))();"
    done = subprocess.run([NODE, "-e", code], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


@pytest.fixture
def folder(tmp_path):
    return Folder(tmp_path)


@pytest.mark.sumo
def test_one_page_with_every_run_and_without_a_network(folder):
    folder.add("s1", scores={"b": 0.9, "c": 0.2}, metrics={"accident_type": 2.0, "ttc_min": 0.25})
    folder.add("s2", hit=False)
    folder.fail("s3")
    parsed = Parsed(page.write(folder.out))
    first, second, third = parsed.rows
    assert (first["outcome"], first["sector"]) == ("AV hit by opponent", "front")
    assert (first["accident"], first["speed"]) == ("T-bone", "2 to 5 m/s")
    assert (first["collision_time_s"], first["ttc_min_s"]) == (3.0, 0.25)
    assert (second["outcome"], second["sector"]) == ("no contact", None)
    assert (third["status"], third["note"]) == ("failed", "no reason; result.json is missing")
    used = [
        value
        for _, attrs in parsed.elements
        for key, value in attrs.items()
        if key in {"src", "href"}
    ]
    assert all(value.startswith("#") for value in used)
    policy = next(a["content"] for t, a in parsed.elements if a.get("http-equiv"))
    assert policy.startswith("default-src 'none'")
    assert "http" not in parsed.scripts["run"].replace("http://www.w3.org/2000/svg", "")


@pytest.mark.sumo
def test_ids_are_unique_and_controls_have_names(folder):
    folder.add("s1")
    parsed = Parsed(page.write(folder.out))
    ids = [attrs["id"] for _, attrs in parsed.elements if "id" in attrs]
    assert len(ids) == len(set(ids))
    named = {attrs["aria-labelledby"] for _, attrs in parsed.elements if "aria-labelledby" in attrs}
    assert named <= set(ids)


@pytest.mark.sumo
def test_poses_are_those_of_the_tracks(folder):
    rollout = folder.add("s1", turn=0.0)
    replay = Parsed(page.write(folder.out)).details(0)["replay"]
    tracks = rollout.tracks
    assert {agent["id"] for agent in replay["agents"]} == set(tracks.ids)
    for agent in replay["agents"]:
        [[first, x, y, heading]] = agent["parts"]
        steps = first + agent["every"] * np.arange(len(x))
        assert steps[-1] == tracks.steps - 1
        row = tracks.row(agent["id"])
        found = np.stack([restored(x, agent["unit"]), restored(y, agent["unit"])], axis=-1)
        apart = np.abs(found + replay["origin"] - tracks.position_m[row, steps])
        assert apart.max() <= agent["unit"] / 2 + 1e-9
        turned = restored(heading, 2 * np.pi / replay["turn"]) - tracks.heading_rad[row, steps]
        assert np.abs(turned).max() < 0.01


@pytest.mark.sumo
def test_who_drives_is_said_at_each_change(folder):
    folder.add("s1")
    agents = Parsed(page.write(folder.out)).details(0)["replay"]["agents"]
    drivers = {agent["id"]: agent.get("drivers") for agent in agents}
    assert drivers["av"] == [[0, "log"], [11, "planner"]]
    assert drivers["b"] == [[0, "log"], [11, "policy"]]
    assert drivers["c"] is None
    found = javascript(["scene"], f"driverAt({json.dumps({'drivers': drivers['av']})}, 10.6)")
    assert found == "planner"


@pytest.mark.sumo
def test_agents_far_away_are_left_out_and_counted(folder, monkeypatch):
    monkeypatch.setattr("deepmf_sumo.report.page.replay.REACH_M", 10.0)
    folder.add("s1", speed=10.0, hit=False)
    replay = Parsed(page.write(folder.out)).details(0)["replay"]
    assert replay["hidden"] == 3
    assert {agent["id"] for agent in replay["agents"]} == {"av", "b", "c"}


@pytest.mark.sumo
def test_the_same_runs_give_the_same_page(folder):
    folder.add("s1", scores={"b": 0.9})
    first = page.write(folder.out).read_bytes()
    assert page.write(folder.out).read_bytes() == first


@pytest.mark.sumo
def test_one_road_for_all_runs_of_a_scene(folder):
    folder.add("s1")
    folder.add("s1", method="S2")
    folder.add("s2")
    parsed = Parsed(page.write(folder.out))
    assert [parsed.details(number)["road"] for number in range(3)] == [0, 0, 1]
    assert unpacked(parsed.scripts["road-1"])["shapes"]
    assert "road-2" not in parsed.scripts


def test_a_damaged_run_is_shown_with_its_reason(folder):
    folder.add("s1")
    folder.add("s2")
    folder.add("s3")
    runs = sorted((folder.out / "runs").iterdir())
    (runs[0] / "tracks.csv.gz").unlink()
    (runs[1] / "result.json").write_text("{")
    (runs[2] / "plans.npz").write_bytes(b"no archive")
    parsed = Parsed(page.write(folder.out))
    notes = [row["note"] for row in parsed.rows]
    assert "tracks.csv.gz" in notes[0]
    assert notes[1].startswith("cannot be shown: result.json is damaged")
    assert notes[2].startswith("cannot be replayed")
    assert parsed.content["missing"] == 3
    assert "replay" not in parsed.details(0)


@pytest.mark.parametrize("name", ["tracks.csv.gz", "plans.npz", "result.json"])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.95])
def test_files_that_were_cut_off(folder, name, share):
    folder.add("s1")
    file = folder.out / "runs" / "00-s1" / name
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    parsed = Parsed(page.write(folder.out))
    assert parsed.content["missing"] == 1
    assert "cannot be" in parsed.rows[0]["note"]


def test_a_lost_recording_is_said_and_the_rest_is_shown(folder):
    folder.add("s1")
    (folder.root / "s1.npz").unlink()
    details = Parsed(page.write(folder.out)).details(0)
    assert details["road"] is None
    assert details["road_note"].startswith("no road: ")
    assert details["replay"]["agents"]


@pytest.mark.sumo
def test_places_of_chosen_moments_come_from_their_table(folder):
    folder.add("s1")
    folder.add("s2")
    (folder.out / "moments.csv").write_text("run_id,edge,turn\n01-s2,north,left\n")
    found = Parsed(page.write(folder.out)).rows
    assert [(row["edge"], row["turn"]) for row in found] == [(None, None), ("north", "left")]
    (folder.out / "moments.csv").write_text("run_id,edge,street\n01-s2,north,Mill Lane\n")
    found = Parsed(page.write(folder.out)).rows
    assert [row["edge"] for row in found] == [None, "Mill Lane (north)"]


def test_texts_cannot_become_elements(folder):
    folder.fail("s1")
    folder.rows[0]["error"] = "</script><script>alert(1)</script>"
    folder.write()
    parsed = Parsed(page.write(folder.out))
    assert parsed.rows[0]["note"].startswith("</script>")
    running = [attrs for tag, attrs in parsed.elements if tag == "script" and "type" not in attrs]
    assert len(running) == 1


@pytest.mark.sumo
def test_candidates_that_are_kept_hold_the_chosen_one(folder, monkeypatch):
    monkeypatch.setattr("deepmf_sumo.report.page.replay.MOST_A_PLAN", 1)
    monkeypatch.setattr("deepmf_sumo.report.page.replay.FEWEST_A_PLAN", 1)
    folder.add("s1", scores={"b": 0.9, "c": 0.25})
    [plan] = Parsed(page.write(folder.out)).details(0)["reasons"]
    assert (plan["of"], plan["chosen"], len(plan["candidates"])) == (2, 0, 1)
    assert plan["scores"] == {"b": 0.9, "c": 0.25}


@pytest.mark.parametrize(
    ("files", "message"),
    [((), "give the --out of an earlier command"), (("manifest.json",), "finish it with --resume")],
)
def test_no_result_folder(tmp_path, files, message):
    for name in files:
        (tmp_path / name).write_text("{}")
    with pytest.raises(UsageError, match=message):
        page.write(tmp_path)


@pytest.mark.sumo
def test_the_command_writes_the_page(folder, capsys):
    folder.add("s1")
    assert main.run(["report", str(folder.out)]) == 0
    assert "report.html" in capsys.readouterr().out
    assert (folder.out / "report.html").is_file()
    assert main.run(["report", str(folder.out / "nowhere")]) == 2


@pytest.mark.parametrize(
    ("speed", "kind"),
    [
        (None, None),
        (0.0, "0 to 2 m/s"),
        (2.0, "2 to 5 m/s"),
        (9.99, "5 to 10 m/s"),
        (10.0, "10 m/s and more"),
    ],
)
def test_kinds_of_speed(speed, kind):
    assert columns.speed_class(speed) == kind


@given(st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=50))
def test_numbers_come_back_within_half_a_unit(values):
    assert np.abs(restored(steady(values, 0.05), 0.05) - values).max() <= 0.0251
    assert np.abs(np.cumsum(stepwise(values, 0.1)) * 0.1 - values).max() <= 0.0501


def lane(name, points, **kwargs):
    points = np.array(points, float)
    return Lane(
        id=name,
        kind="street",
        centre_m=points,
        z_m=np.full(len(points), kwargs.pop("z", 0.0)),
        **kwargs,
    )


@pytest.mark.parametrize(
    ("place", "heading", "element"),
    [
        ((5, 0.5), 0.0, "road with one lane"),
        ((100, 1), 0.0, "junction"),
        ((80, 0), 0.0, "junction approach"),
        ((5, 9), 0.0, "off the lanes"),
        ((190, 0), 0.0, "merge or split"),
        ((100, 30), np.pi / 2, "road with one lane"),
    ],
)
def test_elements_of_the_road(place, heading, element):
    road = RoadMap(
        lanes={
            "a": lane("a", [(0, 0), (200, 0)], next=("c",)),
            "b": lane("b", [(100, -50), (100, 50)]),
            "c": lane("c", [(200, 0), (250, 0)], previous=("a", "d")),
            "above": lane("above", [(50, -50), (50, 50)], z=8.0),
        }
    )
    assert roads.element(road, np.array(place, float), 0.0, heading) == element


def test_the_element_is_of_the_level_of_the_vehicle():
    """A bridge climbs over a road: beside its foot they meet, above they do not."""
    under = lane("under", [(0, 0), (400, 0)], left="beside")
    climbs = Lane(
        id="climbs",
        kind="street",
        centre_m=np.array([(20, 0), (200, 0), (300, 1)], float),
        z_m=np.array([0.0, 9.0, 9.0]),
    )
    across = lane("across", [(250, -50), (250, 50)])
    road = RoadMap(lanes={one.id: one for one in (under, climbs, across)})

    def at(x, z_m):
        return roads.element(road, np.array([x, 0.2]), z_m, 0.0)

    assert at(150, 0.0) == "road with several lanes"
    assert at(150, 6.5) == "road with one lane"
    assert (at(250, 0.0), at(250, 9.0)) == ("junction", "road with one lane")


def test_lanes_made_up_to_join_others_are_junctions():
    joins = lane("j", [(0, 0), (10, 0)], interpolating=True)
    before = lane("b", [(-30, 0), (0, 0)], next=("j",))
    road = RoadMap(lanes={"j": joins, "b": before})
    assert roads.element(road, np.array([5.0, 0.0]), 0.0, 0.0) == "junction"
    assert roads.element(road, np.array([-10.0, 0.0]), 0.0, 0.0) == "junction approach"
    assert roads.element(road, np.array([-25.0, 0.0]), 0.0, 0.0) == "road with one lane"


def luminance(colour):
    parts = np.array([int(colour[place : place + 2], 16) for place in (1, 3, 5)]) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


def test_texts_stand_out_in_both_themes():
    style = (ASSETS / "page.css").read_text("utf-8")
    themes = [
        dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", block))
        for block in re.findall(r"\{([^{}]*--paper:[^{}]*)\}", style)
    ]
    assert len(themes) == 3
    assert themes[1] == themes[2]
    for theme in themes:
        for ink in ("ink", "soft", "link", "opponent"):
            for ground in ("paper", "panel"):
                pair = sorted((luminance(theme[ink]), luminance(theme[ground])))
                assert (pair[1] + 0.05) / (pair[0] + 0.05) >= 4.5, (ink, ground)


@pytest.mark.sumo
def test_the_scripts_unpack_what_was_packed():
    values = {"a": [1, 2, 3], "text": "é</script>"}
    found = javascript(["packing"], f"await unpacked({json.dumps(packed(values))})")
    assert found == values
    path = [0.0, 1.0, 2.1, 3.3, 3.3]
    assert javascript(["packing"], f"restored({steady(path, 0.1)}, 0.1)") == pytest.approx(path)
    assert javascript(["packing"], f"summed({stepwise(path, 0.1)}, 0.1)") == pytest.approx(path)


@pytest.mark.sumo
def test_intervals_of_the_page_are_those_of_the_tables():
    """The same specs with the same seeds, in both languages."""
    for hits in ([0] * 7, [1, 0, 0, 1, 1, 0, 0, 0, 0, 0], [1] * 10, [2, 0, 1], [0.0] * 300):
        seeds = [3 if 2 in hits else 1] * len(hits)
        seeds[-1] += 1
        rows = [
            {"run": f"s{unit}--a--{seed}", "hit": seed < ones}
            for unit, (ones, runs) in enumerate(zip(hits, seeds, strict=True))
            for seed in range(runs)
        ]
        found = javascript(["statistics"], f"rateOf(unitsOf({json.dumps(rows)}, (row) => row.hit))")
        groups = [[float(s < ones) for s in range(n)] for ones, n in zip(hits, seeds, strict=True)]
        assert found == pytest.approx(rate(groups)._asdict(), abs=1e-5)
    assert javascript(["statistics"], "rateOf([])") is None


@pytest.mark.sumo
def test_a_mean_says_of_how_many_runs_it_is():
    told = javascript(["statistics"], "[[], [null], [1], [1, 2.04], [1, null, 3]].map(meanOf)")
    assert told == ["–", "–", "1.0", "1.5", "2.0 (2 of 3)"]


@pytest.mark.sumo
def test_poses_between_steps_and_where_nobody_is():
    agent = {
        "every": 2,
        "parts": [{"first": 4, "x": [0, 2, 6], "y": [0, 0, 0], "heading": [0, 0, 1]}],
    }
    poses = f"[3.9, 4, 5, 7, 8, 8.1].map((step) => poseAt({json.dumps(agent)}, step))"
    found = javascript(["packing", "scene"], poses)
    assert [pose and pose["x"] for pose in found] == [None, 0, 1, 4, 6, None]


@pytest.mark.sumo
def test_a_browser_shows_table_and_replay(folder):
    if BROWSER is None:
        pytest.skip("no Chromium")
    folder.add("s1", scores={"b": 0.9, "c": 0.2})
    written = page.write(folder.out)
    text = shown(f"file://{written}")
    assert "1/1 = 100 %" in text
    assert "AV hit by opponent" in text
    text = shown(f"file://{written}#run=00-s1")
    assert "<canvas" in text
    assert "Plan at 0.0 s" in text
    assert "deepmf-sumo run runs/00-s1/spec.yaml" in text
    assert "cannot be shown" not in text


@pytest.mark.sumo
def test_the_page_opens_with_groups_of_failures(folder):
    metrics = worth_doubles.metrics() | {"opponent_rms_acceleration": 0.8}
    folder.add("s1", metrics=metrics)
    folder.add("s2", metrics=metrics)
    folder.add("miss", hit=False)
    written = page.write(folder.out)
    [group] = Parsed(written).content["failures"]
    text = written.read_text("utf-8")
    assert (group["runs"], group["of"], group["replay"]) == ([0, 1], 3, True)
    assert "It would have been enough" in group["sentence"]
    assert [
        "avoided by",
        "a careful driver (cc), braking or steering immediately (search)",
    ] in group["facts"]
    assert text.index('id="failures-title"') < text.index('id="totals-title"')


@pytest.mark.sumo
def test_a_failure_that_cannot_be_described_keeps_its_replay(folder, monkeypatch):
    def fail(*_):
        raise ValueError("made up")

    folder.add("s1")
    monkeypatch.setattr("deepmf_sumo.report.page.runs.failure_of", fail)
    found = Parsed(page.write(folder.out))
    assert found.content["failures"] == []
    assert "is in no group of failures: ValueError: made up" in found.rows[0]["note"]
    assert "replay" in found.details(0)


@pytest.mark.sumo
def test_a_browser_shows_the_failures(folder):
    if BROWSER is None:
        pytest.skip("no Chromium")
    folder.add("s1", metrics=worth_doubles.metrics())
    text = shown(f"file://{page.write(folder.out)}")
    assert "It would have been enough" in text
    assert "1 of 1 run" in text
    assert "Replay of 00-s1" in text


TURNS = [
    {
        "opponent": name,
        "begin_s": begin_s,
        "end_s": begin_s + 3.0,
        "ended": ended,
        "outcome": outcome,
        "hit_speed_mps": speed,
        "metrics": {"min_gap": gap, "ttc_min": None},
    }
    for name, begin_s, ended, outcome, speed, gap in (
        ("c", 0.0, "out_of_reach", "none", None, 0.4),
        ("b", 4.0, "contact", "av_opponent", 3.5, 0.0),
        ("<d>", 7.5, "time", "none", None, None),
    )
]


def with_turns(folder):
    folder.add("s1")
    (file,) = (folder.out / "runs").glob("*/result.json")
    file.write_text(json.dumps({**json.loads(file.read_text()), "turns": TURNS}))
    return file


@pytest.mark.sumo
def test_all_turns_are_there_and_the_decisive_one_is_said(folder):
    file = with_turns(folder)
    turns = Parsed(page.write(folder.out)).details(0)["turns"]
    assert [turn["opponent"] for turn in turns] == ["c", "b", "<d>"]
    assert [turn["decisive"] for turn in turns] == [False, True, False]
    assert turns[1]["outcome"] == "AV hit by opponent"
    result = json.loads(file.read_text())
    result["turns"] = [TURNS[2], TURNS[0]]
    file.write_text(json.dumps(result))
    turns = Parsed(page.write(folder.out)).details(0)["turns"]
    assert [turn["decisive"] for turn in turns] == [False, True]


@pytest.mark.sumo
def test_timelines_are_those_of_each_turn_while_it_lasts(folder):
    file = with_turns(folder)
    replay = Parsed(page.write(folder.out)).details(0)["replay"]
    now = replay["now"]
    step = restored(replay["timeline"]["step"], 1)
    known = {agent["id"] for agent in replay["agents"]}
    spans = [
        range(now + round(turn["begin_s"] * 10), now + round(turn["end_s"] * 10) + 1)
        for turn in TURNS
        if turn["opponent"] in known
    ]
    assert spans
    assert set(step) <= {one for span in spans for one in span}
    file.write_text(json.dumps({**json.loads(file.read_text()), "turns": None}))
    whole = Parsed(page.write(folder.out)).details(0)["replay"]["timeline"]
    assert whole["gap"] != replay["timeline"]["gap"]


@pytest.mark.parametrize(
    ("contacts", "decisive"),
    [
        ([("opponent_other", 20), ("av_opponent", 70)], 70),
        ([("av_other", 20), ("av_opponent", 70)], 70),
        ([("opponent_other", 30), ("av_other", 20)], 20),
        ([], None),
    ],
)
def test_a_replay_goes_to_the_contact_that_the_outcome_names(contacts, decisive):
    met = [contact_of(kind, step) for kind, step in contacts]
    found = replay(rollout_of({"av": straight(0, 0, 10), "b": straight(0, 9, 9)}, met), np.zeros(2))
    assert found["decisive"] == decisive
    assert [one["step"] for one in found["contacts"]] == [step for _, step in contacts]


@pytest.mark.sumo
def test_the_text_about_a_moment_names_all_contacts_up_to_it():
    met = [{"step": 20, "first": "b", "second": "parked", "speed": 1},
           {"step": 70, "first": "av", "second": "b", "speed": 9}]  # fmt: skip
    scene = {"now": 10, "dt": 0.1, "contacts": met, "onset": None, "turns": [], "agents": []}
    names = {"attackersAt": "[]", "conflictAt": "null", "unseenAt": "[]", "fixed": "''",
             "speedAt": "0", "driverAt": "''"}  # fmt: skip
    doubles = ", ".join(f"globalThis.{name} = () => {value}" for name, value in names.items())
    asked = f"({doubles}, [15, 30, 80].map((step) => momentText({json.dumps(scene)}, step)))"
    said = [one.count("contact of") for one in javascript(["moment"], asked)]
    assert said == [0, 1, 2]


@pytest.mark.sumo
def test_a_line_breaks_between_turns():
    found = javascript(["charts"], "apart([[1, 5], [2, 6], [7, 1], [8, null]])")
    assert found == [[1, 5], [2, 6], [6, None], [7, 1], [8, None]]
    turns = [
        {"opponent": "c", "begin": 0.0, "end": 1.0},
        {"opponent": "b", "begin": 2.0, "end": 3.0},
    ]
    scene = {"now": 10, "dt": 0.1, "agents": [{"id": "c"}, {"id": "b"}], "turns": turns}
    asked = "[10, 20, 25, 40].map((step) => attackersAt(SCENE, step).map((one) => one.id))"
    asked += ".concat(attackersOf(SCENE))"
    found = javascript(["turns"], asked.replace("SCENE", json.dumps(scene)))
    assert found == [["c"], ["c"], [], ["b"], "whose turn it is"]
    for turn in turns:
        turn |= {"begin": 0.0, "end": 2.0}
    found = javascript(["turns"], asked.replace("SCENE", json.dumps(scene)))
    assert found == [["c", "b"]] * 3 + [[], "c, b"]


@pytest.mark.sumo
def test_a_browser_marks_turns_on_the_timelines(folder):
    if BROWSER is None:
        pytest.skip("no Chromium")
    with_turns(folder)
    text = shown(f"file://{page.write(folder.out)}#run=00-s1")
    assert "Turns (3)" in text
    assert "AV hit by opponent (decisive)" in text
    assert "turn 3: &lt;d&gt;, end of the run" in text
    charts = text.count('<svg viewBox="0 0 460 150"')
    assert charts >= 1
    assert text.count('class="turn"') == 2 * charts
    assert text.count('class="turn hit"') == charts


@pytest.mark.sumo
@pytest.mark.parametrize("width", [1280, 420])
def test_the_table_of_runs_is_not_cut(folder, width, tmp_path):
    if BROWSER is None:
        pytest.skip("no Chromium")
    folder.add("s1", metrics={"ttc_min": 0.0, "finding": 0.0}, scores={"b": 0.9})
    folder.add("s2", hit=False, metrics={"ttc_min": 1.0, "finding": 0.0})
    street = "Friedrich-Engels-Straße (cluster_1238859995_3624767_2#0)"
    lines = "".join(f"0{run}-s{run + 1},north,{street},left\n" for run in range(2))
    (folder.out / "moments.csv").write_text(f"run_id,edge,street,turn\n{lines}")
    measure = """<script>
      const wide = document.getElementById("runs").parentElement;
      const size = [wide, document.documentElement];
      document.body.dataset.cut = size.map((one) => one.scrollWidth - one.clientWidth).join(" ");
    </script></body>"""
    text = page.write(folder.out).read_text("utf-8").replace("</body>", measure)
    (tmp_path / "page.html").write_text(text, "utf-8")
    text = shown(f"file://{tmp_path}/page.html", f"--window-size={width},900")
    assert 'data-cut="0 0"' in text
    assert "The same in all runs: method S1, planner replay, seed 0." in text


@pytest.mark.sumo
def test_rates_are_of_runs_with_an_opponent(folder):
    if BROWSER is None:
        pytest.skip("no Chromium")
    folder.add("s1")
    folder.add("s2", hit=False, opponent=None)
    assert "1/1 = 100 %" in shown(f"file://{page.write(folder.out)}")


def shown(address, *more):
    """The page's elements once its scripts have run."""
    options = [
        *more,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--virtual-time-budget=4000",
        "--dump-dom",
    ]
    done = subprocess.run(
        [BROWSER, *options, address], capture_output=True, text=True, check=True, timeout=60
    )
    return re.sub(r"<script.*?</script>", "", done.stdout, flags=re.DOTALL)


@pytest.mark.sumo
def test_a_metric_without_a_unit_is_shown(folder):
    folder.add("s1", metrics={"min_gap": 1.0})
    file = next((folder.out / "runs").glob("*/result.json"))
    values = json.loads(file.read_text())
    del values["metrics"]["min_gap"]["unit"]
    file.write_text(json.dumps(values))
    assert Parsed(page.write(folder.out)).details(0)["metrics"]["min_gap"][:2] == [1.0, ""]


@pytest.mark.sumo
def test_every_quantity_with_a_label_is_a_column_with_its_unit(folder):
    folder.add("s1", metrics={"ttc_min": 0.25})
    found = {column["name"]: column for column in Parsed(page.write(folder.out)).content["columns"]}
    labelled = {quantity.name: quantity for quantity in QUANTITIES if quantity.label}
    assert labelled.keys() <= found.keys()
    assert found["ttc_min_s"]["heading"] == "least TTC, s"
    assert found["finding_rate"]["kind"] == "flag"
    if BROWSER is None:
        pytest.skip("no Chromium")
    assert "least TTC, s</button>" in shown(f"file://{folder.out / 'report.html'}")
