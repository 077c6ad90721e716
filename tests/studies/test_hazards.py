"""Forty places with four planted flaws: built to the same bytes, and ranked by their risk."""

import importlib.util
import itertools
import subprocess
from pathlib import Path

import pytest

from deepmf_sumo import plugins, spec
from deepmf_sumo.results.risk.attacks import Attacked, Network
from deepmf_sumo.results.risk.places import Spot, read
from deepmf_sumo.sumo.network.sumo_net import read_net, waiting_ways
from deepmf_sumo.sumo.network.sumo_road import road_of_net

FOLDER = Path(__file__).resolve().parents[2] / "studies" / "hazards"


def _script(name):
    spec = importlib.util.spec_from_file_location(f"hazards_{name}", FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


BUILD, RANK, STUDY = _script("build"), _script("rank"), _script("study")


@pytest.fixture(scope="module")
def config(tmp_path_factory, starts_sumo):
    return BUILD.build(tmp_path_factory.mktemp("hazards"))


def test_the_same_arguments_give_the_same_bytes(config, tmp_path):
    again = BUILD.build(tmp_path)
    names = sorted(file.name for file in config.parent.iterdir())
    assert names == sorted(file.name for file in again.parent.iterdir())
    for name in names:
        assert (config.parent / name).read_bytes() == (tmp_path / name).read_bytes()


def test_only_the_flawed_places_differ_from_those_of_their_kind(config):
    places = read(config.parent / "hazards.net.xml")
    assert tuple(place.name for place in BUILD.places()) == RANK.PLACES
    assert BUILD.FLAWED == RANK.FLAWED

    def nature(name):
        mine = [one for one in places.movements.values() if one.junction.startswith(f"{name}_")]
        lane = places.lanes.get(f"{name}_lane_0")
        return sorted((one.turn, one.rule) for one in mine), lane and round(lane.length_m)

    for kind in BUILD.KINDS:
        names = [name for name in RANK.PLACES if name.startswith(kind)]
        good = {str(nature(name)) for name in names if name not in BUILD.FLAWED}
        assert len(good) == 1
        if kind != "signal":  # its flaw is in the programme
            (flawed,) = [name for name in names if name in BUILD.FLAWED]
            assert str(nature(flawed)) not in good


@pytest.mark.slow
def test_traffic_flows_and_sumo_misses_the_one_yellow(config):
    program = BUILD.NETCONVERT.with_name("sumo")
    done = subprocess.run(
        [program, "-c", config, "--no-step-log"], capture_output=True, text=True, check=True
    )
    yellow = [line for line in done.stderr.splitlines() if "Missing yellow" in line]
    assert yellow
    assert all("'signal6'" in line for line in yellow)
    assert "Teleporting" not in done.stderr


def test_places_of_a_kind_differ_a_little_and_alike_with_and_without_flaws(config, tmp_path):
    places = list(BUILD.places())
    for share in ("volume", "speed"):
        values = [getattr(place, share) for place in places]
        assert len(set(values)) == len(places)
        assert 0.8 <= min(values) < 1.0 < max(values) <= 1.2
    control = BUILD.build(tmp_path, ())
    assert (control.parent / "hazards.rou.xml").read_bytes() == (
        config.parent / "hazards.rou.xml"
    ).read_bytes()


def test_who_gives_way_is_read_from_the_network(config):
    lanes = road_of_net(config.parent / "hazards.net.xml").lanes

    def first(name):
        found = [lane for lane in lanes.values() if lane.id.startswith(f":{name}_mid_")]
        return {lane.id: set(lane.gives_way_to) for lane in found if lane.gives_way_to}

    # north and south give way to east and west
    main = {":stop0_mid_1_0", ":stop0_mid_3_0"}
    assert first("stop0") == {":stop0_mid_0_0": main, ":stop0_mid_2_0": main}
    assert first("stop8") == {}
    # the left turn waits in the middle: both of its lanes give way to who comes towards it
    left = {name: who for name, who in first("left1").items() if name.startswith(":left1_mid_8")}
    [(name, who)] = left.items()
    (towards,) = who
    [behind] = [lane for lane in lanes.values() if name in lane.previous]
    assert behind.gives_way_to == (towards,)
    assert "left1_east_in_0" in lanes[towards].previous


def test_only_the_left_turn_through_gaps_has_a_place_to_wait(config):
    net = read_net(config.parent / "hazards.net.xml")
    assert waiting_ways(net) == {("left1_west_in", "left1_north_out")}


NUMBERS = itertools.count()


def attacked(place, value, *, hit=False):
    return Attacked(
        folder="out", run_id=f"m--{next(NUMBERS)}--0", turn=None, scene="s", seed=1,
        decided=Spot(), began=Spot(edge=f"{place}_west_in"), place_m=(0.0, 0.0), hit=hit,
        other=False, worth=None, ttc_s=None, gap_m=0.0, delta_v_mps=8.0 if hit else None,
        criticality=value,
    )  # fmt: skip


def test_a_place_that_is_critical_in_all_its_attacks_leads_and_one_near_miss_does_not():
    attacks = [attacked(name, 0.0) for name in RANK.PLACES for _ in range(8)]
    attacks += [attacked("left1", 0.5) for _ in range(8)] + [attacked("merge3", 0.9)]
    table = RANK.ranked(attacks)
    assert table[0].name == "left1"
    assert [place.name for place in table if place.risk.stands_out] == ["left1"]
    assert {place.rank for place in table[1:]} == {21.0}
    assert (table[0].attacks, table[0].hits, table[0].risk.mean) == (16, 0, 0.25)


def test_agreement_is_kendalls():
    names = list(RANK.PLACES)
    order = {name: float(rank) for rank, name in enumerate(names)}
    back = dict(zip(names, reversed(order.values()), strict=True))
    assert RANK.agreement(order, order) == 1.0
    assert RANK.agreement(order, back) == -1.0
    swapped = order | {names[0]: 1.0, names[1]: 0.0}
    assert RANK.agreement(order, swapped) == pytest.approx(1 - 2 / 780)


def seed(out, near_misses):
    """Two places that are critical in all attacks, and good ones with a near miss each."""
    values = dict.fromkeys(RANK.PLACES, 0.0) | out
    attacks = [attacked(name, value) for name, value in values.items() for _ in range(8)]
    return RANK.ranked([*attacks, *[attacked(name, 0.9) for name in near_misses]])


def test_near_misses_at_good_places_change_the_order_of_all_but_not_the_ranks():
    out = {"left1": 0.9, "stop8": 0.7}
    first, second = seed(out, ["merge1", "signal2"]), seed(out, ["left5", "stop3"])
    for table in (first, second):
        assert [(place.name, place.rank) for place in table[:2]] == [("left1", 1), ("stop8", 2)]
        assert {place.rank for place in table[2:]} == {21.5}
    assert RANK.agreement(RANK._ranks(first), RANK._ranks(second)) == 1.0
    assert RANK.agreement(RANK._excesses(first), RANK._excesses(second)) < 0.8
    other = seed({"left1": 0.9, "merge3": 0.7}, [])
    assert RANK.agreement(RANK._ranks(first), RANK._ranks(other)) < 0.8


def test_results_without_the_measure_are_refused(tmp_path, monkeypatch, capsys):
    old = Network(
        name="hazards", net_file=tmp_path, places=None, left_out={},
        attacks=(attacked("left1", None),),
    )  # fmt: skip
    monkeypatch.setattr(RANK, "read", lambda folders: [old])
    monkeypatch.setattr("sys.argv", ["rank.py", str(tmp_path)])
    assert RANK.main() == 2
    assert "repeat the attacks" in capsys.readouterr().err


@pytest.mark.parametrize("script", [BUILD, RANK])
def test_a_flawed_place_that_is_none_is_refused(script, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["hazards", str(tmp_path), "--flawed", "merge33"])
    with pytest.raises(SystemExit):
        script.main()
    assert "invalid choice: 'merge33'" in capsys.readouterr().err


def test_a_folder_that_cannot_be_made_is_told_in_one_line(tmp_path, monkeypatch, capsys):
    (tmp_path / "file").touch()
    monkeypatch.setattr("sys.argv", ["build.py", str(tmp_path / "file" / "inside")])
    assert BUILD.main() == 1
    assert "cannot be written: Not a directory" in capsys.readouterr().err


def test_a_study_builds_attacks_every_kind_with_every_seed_and_ranks(tmp_path, monkeypatch):
    done = []

    def run(command, check):
        done.append(command)
        return subprocess.CompletedProcess(command, 0)

    monkeypatch.setattr(STUDY.subprocess, "run", run)
    monkeypatch.setattr("sys.argv", ["study.py", str(tmp_path), "--seeds", "4", "5", "--flawed"])
    assert STUDY.main() == 0
    build, *attacks, rank = done
    assert build[-1] == "--flawed"
    assert [Path(one[-1]).relative_to(tmp_path).parts for one in attacks] == [
        (seed, f"{kind}-{prefer}")
        for seed in ("4", "5")
        for prefer in ("spread", "encounters")
        for kind in STUDY.KINDS
    ]
    assert set(STUDY.KINDS) == set(BUILD.KINDS)
    assert rank[-3:] == [str(tmp_path / "4"), str(tmp_path / "5"), "--flawed"]
    file = tmp_path / "spec.yaml"
    file.write_text("{version: 3, name: hazards, source: {recording: .}}", encoding="utf-8")
    choice = spec.load(file, [f"adversary.{key}={one}" for key, one in STUDY.WISHES.items()])
    settings = plugins.settings("adversaries", "deepmf", choice.adversary.settings)
    assert (settings.constraints, settings.form.reactions) == (("lawful",), 4)


def test_a_study_ends_with_the_exit_code_of_what_went_wrong(tmp_path, monkeypatch):
    def run(command, check):
        return subprocess.CompletedProcess(command, 3)

    monkeypatch.setattr(STUDY.subprocess, "run", run)
    monkeypatch.setattr("sys.argv", ["study.py", str(tmp_path)])
    assert STUDY.main() == 3


def test_conflicts_of_plain_traffic_rank_places_against_their_kind(tmp_path):
    places = ["stop8_mid", "stop8_mid", "stop8_mid", "merge0_lane", "elsewhere"]
    places += [f"merge{number}_lane" for number in range(1, 10) for _ in range(2)]
    rows = "".join(f"{one}\n" for one in places)
    (tmp_path / "conflicts.csv").write_text(f"place\n{rows}")
    table = {name: row for name, *row in RANK.ranked_by_conflicts([tmp_path])}
    assert table["stop8"] == [3, 3.0, 1.0]
    assert table["merge0"] == [1, -1.0, 40.0]
    assert table["merge5"] == [2, 0.0, 20.5]
