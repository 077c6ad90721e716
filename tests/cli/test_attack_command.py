"""``deepmf-sumo attack`` on a tiny network."""

import csv
import json
import shutil
from dataclasses import replace

import pytest

from deepmf_sumo.cli import main
from deepmf_sumo.errors import UsageError
from deepmf_sumo.spec.tasks import slug
from deepmf_sumo.study.moments import search
from deepmf_sumo.study.moments.search import names_of
from deepmf_sumo.sumo.simulation import demand
from deepmf_sumo.sumo.simulation.sumo_config import read_configuration
from deepmf_sumo.sumo.simulation.traffic_survey import TrafficSurvey, survey_traffic

from tests.support import crossing_network, tiny_network


def attack(tiny, out, *more):
    first = ["attack", tiny / "tiny.sumocfg", "--out", out, "--no-pictures"]
    return main.run([str(one) for one in [*first, "--set", "adversary=none", *more]])


def test_attacks_moments_of_its_own_choice_and_keeps_them(tiny, tmp_path, capsys):
    out = tmp_path / "out"
    assert attack(tiny, out, "--moments", 2, "--set", "duration_s=1", "--", "--scale", 1) == 0
    shown = capsys.readouterr()
    assert "asks for steps of 1 s; it is run with 0.1 s" in shown.err
    assert "tiny.sumocfg: 2 vehicles from 0 to" in shown.err
    assert "2 runs: 2 ok" in shown.out
    with (out / "moments.csv").open() as table:
        moments = list(csv.DictReader(table))
    assert [one["edge"] for one in moments] == ["ab", "ab"]
    with (out / "runs.csv").open() as table:
        runs = list(csv.DictReader(table))
    assert [one["run_id"] for one in runs] == [one["run_id"] for one in moments]
    assert {one["seed"] for one in runs} == {"23423"}
    file = out / "runs" / runs[0]["run_id"] / "result.json"
    kept, written = json.loads(file.read_text()), file.stat().st_mtime_ns
    assert [event["kind"] for event in kept["events"]] == ["step_length_changed"]
    again = ("--resume", "--moments", 2, "--set", "duration_s=1", "--", "--scale", 1)
    assert attack(tiny, out, *again) == 0
    assert "2 runs: 2 ok" in capsys.readouterr().out
    assert file.stat().st_mtime_ns == written


def test_times_are_kept_and_nothing_later_is_looked_at(tiny, tmp_path, capsys):
    out = tmp_path / "out"
    assert attack(tiny, out, "--at", 2.5, "--av", "leader", "--set", "duration_s=0.5") == 0
    assert "tiny.sumocfg: 2 vehicles from 0 to 4 s" in capsys.readouterr().err
    assert (out / "runs" / "tiny--leader-2-5s--23423" / "tracks.csv.gz").exists()


def test_a_late_survey_lets_sumo_drive_unseen_first(tiny):
    survey = TrafficSurvey(config=tiny / "tiny.sumocfg", sumo_options=(), seed=1)
    whole, late = survey_traffic(survey), survey_traffic(replace(survey, from_s=12.0))
    assert late.begin_s == 2.0
    assert late.time_s.min() == 3.0
    same = whole.time_s >= 3.0
    assert (late.position_m == whole.position_m[same]).all()


def test_attacks_begin_once_the_traffic_has_settled_or_when_asked(tiny, tmp_path, capsys):
    assert attack(tiny, tmp_path / "a", "--moments", 2, "--set", "duration_s=1") == 0
    shown = capsys.readouterr().err
    assert "attacked from 1 s on, when the number of vehicles has settled at about 2" in shown
    assert attack(tiny, tmp_path / "b", "--moments", 2, "--set", "duration_s=1", "--from", 4) == 0
    assert "2 vehicles from 0 to" in (shown := capsys.readouterr().err)
    assert "; attacked from 4 s on\n" in shown
    assert "no two edges meet at any junction of the network: no moment has an encounter" in shown
    with (tmp_path / "b" / "moments.csv").open() as table:
        assert min(float(one["start_s"]) for one in csv.DictReader(table)) >= 4.0
    assert attack(tiny, tmp_path / "c", "--from", 900) == 0
    line = "no vehicle to attack in tiny.sumocfg: there is no vehicle from 900 s on; --from S "
    assert line in capsys.readouterr().out


