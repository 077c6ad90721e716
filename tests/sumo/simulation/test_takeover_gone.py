"""A driven vehicle that SUMO takes off the road, and brings back; and where the network ends."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.attacks import trajectory
from deepmf_sumo.planners.idm import Settings, build
from deepmf_sumo.scene import Driver
from deepmf_sumo.sumo.simulation import network_case, simulate
from deepmf_sumo.sumo.simulation.frame import Frame, Pose
from deepmf_sumo.sumo.simulation.occupancy import Occupancy
from deepmf_sumo.sumo.simulation.vehicle_control import NetworkEnds, Takeover

NET = Path(__file__).parents[3] / "sumo_nets" / "highway" / "highway.net.xml"
ROUTES = """<routes><route id="after" edges="after"/><route id="before" edges="before"/>
<vehicle id="ov" depart="0" departPos="560" departSpeed="20" route="after"/>
<vehicle id="av" depart="0" departPos="100" departSpeed="10" route="before"/></routes>"""
CONFIG = """<configuration><input><net-file value="{}"/>
<route-files value="ends.rou.xml"/></input></configuration>"""
END_X_M = 2200.0  # of the motorway, which leads east there


def sumo(there, options=None, classes=None):
    vehicle = SimpleNamespace(
        getIDList=lambda: tuple(there),
        getRoute=lambda agent: ("ab",),
        getRouteIndex=lambda agent: -1,
        getTypeID=lambda agent: "car",
        getLaneID=lambda agent: "",
        getLanePosition=lambda agent: 50.0,
        getStops=lambda agent, limit=0: (),
        moveToXY=lambda *_: None,
        setSpeed=lambda *_: None,
        setSpeedMode=lambda *_: None,
        setPreviousSpeed=lambda *_: None,
        getLateralSpeed=lambda _: 0.0,
        getVehicleClass=lambda agent: (classes or {}).get(agent, "passenger"),
        setVehicleClass=lambda agent, name: classes.update({agent: name}),
    )
    simulation = SimpleNamespace(getOption=lambda name: (options or {}).get(name, "0"))
    return SimpleNamespace(vehicle=vehicle, simulation=simulation)


def placed(there, events):
    takeover = Takeover(sumo(there), events)
    takeover.place(1, "ov", Pose(x_m=0, y_m=0, heading_rad=0, speed_mps=5), 4.5)
    takeover.after_step()
    return takeover


def test_one_that_comes_back_is_not_where_it_was_put():
    there = ["ov"]
    takeover = placed(there, [])
    assert set(takeover.placed()) == {"ov"}
    there.clear()
    takeover.after_step()
    there.append("ov")
    takeover.after_step()
    assert takeover.placed() == {}


def test_one_that_sumo_has_taken_off_the_road_is_not_moved():
    events, there = [], ["ov"]
    takeover = placed(there, events)
    there.clear()
    takeover.hand_back(2, "ov")
    assert takeover.placed() == {}
    (event,) = events
    assert (event.kind, event.detail) == ("opponent_gone", "left the traffic")


def test_one_that_was_put_off_its_route_is_sent_to_its_destination():
    api, route, sent = sumo(["ov"]), ["ab", "bc"], []
    api.vehicle.getRoute = lambda _: tuple(route)
    api.vehicle.getLaneID = lambda _: "bd_0"
    api.vehicle.changeTarget = lambda *of: sent.append(of)
    api.lane = SimpleNamespace(getAllowed=lambda _: (), getDisallowed=lambda _: ())
    takeover = Takeover(api, [])
    takeover.place(1, "ov", Pose(x_m=0, y_m=0, heading_rad=0, speed_mps=5), 4.5)
    route[1] = "bd"  # SUMO makes it the route of where it was put
    takeover.hand_back(2, "ov")
    assert sent == [("ov", "bc")]


def test_one_that_comes_back_has_its_own_class():
    there, classes = ["ov"], {"ov": "taxi"}
    takeover = Takeover(sumo(there, {"lanechange.duration": "3"}, classes), [])
    takeover.place(1, "ov", Pose(x_m=0, y_m=0, heading_rad=0, speed_mps=5), 4.5)
    takeover.after_step()
    assert classes == {"ov": "ignoring"}
    there.clear()
    takeover.after_step()
    there.append("ov")
    takeover.after_step()
    assert classes == {"ov": "taxi"}


@pytest.mark.sumo
def test_the_opponent_leaves_where_the_network_ends(tmp_path, starts_sumo):
    (tmp_path / "ends.rou.xml").write_text(ROUTES)
    config = tmp_path / "ends.sumocfg"
    config.write_text(CONFIG.format(NET))

    case = network_case(config, 2.0, "av", 79)
    poses = [[2103.0 + 2.0 * step, -8.0, 0.0] for step in range(60)]
    settings = plugins.settings("adversaries", "trajectory", {"agent": "ov", "poses": poses})
    policy = trajectory.TrajectoryPolicy(settings)
    rollout = simulate(case, build(Settings()), policy, rng=np.random.default_rng(0))
    tracks, row = rollout.tracks, rollout.tracks.row("ov")
    last = int(np.flatnonzero(tracks.valid[row])[-1])
    front_x_m = tracks.position_m[row, last, 0] + tracks.size_m[row, 0] / 2
    assert END_X_M - 2.0 <= front_x_m <= END_X_M + 0.1
    (event,) = (one for one in rollout.events if one.kind == "opponent_gone")
    assert (event.step, event.detail) == (last + 1, "it left where the network ends")


@pytest.mark.parametrize(
    ("links", "heading_rad", "front_x_m", "passed"),
    [
        ((), 0.0, 100.0, False),
        ((), 0.0, 100.2, True),
        (("t",), 0.0, 102.0, False),
        (("t",), 0.0, 103.0, True),
        (("t",), 1.2, 103.0, False),  # it turns back
        (("t", "s"), 0.0, 103.0, False),  # the road goes on
    ],
)
def test_a_network_ends_where_no_lane_leads_on_but_back(links, heading_rad, front_x_m, passed):
    lanes = ["end_0"]
    ends = NetworkEnds(
        SimpleNamespace(
            vehicle=SimpleNamespace(getLaneID=lambda _: lanes[-1]),
            edge=SimpleNamespace(getLaneNumber=lambda _: 1),
            lane=SimpleNamespace(
                getLinks=lambda _: [(*6 * ("",), direction, 1.0) for direction in links],
                getShape=lambda _: [(0.0, 0.0), (100.0, 0.0)],
            ),
        )
    )
    half = 2.0 * np.array([np.cos(heading_rad), np.sin(heading_rad)])
    x, y = np.array([front_x_m, 0.0]) - half
    assert not ends.passed("ov", Pose(x_m=90.0, y_m=0.0, heading_rad=0.0, speed_mps=5), 4.0)
    lanes.append("")  # SUMO takes it on no lane any more
    pose = Pose(x_m=float(x), y_m=float(y), heading_rad=heading_rad, speed_mps=5)
    assert ends.passed("ov", pose, 4.0) is passed


@pytest.mark.parametrize("leaves", [True, False])
def test_only_a_vehicle_that_may_be_removed_leaves_at_the_end(leaves):
    events, there = [], ["ov"]
    api = sumo(there)
    api.vehicle.getLaneID = lambda _: "end_0"
    api.vehicle.remove = lambda agent, reason: there.remove(agent)
    api.edge = SimpleNamespace(getLaneNumber=lambda _: 1)
    api.lane = SimpleNamespace(getLinks=lambda _: (), getShape=lambda _: [(0.0, 0.0), (100.0, 0.0)])
    takeover = Takeover(api, events, leaves=leaves)
    takeover.place(1, "ov", Pose(x_m=110, y_m=0, heading_rad=0, speed_mps=5), 4.5)
    assert there == ([] if leaves else ["ov"])
    assert [event.kind for event in events] == ["opponent_gone"] * leaves


@pytest.mark.parametrize(
    ("changed", "drivable"),
    [
        ({}, True),
        ({"heading": 0.2}, False),
        ({"heading": np.pi}, False),
        ({"left": 0.3}, False),
        ({"left": 0.3, "sublane": "0.8"}, True),
        ({"lane": ""}, False),
        ({"class": "bus"}, False),
        ({"other": (3.0, 0.0)}, False),
        ({"other": (30.0, 0.0)}, True),
        ({"av": (3.0, 0.0)}, True),  # SUMO separates the two
    ],
)
def test_from_which_poses_sumo_drives_on(changed, drivable):
    api = sumo(["ov"], classes={"ov": changed.get("class", "passenger")})
    options = {"lateral-resolution": changed.get("sublane", "0")}
    api.simulation.getOption = lambda name: options.get(name, "0")
    api.lane = SimpleNamespace(
        getShape=lambda _: [(-50.0, 0.0), (50.0, 0.0)],
        getAllowed=lambda _: (),
        getDisallowed=lambda _: ("bus",),
    )
    takeover = Takeover(api, [])
    pose = Pose(x_m=0, y_m=0, heading_rad=changed.get("heading", 0.0), speed_mps=5)
    takeover.place(1, "ov", pose, 4.5)
    api.vehicle.getLaneID = lambda _: changed.get("lane", "ab_0")
    api.vehicle.getLateralLanePosition = lambda _: changed.get("left", 0.0)
    agents = {
        "ov": (0.0, 0.0),
        **{name: changed[name] for name in ("other", "av") if name in changed},
    }
    frame = Frame.of_poses(
        {
            name: (Pose(x_m=x, y_m=y, heading_rad=0.0, speed_mps=0.0), Driver.SUMO)
            for name, (x, y) in agents.items()
        }
    )
    occupancy = Occupancy(frame=frame, size_m=np.tile([4.5, 1.8], (len(agents), 1)), av_id="av")
    assert takeover.drivable("ov", occupancy) is drivable
