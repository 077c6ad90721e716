"""What signals ask of vehicles."""

import libsumo
import pytest

from deepmf_sumo.scene import SignalState, signals
from deepmf_sumo.scene.signals import FORBIDS, GOES, HALTS, STOP_FIRST

from tests.support import crossing_network


def test_each_state_has_one_meaning():
    sets = [FORBIDS, HALTS - FORBIDS, STOP_FIRST, GOES]
    assert sum(map(len, sets)) == len(frozenset().union(*sets)) == 7
    rest = set(SignalState) - frozenset().union(*sets)
    assert rest == {SignalState.UNKNOWN, SignalState.FLASHING_CAUTION}


def test_colours_are_those_of_the_lamps():
    of = {state: signals.colour(state) for state in SignalState}
    assert of[SignalState.FLASHING_STOP] == of[SignalState.ARROW_STOP] == "red"
    assert of[SignalState.FLASHING_CAUTION] == of[SignalState.CAUTION] == "yellow"
    assert of[SignalState.GO] == "green"
    assert of[SignalState.UNKNOWN] is None
    assert [signals.steady(one) for one in (SignalState.FLASHING_STOP, SignalState.GO)] == [
        None,
        "green",
    ]


def test_every_state_has_a_letter_and_letters_their_states():
    assert set(signals.LETTER_OF) == set(SignalState)
    steady = (SignalState.STOP, SignalState.CAUTION, SignalState.GO)
    assert [signals.STATE_OF[signals.LETTER_OF[one]] for one in steady] == list(steady)


@pytest.fixture(scope="module")
def config(tmp_path_factory, starts_sumo):
    """One car."""
    routes = """<routes><vehicle id="up" depart="0" departSpeed="max" departPos="40">
    <route edges="south north"/></vehicle></routes>"""
    folder = tmp_path_factory.mktemp("lights")
    return crossing_network.build(folder, middle="traffic_light", routes=routes)


@pytest.mark.parametrize("letter", sorted(signals.STATE_OF))
def test_sumo_knows_the_letters_and_its_drivers_do_as_we_say(config, letter):
    """A car that arrives alone passes at once, passes after a stop, or waits."""
    libsumo.start(["sumo", "-c", str(config), "--step-length", "0.1", "--no-warnings"])
    try:
        count = len(libsumo.trafficlight.getRedYellowGreenState("mid"))
        libsumo.trafficlight.setRedYellowGreenState("mid", letter * count)
        slowest = 99.0
        for _ in range(400):
            libsumo.simulationStep()
            there = "up" in libsumo.vehicle.getIDList()
            if not there or libsumo.vehicle.getRoadID("up") != "south":
                break
            slowest = min(slowest, libsumo.vehicle.getSpeed("up"))
        waits = there and libsumo.vehicle.getRoadID("up") == "south"
    finally:
        libsumo.close()
    state = signals.STATE_OF[letter]
    assert waits == (state in HALTS)
    if not waits:
        assert (slowest < 0.5) == (state in STOP_FIRST)
