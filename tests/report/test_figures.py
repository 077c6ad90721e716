import csv
import struct

import numpy as np
import pytest
from matplotlib.text import Text

from deepmf_sumo.errors import UsageError
from deepmf_sumo.report import figures
from deepmf_sumo.report.figures import (
    FIGURES,
    attacks,
    draw_all,
    methods,
    scores,
    sectors,
    style,
    write_timelines,
)
from deepmf_sumo.report.figures.style import Skipped
from deepmf_sumo.results import reader

from tests.support import worth_doubles
from tests.support.result_folders import Folder

SCORES = {"b": 0.9, "c": 0.6, "d": 0.2, "e": 0.1}
NATURAL = {"opponent_rms_acceleration": 1.2, "acceleration_kl": 0.4}


@pytest.fixture(autouse=True)
def home(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("DEEPMF_SUMO_HOME", str(tmp_path_factory.mktemp("home")))
    monkeypatch.setattr(style, "DPI", 80)  # a fraction of the time


@pytest.fixture
def folder(tmp_path):
    return Folder(tmp_path)


def draw(figure, folder):
    with style.printed():
        return figure(reader.Results.of(folder.out))


def texts(sheet):
    return [one.get_text() for one in sheet.figure.findobj(Text) if one.get_text()]


def width_in(png):
    return struct.unpack(">II", png.read_bytes()[16:24])[0] / style.DPI


def test_a_rollout_is_read_as_it_was_written(folder):
    written = folder.add("one")
    read = reader.Results.of(folder.out).done[0].rollout
    assert set(read.tracks.ids) == set(written.tracks.ids)
    assert "NA" in read.tracks.ids
    for agent in written.tracks.ids:
        old, new = written.tracks.row(agent), read.tracks.row(agent)
        np.testing.assert_allclose(
            read.tracks.position_m[new], written.tracks.position_m[old], atol=1e-4
        )
        np.testing.assert_array_equal(read.driver[new], written.driver[old])
    assert (read.now, read.av_id, read.opponent_id) == (10, "av", "b")
    assert read.outcome == "av_opponent"
    assert read.contacts[0].step == 40
    np.testing.assert_array_equal(read.plans[0].position_m, written.plans[0].position_m)


@pytest.mark.sumo
def test_all_figures_of_a_benchmark(folder):
    for method, speed in (("DeepMF-S1", 12.0), ("B$RS", 14.0)):
        folder.add("one", method=method, speed=speed, scores=SCORES, metrics=NATURAL)
    folder.fail("one")
    files = draw_all(folder.out)
    names = {path.name for path in files}
    assert {"figure_3_scores.png", "figure_4_attacks.svg", "figure_6_methods.png"} <= names
    assert width_in(folder.out / "figures" / "figure_5_sectors.png") == pytest.approx(3.4)
    assert files[-1].name == "index.md"
    index = files[-1].read_text()
    assert all(f"## {name}\n" in index for name in FIGURES)
    assert "Not drawn: it takes two methods with at least 5 attacked runs" in index


@pytest.mark.sumo
def test_same_bytes_and_no_figures_of_earlier_runs(folder, monkeypatch):
    folder.add("one")
    monkeypatch.setattr(figures, "FIGURES", {"a": attacks.draw, "b": scores.draw})
    files = draw_all(folder.out)
    before = {path: path.read_bytes() for path in files}
    (folder.out / "figures" / "b.png").write_bytes(b"of an earlier run")
    assert draw_all(folder.out) == files
    assert {path: path.read_bytes() for path in files} == before
    assert not (folder.out / "figures" / "b.png").exists()
    assert "<dc:date>" not in (folder.out / "figures" / "a.svg").read_text()


@pytest.mark.sumo
def test_print_is_legible(folder):
    for method in ("S1", "S2"):
        folder.add("one", method=method, scores=SCORES, sector=2)
    shown = (scores.draw, attacks.draw, sectors.draw, methods.draw_methods, attacks.draw_timelines)
    for figure in shown:
        sheet = draw(figure, folder)
        written = [one for one in sheet.figure.findobj(Text) if one.get_text()]
        assert min(one.get_fontsize() for one in written) >= style.SMALLEST_PT
        assert sheet.figure.get_figwidth() in (style.SINGLE_IN, style.DOUBLE_IN)


def test_nothing_to_draw_says_why(folder):
    folder.add("one", hit=False)
    for figure, why in {
        scores.draw: "no run chose its opponent among at least 4 scored vehicles within 35 m",
        attacks.draw: "no run hit the AV",
        sectors.draw: "no run hit the AV",
        methods.draw_methods: "there is one method alone",
        attacks.draw_timelines: "no run hit the AV",
        methods.draw_budget: "there is no curves.csv: the plan has no `curves`",
    }.items():
        assert draw(figure, folder) == Skipped(why)


@pytest.mark.sumo
def test_scores_show_the_scenes_in_which_they_differ(folder):
    folder.add("alike", scores=dict.fromkeys("bcde", 0.5))
    folder.add("differ", scores=SCORES)
    folder.add("few", scores={"b": 0.9, "c": 0.1})
    sheet = draw(scores.draw, folder)
    assert sheet.runs == ("01-differ", "00-alike")
    assert "(a) opponent's score 0.90" in texts(sheet)
    assert "Of 2 scenes" in sheet.caption


@pytest.mark.sumo
def test_attacks_take_turns_among_the_sides_and_findings_first(folder):
    good = worth_doubles.metrics()
    folder.add("one", sector=0, metrics=worth_doubles.metrics("C"))
    folder.add("two", sector=0, metrics=good)
    folder.add("three", sector=4, metrics=good)
    folder.add("miss", hit=False)
    folder.add("three", method="other", adversary="none", sector=2)
    sheet = draw(attacks.draw, folder)
    assert sheet.runs == ("01-two", "02-three", "00-one")
    assert "(b) rear, 3.0 s, 4.5 m/s" in texts(sheet)
    assert "3 scenes with a hit by S1" in sheet.caption


@pytest.mark.sumo
def test_sectors_are_counted_and_the_absent_said(folder):
    folder.add("one", sector=0, metrics={"collision_speed": 3.0})
    folder.add("two", sector=0, metrics={"collision_speed": 5.0, "accident_type": 1.0})
    folder.add("three", sector=6, turn=1.0)
    sheet = draw(sectors.draw, folder)
    assert sheet.runs == ("01-two", "02-three")
    shown = texts(sheet)
    assert "front\nrear-end" in shown
    assert "right" in shown
    assert shown.count("none of\n3 hits") == 6
    assert shown.count("0") >= 6
    assert "2" in shown
    assert "No hit on the rear." in sheet.caption


@pytest.mark.sumo
def test_attacks_that_asked_for_a_sector_come_first(folder):
    fast = {"collision_speed": 9.0}
    folder.add("one", sector=3, metrics=fast)
    for wish in ("rear_left", 2):
        adversary = {"name": "deepmf", "version": "S1", "sector": wish}
        folder.add("one", method=f"to {wish}", adversary=adversary, part="figures", sector=3)
    sheet = draw(sectors.draw, folder)
    assert sheet.runs == ("01-one",)
    assert "rear left\nasked for" in texts(sheet)
    assert "how many of the 1 hits" in sheet.caption
    assert draw(attacks.draw, folder).runs == ("00-one",)


def test_the_av_drives_up_in_a_panel_of_a_sector(folder):
    folder.add("one", turn=2.0)
    run = reader.Results.of(folder.out).done[0]
    window = sectors._from_av(run)
    ahead = run.contact.pose_first[:2] + np.array([np.cos(2.0), np.sin(2.0)])
    step = window.place(ahead) - window.place(run.contact.pose_first[:2])
    np.testing.assert_allclose(step, [0.0, 1.0], atol=1e-9)


@pytest.mark.sumo
def test_methods_share_a_scene_in_which_they_differ(folder):
    for scene, courses in {"alike": (0.0, 0.0), "differ": (0.0, -0.3)}.items():
        for method, course in zip(("S1", "G"), courses, strict=True):
            folder.add(scene, method=method, course=course)
    folder.add("missed", method="S1", hit=False)
    folder.add("missed", method="G", hit=False, course=-1.0)
    sheet = draw(methods.draw_methods, folder)
    assert sheet.runs == ("02-differ", "03-differ")
    assert "(b) G\nfront, 3.0 s, 4.5 m/s" in texts(sheet)


@pytest.mark.sumo
def test_nobody_attacked_is_drawn_too(folder):
    folder.add("one", method="S1", hit=False, opponent=None)
    folder.add("one", method="none", adversary="none", hit=False, opponent=None)
    assert draw(methods.draw_methods, folder).runs == ("00-one", "01-one")


def test_rates_count_attacked_runs_of_the_own_budget(folder):
    for number in range(6):
        for method in ("S1", "G"):
            hit = method == "S1" and number < 3
            natural = {"opponent_rms_acceleration": 1.0 + number}
            folder.add(f"s{number}", method=method, hit=hit, metrics=natural)
    folder.add("s6", hit=False, opponent=None)
    folder.add("s7", method="S1 (8 simulations)", part="budgets")
    found = reader.Results.of(folder.out)
    assert "S1 (8 simulations)" not in found.methods
    points = methods._points(found, "replay", "opponent_rms_acceleration")
    assert [(one.method, one.rate.rate, one.mean.mean) for one in points] == [
        ("S1", 0.5, 3.5),
        ("G", 0.0, 3.5),
    ]
    sheet = draw(methods.draw_tradeoff, folder)
    assert "KL of accelerations, nat" not in texts(sheet)  # nobody has it
    assert {"S1", "G", "planner replay"} <= set(texts(sheet))


def test_curves_become_lines(folder):
    folder.add("one", method="BRS")
    rows = [
        ("own", "", "", 0.5, 32), ("given", 8, "", 0.2, 8), ("given", 320, "", 0.75, 320),
        ("given", "", 2.0, 0.4, 20), ("given", 640, "", "", 640),
    ]  # fmt: skip
    with (folder.out / "curves.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        budgets = ["budget", "budget_simulations", "budget_seconds"]
        rate = ["collision_rate", "collision_rate_lo", "collision_rate_hi"]
        writer.writerow(["method", "planner", *budgets, *rate, "simulations"])
        for kind, simulations, seconds, value, spent in rows:
            row = ["BRS", "replay", kind, simulations, seconds, value, value, value, spent]
            writer.writerow(row)
    sheet = draw(methods.draw_budget, folder)
    (axes,) = sheet.figure.axes  # one number of seconds makes no line
    lines = [line.get_xydata().tolist() for line in axes.lines]
    assert [[8.0, 0.2], [32.0, 0.5], [320.0, 0.75]] in lines
    assert [[32.0, 0.5]] in lines
    assert axes.get_xticks().tolist() == [8.0, 32.0, 320.0]


@pytest.mark.sumo
def test_the_road_of_a_lost_recording_is_that_of_the_network(folder, tmp_path):
    folder.add("one")
    run = reader.Results.of(folder.out).done[0]
    assert len(run.road()[0].lanes) == 2
    assert run.road()[1] == ""
    (tmp_path / "one.npz").unlink()
    reader._recorded.cache_clear()
    with pytest.raises(UsageError, match=r"holds no net\.net\.xml"):
        run.road()
    (run.folder / "sumo").mkdir()
    (run.folder / "sumo" / "net.net.xml").write_text(
        '<net version="1.20"><edge id="a" from="n" to="m"><lane id="a_0" index="0" speed="13"'
        ' length="100" shape="0,0 100,0"/></edge></net>'
    )
    road, note = run.road()
    assert list(road.lanes) == ["a_0"]
    assert "one.npz does not exist" in note
    assert draw(attacks.draw, folder).notes == (note,)


def test_no_result_folder(tmp_path):
    with pytest.raises(UsageError, match=r"is not a complete result folder: it has no runs\.csv"):
        draw_all(tmp_path)


def test_timelines_of_any_rollout(folder, tmp_path):
    rollout = folder.add("one")
    png, svg = write_timelines(rollout, tmp_path / "lines", "a $title")
    assert png.stat().st_size > 10_000
    assert svg.read_text().startswith("<?xml")
    alone = folder.add("two", hit=False, opponent=None)
    with pytest.raises(ValueError, match="no vehicle was attacked"):
        write_timelines(alone, tmp_path / "lines")
