"""An attacker in the pipeline of TeraSim, whose simulator steps SUMO."""

from pathlib import Path

import libsumo
import pytest

import deepmf_sumo

pytestmark = [pytest.mark.slow, pytest.mark.sumo]

NETS = Path(__file__).parents[2] / "sumo_nets" / "arterial"
WANTED = {"av": "av", "trigger": "time=8"}
UNTIL_S = 15.0


def test_terasim_is_attacked_as_a_script_is(tmp_path, monkeypatch):
    monkeypatch.delenv("USE_LIBSUMO", raising=False)
    simulator_module = pytest.importorskip(
        "terasim.simulator", reason="not installed: pip install --no-deps terasim"
    )
    config, net = NETS / "cut_in.sumocfg", NETS / "arterial.net.xml"
    simulator = simulator_module.Simulator(
        config, net, step_length=0.1, output_path=tmp_path, additional_sumo_args=["--no-warnings"]
    )
    begun = []

    def begin(simulator, context):
        begun.append(deepmf_sumo.Attacker(libsumo, **WANTED))

    def around(name):
        return lambda simulator, context: getattr(begun[0], name)()

    simulator.start_pipeline.hook("attacker", begin, priority=1)
    simulator.step_pipeline.hook("before_step", around("before_step"), priority=9)
    simulator.step_pipeline.hook("after_step", around("after_step"), priority=11)
    simulator.stop_pipeline.hook("attacker", around("close"), priority=0)
    simulator.start()
    while libsumo.simulation.getTime() < UNTIL_S:
        simulator.step()
    simulator.stop()
    (row,) = begun[0].attacks
    assert row["ended"] == "contact"
    assert _told(row) == _told(*_by_script(config))


def _by_script(config):
    """The same without TeraSim."""
    libsumo.start(["sumo", "-c", str(config), "--step-length", "0.1", "--no-warnings"])
    try:
        with deepmf_sumo.Attacker(libsumo, **WANTED) as attacker:
            while libsumo.simulation.getTime() < UNTIL_S:
                attacker.before_step()
                libsumo.simulationStep()
                attacker.after_step()
        return attacker.attacks
    finally:
        libsumo.close()


def _told(row):
    return {key: value for key, value in row.items() if key != "plan_ms"}
