"""Vehicles that bend lie along the way that their front came."""

import os
import subprocess
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import libsumo
import numpy as np
import pytest
import shapely
import sumo

from deepmf_sumo.exporters import fcd
from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.judge.metrics.traffic_conflicts import ConflictLimits, find
from deepmf_sumo.live.connection import shared
from deepmf_sumo.live.observer import LiveObserver
from deepmf_sumo.planners import idm
from deepmf_sumo.roadcheck.conflicts import observation
from deepmf_sumo.roadcheck.motion_survey import Survey, survey
from deepmf_sumo.scene.geometry import boxes
from deepmf_sumo.study.moments.moment import opponents
from deepmf_sumo.sumo.simulation import long_vehicles, network_case, simulate
from deepmf_sumo.sumo.simulation.av import RouteAhead
from deepmf_sumo.sumo.simulation.road_users import TrafficReader
from deepmf_sumo.sumo.simulation.traffic_survey import TrafficSurvey, survey_traffic

NODES = """<nodes><node id="w" x="-200" y="0"/><node id="mid" x="0" y="0" type="priority"/>
<node id="n" x="0" y="200"/><node id="e" x="200" y="0"/></nodes>"""
EDGES = """<edges><edge id="in" from="w" to="mid" numLanes="2" speed="13.9"/>
<edge id="up" from="mid" to="n" speed="13.9"/>
<edge id="on" from="mid" to="e" speed="13.9"/></edges>"""
TYPES = """<vType id="tram" vClass="tram" length="42" maxSpeed="8"/>
<vType id="three" vClass="tram" length="42" maxSpeed="8" carriageLength="14"/>
<vType id="bendy" vClass="bus" guiShape="bus/flexible" length="18"/>
<vType id="said" vClass="bus" length="18"><param key="carriageLength" value="5"/></vType>
<vType id="bus" vClass="bus"/><vType id="trailer" vClass="trailer"/>
<vType id="semi" vClass="truck" guiShape="truck/semitrailer" length="16"/>
<vType id="train" vClass="rail" length="135"/>"""
NUMBERS = {"tram": 6, "three": 3, "bendy": 2, "said": 3, "bus": 1, "trailer": 2, "semi": 2}
TRAMS = """<vehicle id="t" type="tram" depart="0" departPos="50" departLane="1">
<route edges="in up"/></vehicle>
<flow id="queue" depart="0" begin="0" period="3" number="15" departPos="150" departLane="0"
 departSpeed="5"><route edges="in on"/><stop lane="in_0" endPos="195" duration="60"/></flow>"""