def test_nobody_to_attack_is_a_line_an_empty_folder_and_no_failure(tiny, tmp_path, capsys):
    out = tmp_path / "out"
    assert attack(tiny, out, "--", "--end", "0.5") == 0
    line = "no vehicle to attack in tiny.sumocfg: there is no vehicle from 0 to 0 s"
    assert capsys.readouterr().out.strip() == line
    assert json.loads((out / "summary.json").read_text())["runs"] == 0
    assert (out / "moments.csv").read_text().startswith("run_id,av,")


@pytest.mark.parametrize(
    ("more", "message", "code"),
    [
        (["--av", "laeder"], "--av laeder: no such vehicle is in the demand of", 2),
        (
            ["--set", "source.moments.av_type=bus"],
            "source.moments.av_type bus: no such type is in the demand of",
            2,
        ),
        (["--at", "2.55"], "--at 2.55: the simulation goes in steps of 0.1 s", 2),
        (["--junction", "c"], "--junction c: no such junction is in the network; there are", 2),
        (["--edge", "aab"], "--edge aab: no such edge is in the network; there are ab.", 2),
        (["--from", "60", "--", "--end", "60"], "--from 60: tiny.sumocfg ends at 60 s", 2),
        (["--until", "5", "--", "--begin", "9"], "--until 5: tiny.sumocfg begins at 9 s", 2),
        (["--from", "9", "--until", "9"], "must be earlier than until_s, which is 9", 2),
        (["--from", "9", "--at", "12"], "cannot be given with 'at_s' (--at)", 2),
        (["--at", "70", "--", "--end", "60"], "--at 70: there is traffic from 0 to 60 s only", 2),
        (["--", "-r", "none.rou.xml"], "none.rou.xml', which does not exist.", 3),
        (["--", "--nonsense", "1"], "No option with the name 'nonsense' exists", 3),
        (["--", "--seed", "1"], "SUMO's option --seed cannot be given", 2),
        (["--set", "source.start_s=1"], "only those of source.moments can be set", 2),
        (["--set", "planer.x=1"], "--set planer.x=1: key 'planer': unknown key", 2),
        (["--set", "weights=nope"], "There are no weights 'nope'", 2),
        (["--planner", "imd"], "--planner: key 'planner.name': No plug-in 'imd'", 2),
    ],
)
def test_refusals_are_one_line(tiny, tmp_path, capsys, monkeypatch, more, message, code):
    if "--nonsense" not in more:  # which SUMO alone knows
        monkeypatch.setattr(search, "survey_traffic", None)
        monkeypatch.setattr(search.workers, "run", None)
    assert attack(tiny, tmp_path / "out", *more) == code
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1
    assert message in errors[0]
    assert not (tmp_path / "out").exists()


def test_a_seed_of_the_configuration_that_cannot_be_used(tmp_path, capsys):
    """It was silently SUMO's 23423; with a seed on the command line it does not matter."""
    config = tiny_network.build(tmp_path)
    seed = '<random_number><seed value="-5"/></random_number></configuration>'
    config.write_text(config.read_text().replace("</configuration>", seed))
    assert attack(tmp_path, tmp_path / "out", "--moments", 1, "--set", "duration_s=1") == 3
    assert "has seed '-5', which is not a whole number from 0" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    more = ("--moments", 1, "--set", "duration_s=1", "--seed", 7)
    assert attack(tmp_path, tmp_path / "out", *more) == 0


