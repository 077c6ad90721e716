"""The planner that is careful with people is right in small situations; each copy fails in one."""

import dataclasses
import functools

import numpy as np
import pytest
from small_situations import Situation, drive, road, steady, still

from deepmf_sumo.scene.geometry import sight
from studies.planner_faults import __main__ as command
from studies.planner_faults import measure, people
from studies.planner_faults.people import FaultySettings, FaultyWithPeople

NORTH = np.pi / 2
PERSON, BICYCLE, VAN = (0.6, 0.6, 1.75), (1.8, 0.65, 1.7), (6.2, 2.1, 2.6)


def crossing(x, y, at_s, speed=1.4):
    """Stands, and walks north from a time on."""

    def motion(t):
        return x, y + speed * max(t - at_s, 0.0), NORTH, speed if t > at_s else 0.0

    return motion


def one(motion, size, **more):
    return Situation(others={"other": (motion, size)}, **more)


SITUATIONS = {
    "walks across": one(steady(40, -4.3, NORTH, 1.4), PERSON, seconds=6),
    "rides across": one(steady(40, -13.0, NORTH, 4.2), BICYCLE, seconds=6),
    "steps out": one(crossing(40, -3.4, 1.9), PERSON, seconds=6),
    "steps out late": one(crossing(45, -3.4, 1.9), PERSON, seconds=6),
    "comes out behind a van": Situation(
        others={"van": (still(30, -2.9), VAN), "other": (crossing(34.2, -3.1, 0.9), PERSON)},
        seconds=6,
    ),
}
WRONG = {
    "blind_pedestrians": "walks across",
    "blind_cyclists": "rides across",
    "late_for_people": "steps out",
    "ignores_kerb": "steps out late",
    "slow_cyclists": "rides across",
    "blind_behind_vehicles": "comes out behind a van",
}


class WithoutHidden:
    """A planner that is shown who is in sight alone."""

    def __init__(self, planner):
        self._planner, self.model, self.reset = planner, planner.model, planner.reset

    def act(self, view):
        tracks = view.history
        seen = sight.visible(tracks, tracks.steps - 1, tracks.row("av"), view.road)
        shown = tracks.select(np.flatnonzero(seen).tolist())
        return self._planner.act(dataclasses.replace(view, history=shown))


@functools.cache
def driven(fault, name):
    planner = FaultyWithPeople(FaultySettings(fault=fault))
    return drive(WithoutHidden(planner), SITUATIONS[name], road())


@pytest.mark.parametrize("name", SITUATIONS)
def test_the_planner_without_fault_hits_nobody(name):
    assert not driven("none", name).hit


@pytest.mark.parametrize(("fault", "name"), WRONG.items())
def test_each_copy_hits_who_its_fault_is_about(fault, name):
    assert driven(fault, name).hit


def test_there_are_six_faults_and_each_has_its_situation():
    assert {*WRONG} == {*people.FAULTS}
    assert len(WRONG) == 6


def test_it_passes_who_stands_far_beside_and_vans_that_hide_nothing_at_its_speed():
    far = one(still(40, -8.0, NORTH), PERSON, seconds=5)
    row = Situation(others={str(n): (still(20 + 6.3 * n, -3.2), VAN) for n in range(16)}, seconds=4)
    for situation in (far, row):
        planner = FaultyWithPeople(FaultySettings())
        assert min(drive(planner, situation, road()).speeds) > 12.9


def test_measure_of_people_has_the_six_copies_and_the_street_with_people():
    arguments = ["measure", "--people", "--out", "out"]
    asked = measure.Asked.of(command._parser().parse_args(arguments))
    assert [*asked.faults] == [*people.FAULTS]
    assert [file.name for file in asked.specs] == ["high_street.yaml"]
    spec = measure.spec_of(asked.specs[0], asked, {"fault": "ignores_kerb"})
    assert spec.planner.name.endswith("people:FaultyWithPeople")
    assert spec.adversary.settings["attackers"] == "people"
    assert spec.av_sees == "in_sight"


def test_the_table_counts_faults_of_people_apart():
    nothing = measure.Found(12, 12, 0, 0)
    told = nothing._replace(by=("impact (impact_mps)",))
    lines = [measure.Line("careful", nothing), measure.Line("ignores_kerb", told)]
    text = measure.table(lines)
    assert "of people: 1 of 1 reported with the first seeds" in text
    assert "open:" not in text
