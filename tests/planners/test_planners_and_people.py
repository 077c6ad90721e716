"""Which planners react to people, to which, and from when on: what the page on planners says."""

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.attacks import trajectory
from deepmf_sumo.planners.perception import nearest_in_corridor
from deepmf_sumo.scene import HISTORY_STEPS
from deepmf_sumo.sumo.simulation import network_case, simulate
from studies.planner_faults.careful import Careful

from tests.planners.test_idm import STRAIGHT, view_of
from tests.support import pavements

pytestmark = pytest.mark.jumps("the person turns on the spot")
NOW = HISTORY_STEPS - 1
LANE_X_M, HALF_LANE_M = 201.6, 1.6
KERB_X_M = 204.2
PLANNERS = ("sumo", "lane", "corridor", "careful")


def planner(name):
    if name == "careful":
        return Careful.build(Careful.Settings())
    kind, keys = ("sumo", {}) if name == "sumo" else ("idm", {"perception": name})
    return plugins.load("planners", kind).build(plugins.settings("planners", kind, keys))


def poses(*parts):
    """Rows x, y, heading of parts (x, from y, to y or to x, speed or seconds)."""
    rows = []
    for (x0, y0), (x1, y1), speed in parts:
        count = max(round(np.hypot(x1 - x0, y1 - y0) / speed * 10), 1)
        share = np.arange(1, count + 1) / count
        heading = np.arctan2(y1 - y0, x1 - x0)
        rows += [[x0 + s * (x1 - x0), y0 + s * (y1 - y0), heading] for s in share]
    return rows


def stays(x, y, seconds, heading=np.pi):
    return [[x, y, heading]] * round(10 * seconds)


TO_KERB = poses(((204.8, 118.6), (KERB_X_M, 120.5), 1.4))
MOTIONS = {
    "beside": [*TO_KERB, *poses(((KERB_X_M, 120.5), (KERB_X_M, 132.0), 1.4)),
               *stays(KERB_X_M, 132, 5)],
    "stands": [*poses(((204.8, 118.6), (LANE_X_M, 120.5), 1.4)), *stays(LANE_X_M, 120.5, 9)],
    "crosses": [*TO_KERB, *stays(KERB_X_M, 120.5, 3.6),
                *poses(((KERB_X_M, 120.5), (196.0, 120.5), 1.4)), *stays(196.0, 120.5, 1)],
}  # fmt: skip


@pytest.fixture(scope="module")
def config(tmp_path_factory, starts_sumo):
    demand = pavements.car("av", "sm mn", 1, 10), pavements.walker("p", "sm mn", 118)
    return pavements.build(tmp_path_factory.mktemp("people"), *demand)


@pytest.fixture(scope="module")
def driven(config):
    """(planner, motion) -> the rollout, simulated once."""
    found = {}

    def of(name, motion):
        if (name, motion) not in found:
            chosen = {"agent": "p", "poses": MOTIONS[motion]}
            policy = trajectory.TrajectoryPolicy(
                plugins.settings("adversaries", "trajectory", chosen)
            )
            case = network_case(config, 2.0, "av", 150, seed=0)
            rng = np.random.default_rng(0)
            found[name, motion] = simulate(case, planner(name), policy, rng=rng)
        return found[name, motion]

    return of


def reacts_at(driven, name, motion):
    """The person's distance from the middle of the lane when the AV is slower than beside it."""
    rollout, free = driven(name, motion), driven(name, "beside")
    tracks = [one.tracks.speed_mps[one.tracks.row("av"), NOW:] for one in (rollout, free)]
    both = min(map(len, tracks))
    slower = np.flatnonzero(tracks[0][:both] < tracks[1][:both] - 0.15)
    row = rollout.tracks.row("person p")
    return float(rollout.tracks.position_m[row, NOW + slower[0], 0] - LANE_X_M), rollout


@pytest.mark.parametrize("name", PLANNERS)
def test_all_stop_for_who_stands_on_the_lane(driven, name):
    at, rollout = reacts_at(driven, name, "stands")
    assert abs(at) < HALF_LANE_M
    assert rollout.contacts == ()


@pytest.mark.parametrize("name", ["sumo", "lane", "corridor"])
def test_these_brake_only_once_the_person_is_on_the_lane(driven, name):
    """He waits at the kerb and walks: 1.6 m and 1.2 m from the middle are the lane's edge and that
    of the corridor; nobody brakes for who comes towards them.
    """
    at, _ = reacts_at(driven, name, "crosses")
    assert at < HALF_LANE_M


def test_the_careful_planner_brakes_for_who_walks_towards_its_corridor(driven):
    at, rollout = reacts_at(driven, "careful", "crosses")
    assert at > reacts_at(driven, "corridor", "crosses")[0]
    assert rollout.contacts == ()


def test_the_corridor_ignores_who_walks_towards_it():
    """A box of 0.5 m: its edge is in the corridor of 1.2 m on each side from 1.45 m on."""
    size = [(0.5, 0.5, 1.75)]
    towards = (30.0, -1.5, np.pi / 2, 3.0)
    assert nearest_in_corridor(view_of([towards], size), STRAIGHT, 0.2) is None
    inside = (30.0, -1.4, np.pi / 2, 3.0)
    assert nearest_in_corridor(view_of([inside], size), STRAIGHT, 0.2).speed_mps == pytest.approx(0)
