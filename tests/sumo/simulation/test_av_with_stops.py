"""An AV with a stop of its route: what it stops for is in the record, so no monitor complains."""

from pathlib import Path

import numpy as np
import pytest

from deepmf_sumo.judge.metrics import Episode
from deepmf_sumo.judge.metrics.av_rules import av_unexplained_braking, av_unexplained_stop
from deepmf_sumo.planners.idm import Settings, build
from deepmf_sumo.sumo.simulation import network_case, simulate

pytestmark = pytest.mark.sumo

NET = Path(__file__).parents[3] / "sumo_nets" / "highway" / "highway.net.xml"
ROUTES = """<routes><vType id="b" vClass="bus"/>
<vehicle id="bus" depart="0" departPos="100" departSpeed="10" type="b">
  <route edges="on_ramp middle-AddedOnRampEdge middle"/>
  <stop lane="on_ramp_0" endPos="280" duration="4"/></vehicle>
</routes>"""
CONFIG = """<configuration><input><net-file value="{}"/>
<route-files value="bus.rou.xml"/></input></configuration>"""


def test_a_bus_stops_where_its_schedule_says(tmp_path):
    (tmp_path / "bus.rou.xml").write_text(ROUTES)
    config = tmp_path / "bus.sumocfg"
    config.write_text(CONFIG.format(NET))
    case = network_case(config, 2.0, "bus", 300)
    rollout = simulate(case, build(Settings()), None, rng=np.random.default_rng(0))
    at = {event.kind: event.step for event in rollout.events}
    speed = rollout.tracks.speed_mps[rollout.tracks.row("bus")]
    stands = np.flatnonzero(speed[rollout.now :] < 0.1) + rollout.now
    assert len(stands) == pytest.approx(40, abs=10)
    assert at["av_stop_ahead"] < stands[0]
    assert stands[-1] - 2 <= at["av_stop_over"] <= stands[-1] + 2
    episode = Episode(rollout, case)
    assert av_unexplained_braking.compute(episode) == 0.0
    assert av_unexplained_stop.compute(episode) < 0.5  # it sets off again
