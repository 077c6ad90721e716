"""SUMO's own words reach the user: what the program `sumo` prints for the same files."""

import os
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest
import sumo

from deepmf_sumo.cli import main
from deepmf_sumo.errors import SimulationError
from deepmf_sumo.roadcheck.motion_survey import Survey, survey
from deepmf_sumo.sumo.simulation import sumo_config, sumo_words
from deepmf_sumo.sumo.simulation.sumo_api import STEP_OPTIONS, running

from tests.support.tiny_network import build

SUMO = Path(sumo.SUMO_HOME) / "bin" / "sumo"
ROUTE = '<route edges="{}"/>'


def said_by_sumo(config):
    """Errors and warnings that the program prints."""
    command = [str(SUMO), "-c", str(config), "--no-step-log", "--end", "20"]
    lines = subprocess.run(command, capture_output=True, text=True, check=False).stderr.splitlines()
    kinds = {"Error": [], "Warning": []}
    for line in lines:
        kind, _, text = line.partition(": ")
        kinds.get(kind, []).append(text)
    return kinds


def config_of(folder, *vehicles):
    """The tiny network with vehicles, and one without fault."""
    config = build(folder)
    edges = (folder / "tiny.rou.xml").read_text().partition('edges="')[2].partition('"')[0]
    text = "".join(one.replace("ROUTE", f'<route edges="{edges}"/>') for one in vehicles)
    (folder / "tiny.rou.xml").write_text(
        f'<routes><vType id="car"/><vehicle id="ok" type="car" depart="0"><route edges="{edges}"/>'
        f"</vehicle>{text}</routes>"
    )
    return config


WRONG = {
    "an id that it does not take": '<vehicle id="taxi 7" type="car" depart="3">ROUTE</vehicle>',
    "a type that is not there": '<vehicle id="x" type="lorry" depart="3">ROUTE</vehicle>',
    "an edge that is not there":
        '<vehicle id="x" type="car" depart="3"><route edges="nowhere"/></vehicle>',
    "a trip to an edge that is not there":  # in two lines
        '<trip id="x" type="car" depart="3" from="nowhere" to="nowhere"/>',
    # SUMO reads one vehicle ahead, so this one is met in a step, not at the start
    "an id after a vehicle that it takes":
        '<vehicle id="second" type="car" depart="2">ROUTE</vehicle>'
        '<vehicle id="taxi 7" type="car" depart="9">ROUTE</vehicle>',
}  # fmt: skip


@pytest.mark.sumo
@pytest.mark.parametrize("fault", WRONG)
def test_an_error_names_what_sumo_names(fault, tmp_path, capsys):
    config = config_of(tmp_path, WRONG[fault])
    words = [one for one in said_by_sumo(config)["Error"] if one]
    assert words
    with pytest.raises(SimulationError) as refused:
        survey(Survey(config=config, seed=1, until_s=20.0))
    assert str(refused.value).count(words[0].rstrip(".")) == 1
    code = main.run(["attack", str(config), "--moments", "1", "--out", str(tmp_path / "out")])
    assert code == 3
    assert words[0].rstrip(".") in " ".join(capsys.readouterr().err.split())


@pytest.mark.sumo
def test_an_output_in_a_folder_that_is_not_there_is_named_as_sumo_names_it(tmp_path, capsys):
    config = config_of(tmp_path)
    output = '<output><statistic-output value="res/stat.xml"/></output></configuration>'
    config.write_text(config.read_text().replace("</configuration>", output))
    (said,) = [one for one in said_by_sumo(config)["Error"] if one]
    assert main.run(["attack", str(config), "--moments", "1", "--out", str(tmp_path / "out")]) == 3
    assert said.rstrip(".") in " ".join(capsys.readouterr().err.split())


@pytest.mark.sumo
def test_an_error_on_the_way_to_a_start_names_what_sumo_names(tmp_path):
    config = config_of(tmp_path, WRONG["an id after a vehicle that it takes"])
    case = SimpleNamespace(config=config, sumo_options=(), seed=1, start_s=100.0)
    with pytest.raises(SimulationError, match=r"SUMO does not come to .*'taxi 7'"):
        sumo_config.hold(case, None)


@pytest.mark.sumo
def test_demand_that_sumo_drops_or_changes_is_told(tmp_path, capsys):
    config = config_of(
        tmp_path,
        '<vehicle id="later" type="car" depart="4">ROUTE</vehicle>',
        '<vehicle id="early" type="car" depart="1">ROUTE</vehicle>',
    )
    words = said_by_sumo(config)["Warning"]
    assert words
    found = survey(Survey(config=config, seed=1, until_s=20.0)).warnings
    kinds = [one.removeprefix("SUMO warns: ").partition(" (")[0] for one in found]
    assert set(kinds) <= set(words)
    assert any("'early'" in one for one in kinds)
    command = ["attack", str(config), "--moments", "1", "--set", "adversary=none"]
    main.run(
        [*command, "--no-pictures", "--set", "sweep.risk=false", "--out", str(tmp_path / "out")]
    )
    assert "'early'" in " ".join(capsys.readouterr().err.split())


def test_warnings_are_counted_by_kind(tmp_path):
    lines = [
        f"Warning: Vehicle '{name}' performs emergency braking, time={name}.5." for name in (1, 2)
    ]
    lines += ["Warning: The road", " is long.", "Error: Gone.", "Quitting (on error)."]
    lines += [f"Warning: {'a' * number}." for number in range(1, 7)]
    (tmp_path / sumo_words.MESSAGES).write_text("\n".join(lines))
    found = sumo_words.warnings_in(tmp_path)
    assert found[0] == (
        "SUMO warns: Vehicle '1' performs emergency braking, time=1.5. (1 more like it)"
    )
    assert found[1] == "SUMO warns: The road is long."
    assert found[-1] == "SUMO gives warnings of 3 more kinds"
    assert len(found) == 6
    assert sumo_words.before("Process Error", tmp_path) == "Gone. Process Error."
    assert sumo_words.warnings_in(tmp_path / "nowhere") == ()


@pytest.mark.sumo
def test_a_copy_of_a_process_has_messages_of_its_own(tmp_path):
    """As workers do that share the traffic up to a start (`sumo_config.hold`)."""
    # SUMO reads demand 200 s ahead
    late = WRONG["an id that it does not take"].replace('depart="3"', 'depart="400"')
    between = [
        f'<vehicle id="{one}" type="car" depart="{one}">ROUTE</vehicle>' for one in (350, 390)
    ]
    config = config_of(tmp_path, *between, late)
    parent, child = tmp_path / "parent", tmp_path / "child"
    parent.mkdir()
    child.mkdir()
    arguments = ["-c", str(config), *sumo_words.to_file(parent), *STEP_OPTIONS]
    with running(arguments, folder=parent) as api:
        api.simulationStep(1.0)
        process = os.fork()
        if not process:
            sumo_words.divert(parent, child)
            try:
                api.simulationStep(401.0)
            except (api.TraCIException, api.FatalTraCIError):
                api.close()
            os._exit(0)
        os.waitpid(process, 0)
        assert "taxi 7" in sumo_words.before("", child)
        assert "taxi 7" not in sumo_words.before("", parent)
