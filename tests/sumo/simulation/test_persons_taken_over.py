"""A policy moves persons of SUMO: where they are, who sees them, and how SUMO walks them on."""

import libsumo
import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.attacks import trajectory
from deepmf_sumo.errors import RunError
from deepmf_sumo.planners import sumo
from deepmf_sumo.scene import HISTORY_STEPS, Driver
from deepmf_sumo.sumo.network.footways import footways_of
from deepmf_sumo.sumo.simulation import network_case, simulate
from deepmf_sumo.sumo.simulation.frame import Pose
from deepmf_sumo.sumo.simulation.vehicle_control import SumoOwner, Takeover

from tests.support import pavements

NOW = HISTORY_STEPS - 1
LANE_X_M, FOOTWAY_X_M = 201.6, 204.2
START = ["sumo", "--step-length", "0.1", "--no-warnings", "--no-step-log"]
START += ["--collision.action", "none"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory, starts_sumo):
    return tmp_path_factory.mktemp("pavements")


def way(*corners, speed=1.4, stays_s=0.0):
    """Rows of a trajectory along corners, (2,) each, with a stay at the end."""
    points = np.array(corners, float)
    lengths = np.hypot(*np.diff(points, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    at = np.arange(1, int(along[-1] / speed / 0.1) + 1) * speed * 0.1
    part = np.clip(np.searchsorted(along, at, side="right") - 1, 0, len(lengths) - 1)
    heading = np.arctan2(*np.diff(points, axis=0)[part].T[::-1])
    x, y = (np.interp(at, along, one) for one in points.T)
    rows = np.column_stack([x, y, heading])
    return np.concatenate([rows, np.repeat(rows[-1:], round(stays_s * 10), axis=0)]).tolist()


def run(config, agent, poses, *, start_s=2.0, steps=150):
    chosen = {"agent": agent, "poses": poses}
    policy = trajectory.TrajectoryPolicy(plugins.settings("adversaries", "trajectory", chosen))
    case = network_case(config, start_s, "av", steps, seed=0)
    planner = sumo.build(sumo.Settings())
    return simulate(case, planner, policy, rng=np.random.default_rng(0))


def kinds(rollout, agent="person p"):
    return [event.kind for event in rollout.events if event.agent_id == agent]


@pytest.fixture(scope="module")
def stepped_out(folder):
    """It walks from the footway to the middle of the lane, and stands there for 6 s."""
    demand = pavements.car("av", "sm mn", 1, 10), pavements.walker("p", "sm mn", 118)
    out = way((204.8, 120.5), (LANE_X_M, 121.0), stays_s=6.0)
    return run(pavements.build(folder, *demand), "p", out, steps=200)


def test_a_person_walks_where_the_plan_has_it_and_faces_as_planned(stepped_out):
    tracks, (plan,) = stepped_out.tracks, stepped_out.plans
    row, steps = tracks.row("person p"), slice(NOW + 1, NOW + 1 + len(plan.position_m))
    assert (stepped_out.driver[row, steps] == Driver.POLICY).all()
    assert tracks.position_m[row, steps] == pytest.approx(plan.position_m, abs=1e-9)
    assert tracks.heading_rad[row, steps] == pytest.approx(plan.heading_rad, abs=1e-9)
    assert tracks.speed_mps[row, steps] == pytest.approx(plan.speed_mps, abs=1e-9)


def test_sumos_car_brakes_for_a_person_on_its_lane(stepped_out):
    tracks, av = stepped_out.tracks, stepped_out.tracks.row("av")
    standing = slice(NOW + 60, NOW + 75)
    assert tracks.speed_mps[av, NOW] > 10.0
    assert tracks.speed_mps[av, standing].min() < 4.0
    assert not stepped_out.contacts


def test_afterwards_it_goes_to_the_footway_and_walks_on_as_before(stepped_out):
    tracks, row = stepped_out.tracks, stepped_out.tracks.row("person p")
    assert kinds(stepped_out)[-2:] == ["plan_ended", "handed_back"]
    assert stepped_out.driver[row, -1] == Driver.SUMO
    x, y = tracks.position_m[row].T
    assert 203.2 < x[-1] < 205.2
    walked = np.diff(y[-20:])
    assert walked.min() > 0.05, "north, to its destination"
    back = slice(NOW + 100, NOW + 120)
    assert np.hypot(np.diff(x[back]), np.diff(y[back])).max() < 0.2
    assert tracks.valid[row].all()


def driven_by_hand(folder, demand, poses, agent="person p", keep=None, steps=250):
    """SUMO alone, with a person on poses: speeds of the car, and positions of the person."""
    pavements.build(folder, *demand)
    net = folder / "pavements.net.xml"
    rou = folder / "pavements.rou.xml"
    libsumo.start([*START, "-n", str(net), "-r", str(rou)])
    speed, off = [], []
    try:
        takeover = Takeover(libsumo, [], footways=lambda: footways_of(net))
        for step in range(steps):
            x, y, heading = poses[min(step, len(poses) - 1)]
            pose = Pose(x_m=x, y_m=y, heading_rad=heading, speed_mps=1.4)
            there = "p" in libsumo.person.getIDList()
            if there and keep is None:
                takeover.place(step, agent, pose, 0.0)
            elif there:
                angle = np.degrees(np.pi / 2 - heading)
                libsumo.person.moveToXY("p", "", x, y, angle, keep, 5.0)
            libsumo.simulationStep()
            if there:
                off.append(np.hypot(*(np.array(libsumo.person.getPosition("p")) - (x, y))))
            if "car" in libsumo.vehicle.getIDList():
                at = np.array(libsumo.vehicle.getPosition("car"))
                speed.append((libsumo.vehicle.getSpeed("car"), np.hypot(*(at - (x, y)))))
    finally:
        libsumo.close()
    return np.array(speed), np.array(off)


MID_BLOCK = [(LANE_X_M, 120.0, np.pi)]
ON_CROSSING = [(LANE_X_M, 190.6, np.pi / 2)]


@pytest.mark.parametrize("where", [MID_BLOCK, ON_CROSSING], ids=["mid-block", "crossing"])
@pytest.mark.parametrize("edges", ["sm mn", "sm mw"])
def test_a_car_stops_for_who_is_taken_over(folder, where, edges):
    demand = pavements.car("car", edges, 1, 40), pavements.walker("p", "sm mn", 118)
    speed, off = driven_by_hand(folder, demand, where)
    assert speed[:, 0].min() < 0.5
    assert 1.0 < speed[:, 1].min() < 5.0, "it stands before the person"
    assert off.max() < 0.01


@pytest.mark.parametrize(("keep", "where"), [(2, MID_BLOCK), (6, ON_CROSSING)])
def test_with_keep_route_alone_sumos_cars_hit_it(folder, keep, where):
    """Why a person is given a lane: keepRoute alone hides it from cars, here or there."""
    demand = pavements.car("car", "sm mn", 1, 40), pavements.walker("p", "wm me", 180)
    speed, off = driven_by_hand(folder, demand, where, keep=keep)
    assert speed[:, 1].min() < 1.0, "its front is where the person is"
    assert off.max() < 0.01


PLACES = {
    "lane": [(150.0, 195.2)],
    "other side": [(150.0, 208.9)],
    "walking area": [(195.0, 189.6)],
    "crossing": [(195.3, 192.0), (195.3, 200.0)],
    "junction": [(200.0, 200.0)],
    "another arm": [(195.5, 189.0), (195.5, 170.0)],
    "beyond its destination": [(205.0, 190.4), (265.0, 191.1)],
    "off the road": [(150.0, 170.0)],
}


@pytest.mark.parametrize("corners", PLACES.values(), ids=PLACES)
def test_from_anywhere_it_gets_to_its_destination_and_nothing_jumps(folder, corners):
    pavements.build(folder, pavements.walker("p", "wm me", 160.0))
    net = folder / "pavements.net.xml"
    libsumo.start([*START, "-n", str(net), "-r", str(folder / "pavements.rou.xml")])
    try:
        events = []
        takeover = Takeover(libsumo, events, leaves=True, footways=lambda: footways_of(net))
        owner = SumoOwner(takeover, lambda _: None)
        owner.clear = lambda *_: True
        libsumo.simulationStep(1.0)
        before = libsumo.person.getEdges("p")
        at = libsumo.person.getPosition("p")
        for x, y, heading in way(at, *corners):
            pose = Pose(x_m=x, y_m=y, heading_rad=heading, speed_mps=1.4)
            takeover.place(1, "person p", pose, 0.0)
            libsumo.simulationStep()
            takeover.after_step()
        walk = owner.walk("person p", pose)
        moved = [libsumo.person.getPosition("p")]
        while not owner.takes("person p", 1, pose):
            pose = walk.next(lambda _: True)
            takeover.place(1, "person p", pose, 0.0)
            libsumo.simulationStep()
            takeover.after_step()
            moved.append(libsumo.person.getPosition("p"))
        takeover.hand_back(1, "person p")
        libsumo.simulationStep()
        moved.append(libsumo.person.getPosition("p"))
        assert libsumo.person.getEdges("p")[-1] == before[-1]
        for _ in range(20):
            libsumo.simulationStep()
            if "p" in libsumo.person.getIDList():
                moved.append(libsumo.person.getPosition("p"))
        way_m = np.hypot(*np.diff(moved, axis=0).T)
        assert way_m[:-20].max() < 0.2
        assert way_m[-20:].max() < 0.45, "so far SUMO moves its persons in a step at corners"
        libsumo.simulationStep(libsumo.simulation.getTime() + 250.0)
        assert libsumo.person.getIDCount() == 0, "it has arrived"
        assert [event.kind for event in events] == ["handed_back"]
    finally:
        libsumo.close()


@pytest.mark.parametrize("along_m", [40.0, 150.0])
def test_a_way_that_turns_back_on_the_same_street_does_not_jump(folder, along_m):
    """SUMO could begin such a walk in both directions, and prepares the other one."""
    pavements.build(folder, pavements.walker("p", "wm mw", along_m, arrival=100.0))
    net = folder / "pavements.net.xml"
    libsumo.start([*START, "-n", str(net), "-r", str(folder / "pavements.rou.xml")])
    try:
        takeover = Takeover(libsumo, [], footways=lambda: footways_of(net))
        libsumo.simulationStep(1.0)
        at = libsumo.person.getPosition("p")
        for x, y, heading in way(at, (at[0], 195.2), (at[0], 191.1)):
            pose = Pose(x_m=x, y_m=y, heading_rad=heading, speed_mps=1.4)
            takeover.place(1, "person p", pose, 0.0)
            libsumo.simulationStep()
            takeover.after_step()
        takeover.hand_back(1, "person p")
        moved = []
        libsumo.simulationStep()
        while "p" in libsumo.person.getIDList() and len(moved) < 3500:
            moved.append(libsumo.person.getPosition("p"))
            libsumo.simulationStep()
    finally:
        libsumo.close()
    assert len(moved) < 3500, "it has arrived"
    assert np.hypot(*np.diff(moved, axis=0).T).max() < 2.5


RIDE = (
    '<person id="p" type="walker" depart="0" departPos="110"><ride from="wm" to="me" lines="bus"/>'
    "</person>"
)
STAY = (
    '<person id="p" type="walker" depart="0" departPos="110"><stop lane="wm_0" endPos="120" '
    'duration="500"/><walk from="wm" to="me"/></person>'
)
AV = pavements.car("av", "wm me", 2, 40)


def test_who_waits_for_a_ride_is_not_taken_and_the_message_says_why(folder):
    with pytest.raises(RunError) as refused:
        run(pavements.build(folder, AV, RIDE), "p", way((110, 191.1), (110, 195)))
    message = str(refused.value)
    assert "person p" in message
    assert "waits for a vehicle to ride in" in message


def test_who_waits_beside_the_road_is_taken_and_returns_to_where_it_waited(folder):
    out = way((110.0, 188.1), (112.0, 194.0))
    rollout = run(pavements.build(folder, AV, STAY), "p", out, steps=120)
    assert kinds(rollout) == ["waiting_ended", "plan_ended", "handed_back"]
    row = rollout.tracks.row("person p")
    assert rollout.tracks.valid[row].all()
    assert rollout.tracks.position_m[row, -1, 1] < 192.2


ACCESS = """<additional><busStop id="stop" lane="wm_2" startPos="100" endPos="130">
<access lane="mw_0" pos="80" length="20"/></busStop></additional>"""
INTO_A_STOP = (
    '<person id="p" type="walker" depart="0" departPos="20"><walk from="mw" busStop="stop"/>'
    '<stop busStop="stop" duration="9"/></person>'
)
ALONG = pavements.walker("p", "mw", 20.0, arrival=80.0)


@pytest.mark.parametrize(
    ("walk", "refused"), [(INTO_A_STOP, "access of the stop 'stop'"), (ALONG, "")]
)
def test_who_walks_to_an_access_of_a_stop_is_not_taken(tmp_path, starts_sumo, walk, refused):
    """SUMO took it for one that has come there as soon as its way was changed."""
    pavements.build(tmp_path, walk)
    (tmp_path / "pavements.add.xml").write_text(ACCESS)
    net = tmp_path / "pavements.net.xml"
    more = ["-r", str(tmp_path / "pavements.rou.xml"), "-a", str(tmp_path / "pavements.add.xml")]
    libsumo.start([*START, "-n", str(net), *more])
    try:
        events = []
        takeover = Takeover(libsumo, events, leaves=True, footways=lambda: footways_of(net))
        libsumo.simulationStep(1.0)
        assert refused in takeover.persons.refusal("person p")
        for x, y, heading in way(libsumo.person.getPosition("p"), (175.0, 205.0), (175.0, 208.9)):
            pose = Pose(x_m=x, y_m=y, heading_rad=heading, speed_mps=1.4)
            takeover.place(1, "person p", pose, 0.0)
            libsumo.simulationStep()
            takeover.after_step()
        takeover.hand_back(1, "person p")
        libsumo.simulationStep()
    finally:
        libsumo.close()
    assert [event.kind for event in events] == [("not_taken" if refused else "handed_back")]


@pytest.mark.parametrize("model", ["jupedsim", "nonInteracting"])
def test_models_of_pedestrians_that_ignore_clients_are_named(folder, model):
    config = pavements.build(folder, AV, pavements.walker("p", "wm me", 118))
    text = config.read_text("utf-8").replace(
        "</input>", f'</input><pedestrian><pedestrian.model value="{model}"/></pedestrian>'
    )
    config.write_text(text, "utf-8")
    with pytest.raises(RunError, match=f"the model {model}, which ignores where a client puts"):
        run(config, "p", way((118, 191.1), (118, 195)))


@pytest.mark.jumps("SUMO puts a person that arrives at a stop beside it")
def test_who_boards_during_an_attack_is_gone(folder):
    bus = (
        '<vehicle id="bus" depart="0" departLane="2" departPos="60"><route edges="wm me"/>'
        '<stop busStop="stop" duration="20"/></vehicle>'
    )
    person = (
        '<person id="p" type="walker" depart="0" departPos="117"><walk from="wm" busStop="stop"/>'
        '<ride from="wm" to="me" lines="bus"/></person>'
    )
    config = pavements.build(folder, bus, person, pavements.car("av", "wm me", 3, 40))

    class Late(trajectory.TrajectoryPolicy):
        """It attacks, but its plans begin after the person has boarded."""

        period_steps = 10

        def plan(self, view):
            return super().plan(view) if view.step > NOW + 60 else {}

    settings = {"agent": "p", "poses": way((120, 191), (120, 195)), "first_step": NOW + 61}
    policy = Late(plugins.settings("adversaries", "trajectory", settings))
    case = network_case(config, 1.0, "av", 100, seed=0)
    planner = sumo.build(sumo.Settings())
    rollout = simulate(case, planner, policy, rng=np.random.default_rng(0))
    row = rollout.tracks.row("person p")
    assert not rollout.tracks.valid[row, -1]
    assert rollout.opponent_id == "person p"


def test_equal_runs_are_equal_to_the_last_bit(folder):
    demand = pavements.car("av", "sm mn", 1, 10), pavements.walker("p", "sm mn", 118)
    config = pavements.build(folder, *demand)
    out = way((204.8, 120.5), (LANE_X_M, 121.0))
    one, other = (run(config, "p", out) for _ in range(2))
    assert one.tracks.position_m.tobytes() == other.tracks.position_m.tobytes()
