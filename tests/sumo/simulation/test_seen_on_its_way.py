"""SUMO's vehicles see an opponent that brakes on its own way, wherever lanes lie on each other."""

import libsumo
import numpy as np
import pytest

from deepmf_sumo.planners import idm
from deepmf_sumo.scene import Plan
from deepmf_sumo.scene.geometry import polylines
from deepmf_sumo.sumo.network import sumo_tools
from deepmf_sumo.sumo.network.sumo_road import road_of_net
from deepmf_sumo.sumo.simulation import network_case, simulate
from deepmf_sumo.sumo.simulation.on_lane import OwnWay

pytestmark = pytest.mark.sumo

CONFIG = (
    '<configuration><input><net-file value="a.net.xml"/><route-files value="a.rou.xml"/></input>'
    "</configuration>"
)


STOPS_IN = 25


class Stops:
    """The opponent brakes along its lanes, to a stop within a few seconds."""

    period_steps = None

    def __init__(self, begin, edge):
        self.begin, self.edge = begin, edge

    def reset(self, view, rng):
        return ("ahead",)

    def plan(self, view):
        line = np.concatenate([view.road.lanes[one].centre_m for one in self._way(view.road)])
        line = line[np.r_[True, np.hypot(*np.diff(line, axis=0).T) > 1e-6]]
        row = view.history.row("ahead")
        here, speed = view.history.position_m[row, -1], float(view.history.speed_mps[row, -1])
        speeds = speed * np.clip(1 - np.arange(1, 81) / STOPS_IN, 0, None)
        begin_m = float(polylines.project(line, here).along_m)
        place, heading = polylines.points_at(line, begin_m + np.cumsum(speeds) * 0.1)
        plan = Plan(
            agent_id="ahead", first_step=view.step + 1, position_m=place, heading_rad=heading,
            speed_mps=speeds,
        )  # fmt: skip
        return {"ahead": plan}

    def _way(self, road):
        ways = [[self.begin]]
        while not ways[0][-1].startswith(self.edge):
            lanes = ways.pop(0)
            ways += [[*lanes, after] for after in road.lanes[lanes[-1]].next]
        return ways[0]


def built(folder, nodes, edges, demand, *options):
    (folder / "a.nod.xml").write_text(f"<nodes>{nodes}</nodes>")
    (folder / "a.edg.xml").write_text(f"<edges>{edges}</edges>")
    (folder / "a.rou.xml").write_text(f"<routes>{demand}</routes>")
    (folder / "a.sumocfg").write_text(CONFIG)
    sumo_tools.run(
        "netconvert", "-n", str(folder / "a.nod.xml"), "-e", str(folder / "a.edg.xml"),
        "-o", str(folder / "a.net.xml"), *options,
    )  # fmt: skip
    return folder / "a.sumocfg"


def vehicle(name, edges, at_m):
    return (
        f'<vehicle id="{name}" depart="0" departPos="{at_m}" departSpeed="8">'
        f'<route edges="{edges}"/></vehicle>'
    )


def stops_behind(config, begin, edge):
    case = network_case(config, 2.0, "av", 80)
    driver = idm.build(idm.Settings(perception="lane"))
    rollout = simulate(case, driver, Stops(begin, edge), rng=np.random.default_rng(0))
    speed = rollout.tracks.speed_mps[rollout.tracks.row("av")]
    return not rollout.contacts and bool(speed[-1] < 1.0)


@pytest.mark.parametrize("direction", [1, -1])
def test_in_a_street_whose_lanes_lie_on_each_other(tmp_path, direction):
    nodes = '<node id="w" x="-200" y="0"/><node id="a" x="0" y="0"/><node id="e" x="200" y="0"/>'
    edges = "".join(
        f'<edge id="{one}" from="{one[0]}" to="{one[1]}" speed="9" spreadType="center"/>'
        for one in ("wa", "aw", "ae", "ea")
    )
    way = "wa ae" if direction == 1 else "ea aw"
    demand = vehicle("ahead", way, 60) + vehicle("av", way, 30)
    config = built(tmp_path, nodes, edges, demand, "--geometry.avoid-overlap", "false")
    assert stops_behind(config, f"{way[:2]}_0", way[3:])


def test_its_way_over_a_junction_is_no_other_stream_s(tmp_path):
    places = {"w": (-150, 0), "m": (0, 0), "e": (150, 0), "n": (0, 150), "s": (0, -150)}
    nodes = "".join(
        f'<node id="{name}" x="{x}" y="{y}" type="priority"/>' for name, (x, y) in places.items()
    )
    edges = "".join(
        f'<edge id="{start}{to}" from="{start}" to="{to}" speed="9" priority="{prio}"/>'
        for arm, prio in (("w", 3), ("e", 3), ("n", 1), ("s", 1))
        for start, to in ((arm, "m"), ("m", arm))
    )
    config = built(tmp_path, nodes, edges, vehicle("ahead", "wm ms", 120))
    lanes = road_of_net(tmp_path / "a.net.xml").lanes
    inner = {(lanes[one].previous[0][:2], lanes[one].next[0][:2]): lanes[one].centre_m
             for one in lanes if one.startswith(":") and lanes[one].next[0][0] != ":"
             and lanes[one].previous[0][0] != ":"}  # fmt: skip

    def middle(line, aside_m=0.0, turn=0.0):
        at = polylines.arc_lengths(line)[-1] / 2
        place, heading = polylines.points_at(line, np.array([at]))
        normal = np.array([-np.sin(heading[0]), np.cos(heading[0])])
        return place[0] + aside_m * normal, float(heading[0]) + turn

    libsumo.start(["sumo", "-c", str(config), "--no-step-log"])
    try:
        libsumo.simulationStep()
        way, own = OwnWay(libsumo), inner["wm", "ms"]
        assert way.has("ahead", *middle(own))
        assert way.has("ahead", *middle(own, aside_m=2.5)), "nothing marks it"
        assert not way.has("ahead", *middle(own, turn=np.pi))
        assert not way.has("ahead", *middle(inner["nm", "ms"]))
        assert not way.has("ahead", *middle(inner["em", "mn"]))
        before, after = lanes["wm_0"].centre_m, lanes["ms_0"].centre_m
        assert way.has("ahead", *middle(before))
        assert way.has("ahead", *middle(after))
        assert way.has("ahead", *middle(before, aside_m=1.5))
        assert not way.has("ahead", *middle(before, aside_m=1.7))
        assert not way.has("ahead", *middle(lanes["mw_0"].centre_m))
    finally:
        libsumo.close()
