"""What a live attack says of its episode is what `attack` says of the same one."""

import subprocess
from pathlib import Path

import libsumo
import numpy as np
import pytest
import sumo as sumo_package

from deepmf_sumo.planners import sumo as plain
from deepmf_sumo.scene import TurnRules
from deepmf_sumo.sumo.simulation import network_case, simulate

from tests.support import tiny_network
from tests.support.live_doubles import OPTIONS, session_on, step
from tests.support.live_policies import Keep

pytestmark = pytest.mark.sumo
TOLD = {"av_stop_ahead", "av_stop_over", "jumped", "teleported"}
STOP = '<stop lane="ab_0" endPos="150" duration="2"/></vehicle>'
GRID = """<routes><route id="r" edges="A0B0 B0C0 C0D0"/>
<vehicle id="leader" route="r" depart="0"/><vehicle id="other" route="r" depart="2"/>
<vehicle id="av" route="r" depart="5"/></routes>"""
CONFIG = """<configuration><input><net-file value="{}"/>
<route-files value="{}"/></input></configuration>"""


def at_a_stop(folder):
    """The AV has a stop 120 m ahead."""
    tiny_network.build(folder)
    first, av = tiny_network.ROUTES.split('<vehicle id="av"')
    routes = first + '<vehicle id="av"' + av.replace("</vehicle>", STOP, 1)
    (folder / "stop.rou.xml").write_text(routes)
    return "tiny.net.xml", "stop.rou.xml", 1.0, 250


def over_junctions(folder):
    """Without lanes inside junctions SUMO's cars jump over them."""
    command = [Path(sumo_package.SUMO_HOME) / "bin" / "netgenerate", "--grid", "-o",
               folder / "grid.net.xml", "--no-internal-links", "true",
               "--no-turnarounds", "true"]  # fmt: skip
    subprocess.run(list(map(str, command)), check=True, timeout=60, capture_output=True)
    (folder / "grid.rou.xml").write_text(GRID)
    return "grid.net.xml", "grid.rou.xml", 7.0, 100


@pytest.mark.parametrize("made", [at_a_stop, over_junctions])
def test_stops_of_the_av_and_jumps_of_sumo_are_told(tmp_path, made):
    net, routes, start_s, steps = made(tmp_path)
    config = tmp_path / "told.sumocfg"
    config.write_text(CONFIG.format(net, routes))
    more = ("--seed", "0", "--step-length", "0.1", "--step-method.ballistic", "false")
    libsumo.start(["sumo", "-c", str(config), *OPTIONS, *more])
    try:
        libsumo.simulationStep(start_s - 1.1)
        rules = TurnRules(longest_s=steps / 10, harmless_s=1000.0, reach_m=1000.0)
        session, fought = session_on(libsumo, tmp_path, Keep(), rules=rules, net=net)
        step(libsumo, session, steps + 15)
    finally:
        libsumo.close()
    case = network_case(config, start_s, "av", steps, seed=0)
    twin = simulate(case, plain.build(plain.Settings()), Keep(), rng=np.random.default_rng(0))
    live, offline = (
        [(one.agent_id, one.kind, one.step) for one in rollout.events if one.kind in TOLD]
        for rollout in (fought[0].rollout, twin)
    )
    last = fought[0].rollout.tracks.steps
    known = [one for one in offline if one[2] < last]
    assert live
    assert [one[:2] for one in live] == [one[:2] for one in known]
    assert [one[2] for one in live] == pytest.approx([one[2] for one in known], abs=5)
