"""A connection that is lost: at the simulation's end, or for another reason."""

from types import SimpleNamespace

import pytest

from deepmf_sumo.errors import SimulationError
from deepmf_sumo.live.lockstep import Lockstep, Stay

# as libsumo and every copy of traci have one of their own
Lost = type("FatalTraCIError", (Exception,), {})
Refused = type("TraCIException", (Exception,), {})


def steps_lost_at(time_s, error=Lost, *, script_left=False):
    def lost():
        session.time_s = time_s
        raise error("connection closed by SUMO")

    nothing = lambda *_: None  # noqa: E731
    session = SimpleNamespace(
        time_s=0.0, before_step=nothing, after_step=nothing, close=nothing, idle_frames=lambda: 0,
        keep_time=nothing, check_script=nothing, script_left=script_left,
    )  # fmt: skip
    api = SimpleNamespace(
        simulationStep=lost,
        close=nothing,
        simulation=SimpleNamespace(getOption=lambda name: "25.0", getTime=lambda: 0.0),
    )
    return Lockstep(api, [session], Stay(), lambda: False)


def test_at_the_end_the_simulation_is_over():
    assert steps_lost_at(24.9).run() == "simulation_over"


@pytest.mark.parametrize("time_s", [12.0, 80.0], ids=["before", "SUMO goes on for its clients"])
def test_else_it_is_lost(time_s):
    with pytest.raises(SimulationError, match=f"lost at {time_s} s"):
        steps_lost_at(time_s).run()


def test_a_sumo_that_was_ended_since_the_script_left_is_no_error():
    assert steps_lost_at(12.0, script_left=True).run() == "script_left"


def test_what_sumo_refuses_is_told():
    with pytest.raises(SimulationError, match=r"SUMO refused at 3\.0 s .*: connection closed"):
        steps_lost_at(3.0, Refused).run()


def test_other_errors_are_not_sumos():
    with pytest.raises(ZeroDivisionError):
        steps_lost_at(3.0, ZeroDivisionError).run()