CONFIG = """<configuration><input><net-file value="long.net.xml"/>
<route-files value="{}.rou.xml"/></input></configuration>"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory, starts_sumo) -> Path:
    folder = tmp_path_factory.mktemp("long")
    (folder / "l.nod.xml").write_text(NODES)
    (folder / "l.edg.xml").write_text(EDGES)
    command = [Path(sumo.SUMO_HOME) / "bin" / "netconvert", "-o", "long.net.xml"]
    command += ["-n", "l.nod.xml", "-e", "l.edg.xml"]
    environment = {**os.environ, "SUMO_HOME": str(sumo.SUMO_HOME)}
    subprocess.run(command, cwd=folder, check=True, capture_output=True, env=environment)
    return folder


def configured(folder, name, vehicles):
    (folder / f"{name}.rou.xml").write_text(f"<routes>{TYPES}{vehicles}</routes>")
    (folder / f"{name}.sumocfg").write_text(CONFIG.format(name))
    return folder / f"{name}.sumocfg"


@pytest.fixture
def started():
    def start(config):
        command = ["sumo", "-c", str(config), "--step-length", "0.1", "--no-warnings"]
        libsumo.start([*command, "--collision.action", "none"])
        return libsumo

    yield start
    libsumo.close()


@pytest.fixture(scope="module")
def trams(folder):
    return configured(folder, "trams", TRAMS)


def ends(reader, frame, agent):
    """Middles of the front and the rear of a box."""
    row = frame.ids.index(agent)
    half = reader.body(agent).size_m[0] / 2
    heading = frame.heading_rad[row]
    ahead = half * np.array([np.cos(heading), np.sin(heading)])
    return frame.position_m[row] + ahead, frame.position_m[row] - ahead


def test_a_tram_lies_on_the_way_of_its_front(trams, started):
    api = started(trams)
    reader, way, farthest, stiff = TrafficReader(api), [], 0.0, 0.0
    for step in range(330):
        api.simulationStep()
        frame = reader.read()
        way.append(api.vehicle.getPosition("t"))
        if step < 100:
            continue
        came = shapely.LineString(way)
        parts = [one for one in frame.ids if one.partition(" part ")[0] == "t"]
        assert parts == ["t", *(f"t part {number}" for number in range(2, 7))]
        middles = [ends(reader, frame, one) for one in parts]
        for point in (one for pair in middles for one in pair):
            farthest = max(farthest, came.distance(shapely.Point(point)))
        joints = [np.hypot(*(a[1] - b[0])) for a, b in pairwise(middles)]
        assert max(joints) < 0.8  # chords of a sharp bend
        angle = np.radians(90 - api.vehicle.getAngle("t"))
        rear = np.array(way[-1]) - 42 * np.array([np.cos(angle), np.sin(angle)])
        stiff = max(stiff, came.distance(shapely.Point(rear)))
    assert way[-1][1] > 60.0  # it has turned
    assert farthest < 0.6
    assert stiff > 5.0  # what one box would do


def test_its_boxes_touch_no_car_beside_it(trams, started):
    api = started(trams)
    reader, touched, near = TrafficReader(api), [], 0
    for _ in range(330):
        api.simulationStep()
        touched += api.simulation.getCollisions()
        frame = reader.read()
        size = reader.bodies.sizes_m(frame.ids)
        poses = frame.position_m, frame.heading_rad, size
        tram = [row for row, one in enumerate(frame.ids) if one.startswith("t")]
        cars = [row for row, one in enumerate(frame.ids) if one.startswith("queue")]
        near += len(cars)
        for row in tram:
            hit = boxes.overlap(*(one[row] for one in poses), *(one[cars] for one in poses))
            touched += np.flatnonzero(hit).tolist()
    assert near > 300
    assert touched == []


def test_conflicts_have_vehicles_and_not_parts(trams):
    seen = survey(Survey(config=trams, seed=0, until_s=33.0))
    assert "t part 6" in seen.names
    found = observation(seen, ConflictLimits())
    assert found.users == len({one.partition(" part ")[0] for one in seen.names})
    sides = {side.id for one in found.conflicts for side in (one.first, one.second)}
    assert not [one for one in sides if " part " in one]
    assert not [one for one in found.conflicts if one.first.id == one.second.id]
    everything = find(seen.motions, ConflictLimits(ttc_s=5.0)).conflicts
    whole = seen.motions.whole
    assert all(whole[one.first] != whole[one.second] for one in everything)


def test_types_say_how_many_boxes_there_are(folder, started):
    vehicles = "".join(
        f'<vehicle id="{kind}" type="{kind}" depart="0" departPos="{130 - 22 * row % 110}"'
        f' departLane="{int(row > 3)}"><route edges="in up"/></vehicle>'
        for row, kind in enumerate(NUMBERS)
    )
    api = started(configured(folder, "types", vehicles))
    reader = TrafficReader(api)
    while len(api.vehicle.getIDList()) < len(NUMBERS):
        api.simulationStep()
    states = reader.states()
    numbers = {kind: sum(one.partition(" part ")[0] == kind for one in states) for kind in NUMBERS}
    assert numbers == NUMBERS
    for kind, number in NUMBERS.items():
        parts = [one for one in states if one.partition(" part ")[0] == kind]
        length = sum(reader.body(one).size_m[0] for one in parts)
        assert length == pytest.approx(api.vehicle.getLength(kind))
        rail = kind in {"tram", "three"}
        assert {reader.body(one).kind for one in parts} == {
            "other" if rail or number > 1 else "vehicle"
        }


def test_types_of_an_included_file_say_it_too(folder, started):
    (folder / "included.add.xml").write_text(
        '<additional><vType id="far" vClass="tram" length="42" carriageLength="14"/></additional>'
    )
    (folder / "outer.rou.xml").write_text(
        '<routes><include href="included.add.xml"/><vehicle id="t" type="far" depart="0"'
        ' departPos="120" departLane="1"><route edges="in up"/></vehicle></routes>'
    )
    (folder / "outer.sumocfg").write_text(CONFIG.format("outer"))
    api = started(folder / "outer.sumocfg")
    reader = TrafficReader(api)
    while not api.vehicle.getIDList():
        api.simulationStep()
    assert set(reader.states()) == {"t", "t part 2", "t part 3"}


@pytest.mark.timeout(10)
def test_lanes_inside_a_junction_that_lead_to_each_other_are_no_way():
    """As the walking areas and crossings of a junction do."""
    links = {"a_0": ":j_w0_0", ":j_w0_0": ":j_c0_0", ":j_c0_0": ":j_w0_0"}
    lane = SimpleNamespace(getLinks=lambda one: ((links[one], 0, 0, 0, ""),))
    api = SimpleNamespace(lane=lane, edge=SimpleNamespace(getLaneNumber=lambda _: 1))
    assert long_vehicles.LongVehicles(api)._search("a", "b_0") == ()


def test_an_unknown_train_is_as_long_as_its_carriages():
    lengths = long_vehicles.divided(135.0, long_vehicles._Carriages(24.5, 16.4))
    assert (lengths[0], len(lengths), sum(lengths)) == (16.4, 6, pytest.approx(135.0))


def test_off_its_track_a_vehicle_is_straight(folder, started):
    vehicle = (
        '<vehicle id="b" type="bendy" depart="0" departPos="60"><route edges="in up"/></vehicle>'
    )
    api = started(configured(folder, "off", vehicle))
    reader = TrafficReader(api)
    api.simulationStep()
    api.vehicle.moveToXY("b", "", -1, -100.0, 20.0, 45.0, 2)
    api.simulationStep()
    states = reader.states()
    offset = np.subtract(states["b"][:2], states["b part 2"][:2])
    assert offset == pytest.approx(np.full(2, 9 / np.sqrt(2)), abs=1e-6)
    assert states["b part 2"][2] == pytest.approx(45.0)


def test_an_av_meets_a_tram_once_and_is_one_box_itself(folder):
    crossing = (
        '<vehicle id="t" type="tram" depart="0" departPos="150" departLane="1">'
        '<route edges="in up"/></vehicle>'
        '<vehicle id="av" type="bendy" depart="0" departPos="30" departLane="0">'
        '<route edges="in on"/></vehicle>'
    )
    config = configured(folder, "meet", crossing)
    case = network_case(config, 3.0, "av", 40, seed=0)
    planner = idm.build(idm.Settings())
    rollout = simulate(case, planner, None, rng=np.random.default_rng(0))
    tracks = rollout.tracks
    assert tracks.kinds[tracks.row("av")] == "vehicle"
    assert tracks.size_m[tracks.row("av"), 0] == 18.0
    assert "av part 2" not in tracks.ids
    assert "av_is_stiff" in {one.kind for one in rollout.events}
    assert {"t", "t part 6"} <= set(tracks.ids)
    for name in ("t", "t part 3"):  # a part stands for its vehicle
        only = simulate(replace(case, only=(name,)), planner, None, rng=np.random.default_rng(0))
        assert set(only.tracks.ids) == set(tracks.ids)
    assert 'id="t part 2"' in fcd._fcd(rollout, tracks.valid, ())


def test_a_live_attack_sees_the_same_boxes(trams, started):
    api = started(trams)
    reader, observer = TrafficReader(api), LiveObserver(shared(api), "queue.0", 400.0)
    for step in range(220):
        api.simulationStep()
        if step < 50:
            continue
        frame, live = reader.read(), observer.frame(observer.look(), {})
        rows = [live.ids.index(one) for one in frame.ids]
        assert set(live.ids) == set(frame.ids)
        np.testing.assert_allclose(live.position_m[rows], frame.position_m, atol=1e-9)
        np.testing.assert_allclose(live.heading_rad[rows], frame.heading_rad, atol=1e-9)


def test_who_can_attack_is_the_same_when_moments_are_chosen_and_in_an_episode(folder, started):
    types = ["DEFAULT_VEHTYPE", "bendy", "said", "bus", "semi", "trailer"]
    config = configured(folder, "mixed", "".join(
        f'<vehicle id="{one}" type="{one}" depart="{4 * at}"><route edges="in on"/></vehicle>'
        for at, one in enumerate(types)
    ))  # fmt: skip
    seen = survey_traffic(TrafficSurvey(config=config, sumo_options=(), seed=0))
    able = {seen.bodies[number].id for number in seen.vehicle[opponents(seen)]}
    api = started(config)
    reader, driven = TrafficReader(api), set()
    for _ in range(300):
        api.simulationStep()
        driven |= {one for one in reader.read().ids if reader.body(one).kind == "vehicle"}
    assert able == driven == {"DEFAULT_VEHTYPE", "bus"}


def test_a_tram_on_its_own_rails_is_replayed(folder, tmp_path):
    """Its lane is no lane of the road; what SUMO then shows is read from its own output."""
    (folder / "r.nod.xml").write_text(
        '<nodes><node id="a" x="0" y="0"/><node id="b" x="300" y="0"/>'
        '<node id="c" x="0" y="20"/><node id="d" x="300" y="20"/></nodes>'
    )
    (folder / "r.edg.xml").write_text(
        '<edges><edge id="road" from="a" to="b"/>'
        '<edge id="rail" from="c" to="d" allow="tram"/></edges>'
    )
    program = Path(sumo.SUMO_HOME) / "bin"
    command = [program / "netconvert", "-n", "r.nod.xml", "-e", "r.edg.xml", "-o", "rails.net.xml"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    vehicles = (
        '<vType id="short" vClass="tram" length="9" maxSpeed="8"/>'
        '<vehicle id="av" depart="0" departPos="40"><route edges="road"/></vehicle>'
        '<vehicle id="t" type="short" depart="0" departPos="40"><route edges="rail"/></vehicle>'
    )
    config = configured(folder, "rails", vehicles)
    config.write_text(config.read_text().replace("long.net", "rails.net"))
    case = network_case(config, 3.0, "av", 30, seed=0)
    rollout = simulate(case, idm.build(idm.Settings()), None, rng=np.random.default_rng(0))
    assert "t" in rollout.tracks.ids
    out = tmp_path / "sumo"
    fcd.write(Exportable.of(rollout, case), out, fcd.Settings())
    assert (out / fcd.REPLAY).read_text().count('id="t"') == rollout.tracks.steps
    seen = tmp_path / "seen.xml"
    replayed = [program / "sumo", "-c", out / fcd.CONFIG, "--fcd-output", seen]
    subprocess.run(replayed, check=True, capture_output=True)
    assert 'lane="rail_0"' in seen.read_text()


REVERSING = """<vehicle id="t" type="{}" depart="0" departPos="60">
<route edges="there back"/><stop lane="there_0" endPos="195" duration="3"/></vehicle>
<vehicle id="car" depart="0" departPos="20"><route edges="beside"/></vehicle>"""
LOCOMOTIVE = """<vType id="pulled" vClass="tram" length="42" carriageLength="11"
 locomotiveLength="20"/>"""


@pytest.fixture(scope="module")
def siding(tmp_path_factory, starts_sumo) -> Path:
    """A single track that ends, and a street beside it."""
    folder = tmp_path_factory.mktemp("siding")
    (folder / "l.nod.xml").write_text(
        """<nodes><node id="w" x="0" y="0"/><node id="e" x="200" y="0"/>
