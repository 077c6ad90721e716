"""An opponent with a stop behind it is driven off its route: SUMO would end over that stop."""

from pathlib import Path

import numpy as np
import pytest
import sumolib

from deepmf_sumo.planners.idm import Settings, build
from deepmf_sumo.scene import Plan
from deepmf_sumo.scene.geometry import polylines
from deepmf_sumo.sumo.simulation import network_case, simulate

pytestmark = pytest.mark.sumo

NET = Path(__file__).parents[3] / "sumo_nets" / "highway" / "highway.net.xml"
ROUTES = """<routes>
<route id="on" edges="on_ramp middle-AddedOnRampEdge middle middle-AddedOffRampEdge after"/>
<vehicle id="van" depart="0" departPos="280" departSpeed="5" route="on">
  <stop lane="on_ramp_0" endPos="300" duration="0.5"/></vehicle>
<vehicle id="av" depart="0" departPos="100" departSpeed="5" route="on"/>
</routes>"""
CONFIG = """<configuration><input><net-file value="{}"/>
<route-files value="van.rou.xml"/></input></configuration>"""


class Along:
    """Drives the van along points, from wherever it is."""

    period_steps = None

    def __init__(self, points, heading):
        self.points, self.heading = points, heading

    def reset(self, view, rng):
        return ("van",)

    def plan(self, view):
        return {
            "van": Plan(
                agent_id="van",
                first_step=view.step + 1,
                position_m=self.points,
                heading_rad=self.heading,
                speed_mps=np.full(len(self.points), 20.0),
            )
        }


@pytest.mark.jumps("it is put 1 km farther on, off its route")
def test_an_opponent_with_a_stop_behind_it_may_leave_its_route(tmp_path, starts_sumo):
    (tmp_path / "van.rou.xml").write_text(ROUTES)
    config = tmp_path / "van.sumocfg"
    config.write_text(CONFIG.format(NET))
    net = sumolib.net.readNet(str(NET))
    edges = [net.getEdge(name) for name in ("middle-AddedOffRampEdge", "off_ramp")]
    shape = np.array([point for edge in edges for point in edge.getLanes()[0].getShape()])
    points, heading = polylines.points_at(shape, np.arange(210.0, 300.0, 2.0))
    case = network_case(config, 8.0, "av", 70)
    policy = Along(points, heading)
    rollout = simulate(case, build(Settings()), policy, rng=np.random.default_rng(0))
    tracks, row = rollout.tracks, rollout.tracks.row("van")
    begin, end = rollout.now + 1, rollout.now + 1 + len(points)
    np.testing.assert_allclose(tracks.position_m[row, begin:end], points, atol=0.01)
    kinds = [event.kind for event in rollout.events if event.agent_id == "van"]
    assert "seen_on_route" in kinds
    assert "plan_ended" in kinds
    steps = np.hypot(*np.diff(tracks.position_m[row, begin:], axis=0).T)
    assert steps.max() < 2.1  # it drove 2 m a step
