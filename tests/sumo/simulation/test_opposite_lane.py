"""An AV that overtakes on the opposite lane: shown without jumps, and its path leads ahead."""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
import sumo

from deepmf_sumo.planners.perception import nearest_in_corridor
from deepmf_sumo.scene import HISTORY_STEPS, Command
from deepmf_sumo.sumo.simulation import network_case, simulate
from deepmf_sumo.sumo.simulation.traffic_survey import TrafficSurvey, survey_traffic

NOW = HISTORY_STEPS - 1
NODES = """<nodes><node id="w" x="0" y="0"/><node id="m" x="600" y="0"/>
<node id="e" x="900" y="90"/></nodes>"""
EDGES = "".join(
    f'<edge id="{a}{b}" from="{a}" to="{b}" numLanes="1" speed="25"/>'
    for a, b in ("wm", "mw", "me", "em")
)
ROUTES = """<routes><route id="east" edges="wm me"/>
<vType id="slow" maxSpeed="6" length="8" sigma="0"/>
<vType id="fast" maxSpeed="24" lcOpposite="3" sigma="0"/>
<vehicle id="lorry" type="slow" depart="0" departPos="170" departSpeed="6" route="east"/>
<vehicle id="av" type="fast" depart="0" departPos="20" departSpeed="10" route="east"/>
</routes>"""
CONFIG = """<configuration><input><net-file value="x.net.xml"/>
<route-files value="x.rou.xml"/></input></configuration>"""
OPTIONS = "--opposites.guess true --no-turnarounds true -n x.nod.xml -e x.edg.xml -o x.net.xml"


@pytest.fixture(scope="module", params=[(), ("--lefthand",)], ids=["right-hand", "left-hand"])
def config(request, tmp_path_factory, starts_sumo):
    folder = tmp_path_factory.mktemp("opposite")
    for name, text in (("nod", NODES), ("edg", f"<edges>{EDGES}</edges>"), ("rou", ROUTES)):
        (folder / f"x.{name}.xml").write_text(text)
    (folder / "x.sumocfg").write_text(CONFIG)
    command = [Path(sumo.SUMO_HOME) / "bin" / "netconvert", *OPTIONS.split(), *request.param]
    home = {**os.environ, "SUMO_HOME": sumo.SUMO_HOME}
    subprocess.run(command, cwd=folder, check=True, capture_output=True, env=home)
    return folder / "x.sumocfg"


class Looking:
    """Leaves the AV to SUMO; notes whether its path leads ahead, and what is in its corridor."""

    model = None

    def reset(self, case, rng):
        self.ahead, self.side, self.leaders = [], [], []

    def act(self, view):
        tracks = view.history
        row = tracks.row("av")
        here, heading = tracks.position_m[row, -1], tracks.heading_rad[row, -1]
        ahead = np.array([np.cos(heading), np.sin(heading)])
        way = view.av_path_m[: np.searchsorted(np.arange(200.0), 20.0)] - here
        self.ahead.append((way @ ahead).min())
        self.side.append(float(here[1]))
        leader = nearest_in_corridor(view, view.av_path_m, 0.2)
        self.leaders.append(None if leader is None else leader.agent_id)
        return Command(kind="sumo")


def test_it_is_shown_without_a_jump_and_planners_see_ahead(config):
    planner = Looking()
    case = network_case(config, 1.5, "av", 300, seed=0)
    rollout = simulate(case, planner, None, rng=np.random.default_rng(0))
    tracks, row = rollout.tracks, rollout.tracks.row("av")
    x, y = tracks.position_m[row, NOW:].T
    y = y[x < 590.0]  # from there on the road bends
    assert np.ptp(y) > 3.0  # it was on the opposite lane
    assert abs(y[-1] - y[0]) < 0.3  # and is back
    assert np.abs(np.diff(y)).max() < 0.3
    assert np.abs(np.diff(tracks.heading_rad[row, NOW:])).max() < 0.1
    assert min(planner.ahead) > 0.0
    aside = np.abs(np.array(planner.side)[: len(y)] - y[0]) > 3.0
    assert aside.any()
    assert {planner.leaders[step] for step in np.flatnonzero(aside)} == {None}
    assert "lorry" in planner.leaders
    assert rollout.contacts == ()


def test_a_survey_measures_to_the_end_of_the_edge_that_it_is_on_by_its_route(config):
    seen = survey_traffic(TrafficSurvey(config=config, sumo_options=(), seed=0))
    (av,) = (row for row, body in enumerate(seen.bodies) if body.id == "av")
    rows = (seen.vehicle == av) & (seen.edge == seen.edges.index("wm")) & (seen.to_end_m > 0)
    x, y = seen.position_m[rows].T
    assert np.ptp(y) > 3.0  # it was on the opposite lane
    assert np.ptp(x + seen.to_end_m[rows]) < 1.0