<node id="a" x="0" y="8"/><node id="b" x="400" y="8"/></nodes>"""
    )
    (folder / "l.edg.xml").write_text(
        """<edges><edge id="there" from="w" to="e" allow="tram" spreadType="center" speed="14"/>
<edge id="back" from="e" to="w" allow="tram" spreadType="center" speed="14"/>
<edge id="beside" from="a" to="b" speed="14"/></edges>"""
    )
    command = [Path(sumo.SUMO_HOME) / "bin" / "netconvert", "-o", "long.net.xml"]
    command += ["-n", "l.nod.xml", "-e", "l.edg.xml"]
    environment = {**os.environ, "SUMO_HOME": str(sumo.SUMO_HOME)}
    subprocess.run(command, cwd=folder, check=True, capture_output=True, env=environment)
    return folder


@pytest.mark.parametrize("kind", ["three", "pulled"])
def test_the_boxes_of_a_train_that_reverses_stay_where_they_are(siding, started, kind):
    api = started(configured(siding, "turns", LOCOMOTIVE + REVERSING.format(kind)))
    reader, before, turned = TrafficReader(api), None, False
    while "t" in api.vehicle.getIDList() or before is None:
        api.simulationStep()
        frame = reader.read()
        rows = [row for row, one in enumerate(frame.ids) if one.startswith("t")]
        if not rows:
            continue
        assert [frame.ids[row] for row in rows] == sorted(frame.ids[row] for row in rows)
        boxes_of_train = frame.position_m[rows]
        if before is not None:
            moved = np.hypot(*(boxes_of_train - before).T)
            assert moved.max() <= 0.1 * api.vehicle.getSpeed("t") + 0.3
        turned |= bool(np.cos(frame.heading_rad[rows]).max() < 0)
        before = boxes_of_train
    assert turned


def test_a_train_that_reverses_does_not_jump_in_an_episode(siding):
    config = configured(siding, "episode", REVERSING.format("three"))
    case = network_case(config, 15.0, "car", duration_steps=250)
    # tests/conftest.py looks for jumps in every rollout
    simulate(case, idm.build(idm.Settings()), None, rng=np.random.default_rng(0))


OVERTAKING = """<vType id="slow" vClass="bicycle" maxSpeed="2"/>
<vType id="eager" vClass="truck" guiShape="truck/semitrailer" length="16" lcOpposite="100"
 lcOvertakeDeltaSpeedFactor="-0.9"/><route id="east" edges="wm me"/>
