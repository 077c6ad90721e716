"""Who is on the road: not who rides; and vehicles and persons of one id are two agents."""

import xml.etree.ElementTree as ET
from dataclasses import replace
from types import SimpleNamespace

import libsumo
import numpy as np
import pytest

from deepmf_sumo.exporters import fcd
from deepmf_sumo.live.connection import shared
from deepmf_sumo.live.observer import LiveObserver
from deepmf_sumo.planners import idm
from deepmf_sumo.roadcheck.motion_survey import Survey, survey
from deepmf_sumo.sumo.simulation import network_case, simulate
from deepmf_sumo.sumo.simulation.road_users import TrafficReader
from deepmf_sumo.training.recording.many import Recording, record

from tests.support import mixed_traffic

DOMAINS = ("vehicle", "person", "vehicletype", "lane", "simulation", "TraCIException")
WALKERS = {"person 1", "person late"}


@pytest.fixture(scope="module")
def config(tmp_path_factory, starts_sumo):
    return mixed_traffic.build(tmp_path_factory.mktemp("mixed"))


def driven(config, av, start_s, steps, **more):
    case = replace(network_case(config, start_s, av, steps, seed=0), **more)
    planner = idm.build(idm.Settings(perception="corridor"))
    return simulate(case, planner, None, rng=np.random.default_rng(0))


@pytest.fixture(scope="module")
def boarding(config):
    """The bus stops, two persons board, and it drives on."""
    return driven(config, "0", 3.0, 180)


def test_who_boards_leaves_the_road(boarding):
    tracks = boarding.tracks
    assert {"person 0", "person rider"} | WALKERS <= set(tracks.ids)
    assert "person taken" not in tracks.ids
    boarded = tracks.valid[[tracks.row("person 0"), tracks.row("person rider")]]
    assert boarded[:, 0].all()
    assert not boarded[:, -1].any()
    assert tracks.valid[tracks.row("person 1")].all()


def test_a_bus_has_no_contact_with_its_passengers(boarding):
    assert not boarding.contacts
    assert not [one for one in boarding.events if "overlap" in one.kind]
    assert boarding.tracks.speed_mps[boarding.tracks.row("0"), -1] > 1.0


def test_a_planner_does_not_brake_for_its_own_passenger(config):
    tracks = driven(config, "2", 12.0, 30, only=()).tracks
    assert tracks.ids == ("2",)
    assert tracks.speed_mps[0].min() > 9.0


def test_a_vehicle_and_a_person_of_one_id_are_two_agents(boarding):
    tracks = boarding.tracks
    assert tracks.kinds[tracks.row("1")] == "vehicle"
    assert tracks.kinds[tracks.row("person 1")] == "pedestrian"
    apart = tracks.position_m[tracks.row("1")] - tracks.position_m[tracks.row("person 1")]
    assert np.hypot(*apart[0]) > 50.0
    assert tracks.speed_mps[tracks.row("person 1")].max() < 2.0


@pytest.mark.parametrize("names", [("1", "person 1"), ("1", "1"), ("person 1",), ("1",)])
def test_sources_name_the_two_apart(config, names):
    tracks = driven(config, "0", 3.0, 2, only=names).tracks
    assert set(tracks.ids) == {"0", *names}


def test_a_person_is_named_as_in_sumo_where_no_vehicle_has_the_id(config):
    tracks = driven(config, "0", 3.0, 2, only=("rider",)).tracks
    assert set(tracks.ids) == {"0", "person rider"}


def test_surveys_have_both(config):
    found = survey(Survey(config=config, seed=0))
    assert {"1", "person 1", "late", "person late"} <= set(found.names)
    assert "person taken" not in found.names
    on_foot = {one for one, yes in zip(found.names, found.motions.on_foot, strict=True) if yes}
    assert on_foot == {one for one in found.names if one.startswith("person ")}
    fast = found.motions.speed_mps > 4.0
    assert not [one for one in found.motions.body[fast] if found.names[one].startswith("person")]


def test_recorded_scenes_have_no_passengers(config):
    wanted = Recording(config=config, seed=0, start_s=1.0, stop_s=13.0, diverse=False)
    scenes = list(record(wanted))
    assert scenes
    for scene in scenes:
        tracks = scene.tracks
        assert "person taken" not in tracks.ids
        walking = [row for row, kind in enumerate(tracks.kinds) if kind == "pedestrian"]
        assert tracks.speed_mps[walking].max(initial=0.0) < 4.0


def test_a_live_attack_sees_the_same(config):
    libsumo.start(["sumo", "-c", str(config), "--step-length", "0.1", "--no-warnings"])
    try:
        libsumo.simulationStep(3.0)
        observer = LiveObserver(shared(libsumo), "1", 300.0)
        before = observer.frame(observer.look(), {})
        libsumo.simulationStep(16.0)
        after = observer.frame(observer.look(), {})
        around = observer.frame(observer.around(libsumo.vehicle.getPosition("1"), 300.0), {})
    finally:
        libsumo.close()
    assert set(before.ids) == {"0", "1", "2", "3", "person 0", "person rider", *WALKERS}
    assert set(after.ids) == {"0", "1", "2", "3", *WALKERS}
    assert set(around.ids) == set(after.ids)


def asked_publicly():
    """SUMO's own answers, by agent: front bumper x, y, angle, speed, z."""
    found = {}
    for domain, prefix in ((libsumo.vehicle, ""), (libsumo.person, "person ")):
        for name in sorted(domain.getIDList()):
            if prefix and domain.getVehicle(name):
                continue
            x, y, z = domain.getPosition3D(name)
            found[prefix + name] = (x, y, domain.getAngle(name), max(domain.getSpeed(name), 0.0), z)
    return found


def test_what_is_read_is_what_sumo_answers_at_each_step(config):
    libsumo.start(["sumo", "-c", str(config), "--step-length", "0.1", "--no-warnings"])
    try:
        reader, seen = TrafficReader(libsumo), set()
        public = TrafficReader(SimpleNamespace(**{one: getattr(libsumo, one) for one in DOMAINS}))
        for _ in range(160):  # vehicles and persons come, board and leave
            libsumo.simulationStep()
            states = reader.states()
            assert list(states.items()) == list(asked_publicly().items())
            assert states == public.states()
            frame = reader.read()
            assert frame.ids == list(states)
            seen.add(tuple(frame.ids))
        sizes = [(libsumo.vehicle.getLength(one), libsumo.vehicle.getWidth(one))
                 for one in libsumo.vehicle.getIDList()]  # fmt: skip
        assert reader.bodies.sizes_m(libsumo.vehicle.getIDList()).tolist() == [*map(list, sizes)]
    finally:
        libsumo.close()
    assert len(seen) > 3


def test_fcd_has_persons_as_sumo_has_them(boarding):
    steps = ET.fromstring(fcd._fcd(boarding, boarding.tracks.valid, ()))
    first = {(one.tag, one.get("id")) for one in steps[0]}
    assert {("vehicle", "1"), ("person", "1"), ("person", "rider")} <= first
