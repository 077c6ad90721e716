"""The AV stops for an opponent that stands across its way, whatever lane SUMO counts it on."""

from types import SimpleNamespace

import numpy as np
import pytest
import shapely
from shapely import affinity

from deepmf_sumo.planners import idm, sumo
from deepmf_sumo.scene import Command, Plan
from deepmf_sumo.scene.geometry import polylines
from deepmf_sumo.sumo.simulation import network_case, simulate
from deepmf_sumo.sumo.simulation.av import SumoAv
from deepmf_sumo.sumo.simulation.frame import Pose

from tests.sumo.simulation.test_seen_on_its_way import built, vehicle
from tests.support.simulated_worlds import case_of, crossing_road, scene_of, straight_motion

pytestmark = pytest.mark.sumo

NODES = (
    '<node id="w" x="0" y="150"/><node id="m" x="150" y="150" type="priority"/>'
    '<node id="e" x="300" y="150"/><node id="n" x="150" y="300"/><node id="s" x="150" y="0"/>'
)
MIDDLE_M = np.array([150.0, 150.0])
EDGES = "".join(
    f'<edge id="{start}{to}" from="{start}" to="{to}" speed="14" priority="{priority}"/>'
    for arm, priority in (("w", 3), ("e", 3), ("n", 1), ("s", 1))
    for start, to in ((arm, "m"), ("m", arm))
)


class Stands:
    """The opponent drives a curve to a place, heading there, and stands."""

    period_steps = None

    def __init__(self, place, heading_deg, middle_m=MIDDLE_M):
        self.place, self.heading_rad = middle_m + place, np.radians(heading_deg)

    def reset(self, view, rng):
        return ("other",)

    def plan(self, view):
        tracks, row = view.history, view.history.row("other")
        line = self._curve(tracks.position_m[row, -1], float(tracks.heading_rad[row, -1]))
        speed = brakes_to_stop(float(tracks.speed_mps[row, -1]), polylines.arc_lengths(line)[-1])
        place, heading = polylines.points_at(line, np.cumsum(speed) * 0.1)
        plan = Plan(
            agent_id="other", first_step=view.step + 1, position_m=place, heading_rad=heading,
            speed_mps=speed,
        )  # fmt: skip
        return {"other": plan}

    def _curve(self, here, heading_rad):
        """(P, 2) a Bezier curve."""
        reach = np.hypot(*(self.place - here)) / 3
        begin = here + reach * np.array([np.cos(heading_rad), np.sin(heading_rad)])
        end = self.place - reach * np.array([np.cos(self.heading_rad), np.sin(self.heading_rad)])
        t = np.linspace(0, 1, 100)[:, None]
        return (
            (1 - t) ** 3 * here + 3 * (1 - t) ** 2 * t * begin + 3 * (1 - t) * t**2 * end
            + t**3 * self.place
        )  # fmt: skip


def brakes_to_stop(speed_mps, way_m):
    """(80) speeds that end a way: as before, then braking evenly to a stop."""
    braking = speed_mps**2 / (2 * 4.0)
    steps = np.arange(1, 81)
    coasts = max(way_m - braking, 0.0) / speed_mps / 0.1
    return np.clip(speed_mps - 0.4 * np.clip(steps - coasts, 0, None), 0.0, None)


DRIVERS = {"idm lane": idm.build(idm.Settings()), "sumo": sumo.build(sumo.Settings())}


def driven(folder, driver, place, heading_deg):
    """The AV comes from the west and has priority."""
    demand = vehicle("other", "nm ms", 128) + vehicle("av", "wm me", 60)
    config = built(folder, NODES, EDGES, demand)
    case = network_case(config, 2.0, "av", 80)
    return simulate(case, DRIVERS[driver], Stands(place, heading_deg), rng=np.random.default_rng(0))


@pytest.mark.parametrize("driver", DRIVERS)
@pytest.mark.parametrize(
    ("place", "heading_deg"),
    [((6.0, -3.2), -80.0), ((25.0, -3.0), -70.0), ((-9.0, -3.0), -110.0), ((3.0, -4.0), -60.0)],
)
def test_it_stops_before_who_stands_across_its_way(tmp_path, driver, place, heading_deg):
    rollout = driven(tmp_path, driver, place, heading_deg)
    tracks = rollout.tracks
    av, other = (box(tracks, tracks.row(name)) for name in ("av", "other"))
    speed_mps = tracks.speed_mps[tracks.row("av")]
    assert not rollout.contacts
    assert speed_mps[-1] ** 2 / (2 * av.distance(other)) < 5.0, "it can stop"
    assert av.distance(other) < 25.0, "it comes near"
    assert np.diff(speed_mps[rollout.now :]).min() > -0.91