<vehicle id="bike" type="slow" depart="0" departPos="60" route="east"/>
<vehicle id="t" type="eager" depart="5" departPos="{}" departSpeed="max" route="east"/>"""
ASIDE = """<vType id="left" vClass="bus" guiShape="bus/flexible" length="18" latAlignment="left"/>
<route id="east" edges="wm me"/>
<vehicle id="t" type="left" depart="0" departPos="20" departSpeed="max" route="east"/>"""


def street(folder, *options):
    (folder / "l.nod.xml").write_text(
        """<nodes><node id="w" x="0" y="0"/><node id="m" x="300" y="0"/>
<node id="e" x="500" y="150"/></nodes>"""
    )
    edges = (
        f'<edge id="{a}{b}" from="{a}" to="{b}" numLanes="1" speed="14"/>'
        for a, b in ("wm", "mw", "me", "em")
    )
    (folder / "l.edg.xml").write_text(f"<edges>{''.join(edges)}</edges>")
    command = [Path(sumo.SUMO_HOME) / "bin" / "netconvert", "-o", "long.net.xml"]
    command += ["-n", "l.nod.xml", "-e", "l.edg.xml", "--no-turnarounds", "true", *options]
    environment = {**os.environ, "SUMO_HOME": str(sumo.SUMO_HOME)}
    subprocess.run(command, cwd=folder, check=True, capture_output=True, env=environment)
    return folder


@pytest.mark.parametrize("side", [(), ("--lefthand",)], ids=["right-hand", "left-hand"])
@pytest.mark.parametrize("begins_m", [4, 30])
def test_one_that_overtakes_on_the_opposite_lane_does_not_turn_round(
    tmp_path, started, side, begins_m
):
    folder = street(tmp_path, "--opposites.guess", "true", *side)
    api = started(configured(folder, "over", OVERTAKING.format(begins_m)))
    reader, opposite = TrafficReader(api), 0
    for _ in range(300):
        api.simulationStep()
        frame = reader.read()
        if "t" not in frame.ids or api.vehicle.getPosition("t")[0] > 280.0:
            continue
        opposite += api.vehicle.getLaneID("t") == "mw_0"
        rows = [frame.ids.index(one) for one in ("t", "t part 2")]
        assert np.cos(frame.heading_rad[rows]).min() > 0.9
        (front, joint), (behind, rear) = (ends(reader, frame, one) for one in ("t", "t part 2"))
        np.testing.assert_allclose(front, api.vehicle.getPosition("t"), atol=1e-6)
        np.testing.assert_allclose(joint, behind, atol=0.3)
        np.testing.assert_allclose(np.hypot(*(front - rear)), 16.0, atol=0.3)
    assert opposite > 20


TURNING_BACK = """<vType id="long" vClass="truck" guiShape="truck/trailer" length="16.5" sigma="0"/>
<vehicle id="t" type="long" depart="0" departPos="60" departSpeed="8">
<route edges="A1B1 B1A1"/></vehicle>"""


def test_one_that_turns_back_at_a_crossing_does_not_jump(tmp_path, started):
    command = [Path(sumo.SUMO_HOME) / "bin" / "netgenerate", "-o", "long.net.xml", "--grid"]
    command += ["--grid.number", "3", "--grid.length", "120", "--default.lanenumber", "2"]
    environment = {**os.environ, "SUMO_HOME": str(sumo.SUMO_HOME)}
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, env=environment)
    api = started(configured(tmp_path, "back", TURNING_BACK))
    reader, before, edges = TrafficReader(api), None, set()
    for _ in range(250):
        api.simulationStep()
        if "t" not in api.vehicle.getIDList():
            break
        edges.add(api.vehicle.getRoadID("t"))
        frame = reader.read()
        here = frame.position_m[[frame.ids.index(one) for one in ("t", "t part 2")]]
        if before is not None:
            moved_m = np.hypot(*(here - before).T)
            assert moved_m.max() < 0.1 * api.vehicle.getSpeed("t") + 1.0
        before = here
    assert {"A1B1", "B1A1"} < edges


@pytest.mark.parametrize("side", [(), ("--lefthand",)], ids=["right-hand", "left-hand"])
def test_one_beside_the_middle_of_its_lane_is_straight(tmp_path, started, side):
    folder = street(tmp_path, *side)
    config = configured(folder, "aside", ASIDE)
    config.write_text(
        CONFIG.format("aside").replace(
            "</input>", '</input><processing><lateral-resolution value="0.4"/></processing>'
        )
    )
    api = started(config)
    reader = TrafficReader(api)
    for _ in range(150):
        api.simulationStep()
        frame = reader.read()
    assert abs(api.vehicle.getLateralLanePosition("t")) > 0.2
    front_m = api.vehicle.getPosition("t")
    assert front_m[0] < 280.0
    np.testing.assert_allclose(RouteAhead(api, "t").centre_line()[0], front_m, atol=0.01)
    for part in ("t", "t part 2"):
        ahead, behind = ends(reader, frame, part)
        np.testing.assert_allclose([ahead[1], behind[1]], front_m[1], atol=0.01)