def test_all_configurations_are_looked_at_before_the_first_is_simulated(
    tiny, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(search.workers, "run", None)
    bad = tiny / "no_routes.sumocfg"
    bad.write_text((tiny / "tiny.sumocfg").read_text().replace("tiny.rou", "none.rou"))
    assert attack(tiny, tmp_path / "out", bad) == 3
    assert "names the route file" in capsys.readouterr().err
    out = tmp_path / "used"
    (out / "runs" / "one").mkdir(parents=True)
    (out / "manifest.json").write_text('{"tool": "deepmf-sumo", "runs": {"one": ""}}')
    assert attack(tiny, out) == 2
    assert "holds the results of an earlier command" in capsys.readouterr().err


def test_names_are_those_of_the_folders_where_files_are_called_alike(tmp_path):
    def names(*paths):
        return names_of([tmp_path / path for path in paths])

    assert names("run.sumocfg", "b/other.sumocfg") == ["run", "other"]
    assert names("a/run.sumocfg", "b/Run.sumocfg", "c.sumocfg") == ["a", "b", "c"]
    assert names("a/x/run.sumocfg", "b/x/run.sumocfg", "c/y/run.sumocfg") == ["a x", "b x", "y"]
    assert len(set(names("one.sumocfg", "one.cfg"))) == 2
    with pytest.raises(UsageError, match="is given 2 times"):
        names("a/run.sumocfg", "b/../a/run.sumocfg")


def test_names_in_the_demand_are_known_without_a_simulation(tiny):
    routes = tiny / "many.rou.xml"
    routes.write_text(
        '<routes><vType id="lorry"/><flow id="flow" type="lorry"/><trip id="a.b"/></routes>'
    )
    options = ["-r", str(routes)]
    known = demand.read(read_configuration(tiny / "tiny.sumocfg", options))
    for name, there in {
        "flow.17": True,
        "a.b": True,
        "a.b.1": True,  # its copy by --scale
        "a": False,
        "b.0": False,
    }.items():
        assert known.has_vehicle(name) == there, name
    assert known.like_vehicle("flw.0")[0] == "flow.0"
    assert known.has_type("lorry")
    assert known.has_type("DEFAULT_VEHTYPE")
    routes.write_text('<routes><include href="more.rou.xml"/></routes>')
    assert demand.read(read_configuration(tiny / "tiny.sumocfg", options)) is None


@pytest.mark.parametrize("option", ["--at", "--until"])
@pytest.mark.parametrize("value", ["nan", "inf"])
def test_numbers_are_finite(tiny, tmp_path, capsys, option, value):
    assert attack(tiny, tmp_path / "out", option, value) == 2
    assert f"'{option}': {value} is not a finite number." in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_moments_of_another_attack_make_pairs(tiny, tmp_path, capsys):
    first, again = tmp_path / "first", tmp_path / "again"
    assert attack(tiny, first, "--moments", 2, "--set", "duration_s=1") == 0
    assert (
        attack(tiny, again, "--moments-of", first, "--set", "duration_s=1", "--planner", "sumo")
        == 0
    )
    assert (first / "moments.csv").read_text() == (again / "moments.csv").read_text()
    (tmp_path / "odd.csv").write_text("a,b\n1,2\n")
    for more, message in (
        (["--moments-of", tmp_path / "nothing"], "cannot be read (No such file or directory)"),
        (
            ["--moments-of", tmp_path / "odd.csv"],
            "is not a table of moments (columns av and start_s)",
        ),
        (
            ["--moments-of", first, "--av", "leader"],
            "--av: key 'source.moments.av': cannot be given with 'of' (--moments-of)",
        ),
        (
            ["--moments-of", first, "--set", "source.moments.prefer=encounters"],
            "key 'source.moments.prefer': encounters cannot be given with 'of'",
        ),
    ):
        capsys.readouterr()
        assert attack(tiny, tmp_path / "bad", *more) == 2
        assert message in capsys.readouterr().err


def test_several_configurations_go_into_one_folder(tiny, tmp_path, capsys):
    other, same = tiny / "other.sumocfg", tmp_path / "tiny.sumocfg"
    other.write_text((tiny / "tiny.sumocfg").read_text())
    out = tmp_path / "out"
    assert attack(tiny, out, other, "--at", 2.5, "--set", "duration_s=0.5", "--", "--scale", 1) == 0
    shown = capsys.readouterr()
    assert "2 runs: 2 ok" in shown.out
    assert "other.sumocfg: 2 vehicles" in shown.err
    with (out / "moments.csv").open() as table:
        ids = [row["run_id"] for row in csv.DictReader(table)]
    assert [one.partition("--")[0] for one in ids] == ["tiny", "other"]
    assert {path.name for path in (out / "runs").iterdir()} == set(ids)
    same.write_text(other.read_text().replace('value="tiny', f'value="{tiny}/tiny'))
    asked = ("--at", 2.5, "--set", "duration_s=0.5", "--set", "sweep.risk=false")
    assert attack(tiny, tmp_path / "folders", same, *asked) == 0
    found = {path.name.partition("--")[0] for path in (tmp_path / "folders" / "runs").iterdir()}
    assert found == {slug(tiny.name), slug(tmp_path.name)}
    assert attack(tiny, tmp_path / "bad", tiny / "tiny.sumocfg") == 2
    assert "tiny.sumocfg is given 2 times" in capsys.readouterr().err
    for again in (["--moments-of", out], ["--set", f"source.moments.of={out}"]):
        assert attack(tiny, tmp_path / "bad", other, *again) == 2
        assert "--moments-of goes with one configuration" in capsys.readouterr().err
    assert not (tmp_path / "bad").exists()


def test_moments_name_their_street(tiny, tmp_path):
    named = shutil.copytree(tiny, tmp_path / "named")
    net = named / "tiny.net.xml"
    net.write_text(net.read_text().replace('<edge id="ab"', '<edge id="ab" name="High &amp; Low"'))
    out = tmp_path / "out"
    assert attack(named, out, "--at", 2.5, "--av", "av", "--set", "duration_s=0.5") == 0
    with (out / "moments.csv").open() as table:
        (moment,) = csv.DictReader(table)
    assert (moment["edge"], moment["street"]) == ("ab", "High & Low")


@pytest.mark.parametrize("mapped", [True, False])
def test_attacks_leave_a_risk_map(tiny, tmp_path, capsys, mapped):
    out = tmp_path / "out"
    more = ["--at", 2.5, "--av", "av", "--set", "duration_s=1"]
    more += ["--set", "adversary={name: rule, opponent: leader}"]
    assert attack(tiny, out, *more, *([] if mapped else ["--set", "sweep.risk=false"])) == 0
    assert (f"{out}/risk/risk.html" in capsys.readouterr().out) == mapped
    assert (out / "risk" / "edges.xml").is_file() == mapped


def test_encounters_are_attacked_first_where_they_are_preferred(tmp_path, capsys):
    """In a packed left-hand network."""
    config = crossing_network.build(tmp_path, "--lefthand", net="crossing.net.xml.gz")
    out = tmp_path / "out"
    asked = [
        "--set",
        "source.moments.prefer=encounters",
        "--moments",
        1,
        "--set",
        "duration_s=4",
        "--no-pictures",
    ]
    command = [
        "attack",
        config,
        *asked,
        "--set",
        "sweep.risk=false",
        "--set",
        "adversary=none",
        "--out",
        out,
    ]
    assert main.run([str(one) for one in command]) == 0
    assert "1 moment, 1 of them before an encounter; chosen from" in capsys.readouterr().err
    with (out / "moments.csv").open() as table:
        (moment,) = csv.DictReader(table)
    assert moment["av"] in {"over1", "up1"}
    assert float(moment["encounter_s"]) < 2.0
    assert main.run(["attack", str(config), "--set", "source.moments.prefer=crashes"]) == 2
    assert "'crashes': Input should be 'both', 'spread' or 'encounters'" in capsys.readouterr().err


@pytest.mark.parametrize("included", [False, True])
def test_types_of_a_distribution_are_those_of_all_files(tiny, included):
    text = """<additional><vTypeDistribution id="mix" vTypes="old"><vType id="car1"/>
        <vType id="lorry" vClass="truck"/></vTypeDistribution><vType id="old"/></additional>"""
    (tiny / "mix.add.xml").write_text(text)
    (tiny / "outer.add.xml").write_text('<additional><include href="mix.add.xml"/></additional>')
    named = "outer.add.xml" if included else "mix.add.xml"
    options = ("--additional-files", str(tiny / named))
    configuration = read_configuration(tiny / "tiny.sumocfg", options)
    assert demand.types_of(configuration, "mix") == ("old", "car1", "lorry")
    assert demand.types_of(configuration, "car1") == ("car1",)