def box(tracks, row):
    """Shapely's, at the end."""
    length_m, width_m, _ = tracks.size_m[row]
    place, heading_rad = tracks.position_m[row, -1], tracks.heading_rad[row, -1]
    middle = shapely.box(-length_m / 2, -width_m / 2, length_m / 2, width_m / 2)
    turned = affinity.rotate(middle, heading_rad, origin=(0, 0), use_radians=True)
    return affinity.translate(turned, *place)


def test_it_passes_who_stands_beside_its_way(tmp_path):
    rollout = driven(tmp_path, "idm lane", (16.0, 1.7), 0.0)
    tracks = rollout.tracks
    assert not rollout.contacts
    assert tracks.position_m[tracks.row("av"), -1, 0] > MIDDLE_M[0] + 20.0


class Vehicle:
    """SUMO's vehicles, as far as an AV on a lane asks for them; behind each the AV drives at
    ``speeds``."""

    def __init__(self, speed_mps, speeds):
        self.speed_mps, self.speeds, self.asked = speed_mps, speeds, {}

    def __getattr__(self, name):
        answers = {
            "getSpeed": self.speed_mps, "getDecel": 2.0, "getEmergencyDecel": 9.0, "getMinGap": 2.0,
            "getIDList": ("av", *self.speeds), "getLeader": ("ahead", 20.0), "getLaneID": "ab_0",
            "getBestLanes": (), "getLaneChangeMode": 0,
        }  # fmt: skip
        if name == "getFollowSpeed":
            return lambda *given: self.speeds[given[-1]]
        if name.startswith("set"):
            return lambda _, value: self.asked.update({name: value})
        return lambda *_: answers[name]


@pytest.mark.parametrize(
    ("speed_mps", "across_mps", "ahead_mps", "asked_mps", "mode"),
    [
        (10.0, 9.95, 14.0, 9.95, 31),  # gently: SUMO checks the rest
        (10.0, 9.5, 14.0, 9.5, 26),
        (10.0, 9.5, 9.3, 9.3, 26),  # SUMO's own leader is nearer
        (10.0, 2.0, 14.0, 9.1, 26),  # as hard as it can
        (10.0, 12.0, 14.0, -1.0, 31),
        (0.0, 0.0, 3.0, 0.0, 31),  # it stays
    ],
)
def test_how_hard_it_brakes(speed_mps, across_mps, ahead_mps, asked_mps, mode):
    vehicle = Vehicle(speed_mps, {"across": across_mps, "ahead": ahead_mps})
    pose = Pose(x_m=0.0, y_m=0.0, heading_rad=0.0, speed_mps=speed_mps)
    av = SumoAv(SimpleNamespace(vehicle=vehicle), "av", 5.0, pose)
    av.drive(Command(kind="sumo"), {"across": 12.0})
    assert vehicle.asked["setSpeed"] == pytest.approx(asked_mps)
    assert vehicle.asked["setSpeedMode"] == mode
    assert av.leaders == ("ahead", "across")


@pytest.mark.parametrize("driver", DRIVERS)
@pytest.mark.parametrize("traffic", ["log", "sumo"])
def test_it_stops_in_recordings(tmp_path, traffic, driver):
    motions = {
        "av": straight_motion(-90, 0, 0.0, 12.0),
        "other": straight_motion(0, -25, np.pi / 2, 8.0),
    }
    case = case_of(scene_of(crossing_road(), motions), tmp_path, traffic)
    policy = Stands((25.0, 2.8), 80.0, middle_m=np.zeros(2))
    rollout = simulate(case, DRIVERS[driver], policy, rng=np.random.default_rng(0))
    tracks = rollout.tracks
    av, other = (box(tracks, tracks.row(name)) for name in ("av", "other"))
    assert not rollout.contacts
    assert tracks.speed_mps[tracks.row("av"), -1] ** 2 / (2 * av.distance(other)) < 5.0
