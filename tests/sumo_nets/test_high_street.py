"""The packaged street with people: who is in its traffic, and its spec for attacks by people."""

import subprocess
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path

import pytest
import sumo

from deepmf_sumo import spec as specs

ROOT = Path(__file__).resolve().parents[2]
STREET = ROOT / "sumo_nets" / "high_street"


@pytest.mark.sumo
def test_people_walk_cross_and_ride_buses_and_cyclists_ride_among_cars(tmp_path):
    trips, where = tmp_path / "trips.xml", tmp_path / "where.xml"
    program = Path(sumo.SUMO_HOME) / "bin" / "sumo"
    command = [program, "-c", STREET / "high_street.sumocfg", "--no-step-log", "--no-warnings"]
    command += ["--tripinfo-output", trips, "--tripinfo-output.write-unfinished"]
    command += ["--fcd-output", where, "--device.fcd.period", "1"]
    subprocess.run(command, check=True, capture_output=True)
    kinds = Counter(trip.get("vType") for trip in ET.parse(trips).getroot().iter("tripinfo"))
    assert kinds["cyclist"] >= 10
    assert kinds["bus"] == 4
    assert kinds["parked"] + kinds["parked_van"] >= 20
    assert sum(ride.get("vehicle", "").startswith("line_7")
               for ride in ET.parse(trips).getroot().iter("ride")) >= 2  # fmt: skip
    walked = [(one.get("id"), one.get("edge")) for one in ET.parse(where).getroot().iter("person")]
    assert len({who for who, _ in walked}) >= 80
    for crossing in (":zebra_c", ":signals_c"):
        assert len({who for who, edge in walked if edge.startswith(crossing)}) >= 8


def test_its_spec_lets_people_attack_and_is_not_among_those_of_vehicles():
    (file,) = (ROOT / "suite" / "people").glob("*.yaml")
    spec = specs.load(file)
    assert spec.source.network == STREET / "high_street.sumocfg"
    assert spec.source.people.who == "both"
    assert spec.adversary.settings["attackers"] == "people"
    assert len(list((ROOT / "suite").glob("*.yaml"))) == 7
