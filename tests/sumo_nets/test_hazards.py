"""Forty places with four planted flaws: built to the same bytes, and ranked by their risk."""

import importlib.util
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from deepmf_sumo.benchmark.risk import Attacked
from deepmf_sumo.benchmark.risk.places import Spot, read

FOLDER = Path(__file__).resolve().parents[2] / "sumo_nets" / "hazards"


def _script(name):
    spec = importlib.util.spec_from_file_location(f"hazards_{name}", FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


BUILD, RANK = _script("build"), _script("rank")


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    return BUILD.build(tmp_path_factory.mktemp("hazards"))


def test_the_same_arguments_give_the_same_bytes(config, tmp_path):
    again = BUILD.build(tmp_path)
    names = sorted(file.name for file in config.parent.iterdir())
    assert names == sorted(file.name for file in again.parent.iterdir())
    for name in names:
        assert (config.parent / name).read_bytes() == (tmp_path / name).read_bytes()


def test_only_the_flawed_places_differ_from_those_of_their_kind(config):
    places = read(config.parent / "hazards.net.xml")
    assert tuple(name for name, *_ in BUILD.places()) == RANK.PLACES
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


def test_traffic_flows_and_sumo_misses_the_one_yellow(config):
    program = BUILD.NETCONVERT.with_name("sumo")
    done = subprocess.run(
        [program, "-c", config, "--no-step-log"], capture_output=True, text=True, check=True
    )
    yellow = [line for line in done.stderr.splitlines() if "Missing yellow" in line]
    assert yellow
    assert all("'signal6'" in line for line in yellow)
    assert "Teleporting" not in done.stderr


def attacked(place, *, hit):
    return Attacked(
        folder="out", run_id="r", turn=None, scene="s", seed=1,
        decided=Spot(), began=Spot(edge=f"{place}_west_in"), place_m=(0.0, 0.0), hit=hit,
        other=False, avoidable=None, ttc_s=None, gap_m=0.0, delta_v_mps=8.0 if hit else None,
    )  # fmt: skip


def test_a_place_that_is_hit_often_leads_and_one_lucky_hit_does_not():
    attacks = [attacked(name, hit=False) for name in RANK.PLACES for _ in range(8)]
    attacks += [attacked("left1", hit=True)] * 6 + [attacked("merge3", hit=False)] * 6
    lucky = [attacked("stop2", hit=True), attacked("stop2", hit=False)]
    table = RANK.ranked([*attacks, *lucky], "severe")
    assert [place.name for place in table[:2]] == ["left1", "stop2"]
    assert table[0].risk.low > 2 * table[1].risk.low
    mild = [replace(one, delta_v_mps=1.0) for one in attacks if one.hit]
    assert not any(place.events for place in RANK.ranked(mild, "severe"))


def test_agreement_is_kendalls():
    def table(order):
        return [RANK.Place(name, 1, 0, None, rank) for rank, name in enumerate(order)]

    names = list(RANK.PLACES)
    assert RANK.agreement(table(names), table(names)) == 1.0
    assert RANK.agreement(table(names), table(names[::-1])) == -1.0
    swapped = [names[1], names[0], *names[2:]]
    assert RANK.agreement(table(names), table(swapped)) == pytest.approx(1 - 2 / 780)


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
