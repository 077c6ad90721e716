"""Persons and cyclists that attack in a simulation that the test steps itself."""

import libsumo
import numpy as np
import pytest

from deepmf_sumo.scene import Driver, Plan, TurnRules

from tests.support import pavements
from tests.support.live_doubles import OPTIONS, session_on, step

pytestmark = pytest.mark.sumo

AV = pavements.car("av", "wm me", 2, 80, 8.0)


class Crosses:
    """It goes ``far_m`` to the left of its lane at 1.4 m/s, and stands there."""

    period_steps = None

    def __init__(self, agent, far_m, ahead_mps=0.0):
        self.agent, self.far_m, self.ahead_mps = agent, far_m, ahead_mps

    def reset(self, view, rng):
        return (self.agent,) if self.agent in view.history.ids else ()

    def plan(self, view):
        row = view.history.row(self.agent)
        x, y = view.history.position_m[row, -1]
        steps = np.arange(1, 31)
        aside = np.minimum(0.14 * steps, self.far_m)
        speed = np.hypot(np.diff(aside, prepend=0.0) * 10, self.ahead_mps)
        heading = np.arctan2(np.diff(aside, prepend=0.0) * 10, max(self.ahead_mps, 1e-9))
        return {
            self.agent: Plan(
                agent_id=self.agent,
                first_step=view.step + 1,
                position_m=np.column_stack([x + 0.1 * self.ahead_mps * steps, y + aside]),
                heading_rad=heading,
                speed_mps=speed,
            )
        }


@pytest.fixture
def started(tmp_path, request):
    config = pavements.build(tmp_path, *request.param)
    libsumo.start(["sumo", "-c", str(config), *OPTIONS, "--step-length", "0.1"])
    yield tmp_path
    libsumo.close()


WALKS = [(AV, pavements.walker("p", "wm me", 118))]
RIDES = [(AV, pavements.car("b", "wm me", 1, 100, 4.0, kind="bike"))]


def fight(folder, agent, far_m, steps, **more):
    rules = TurnRules(longest_s=4.0, reach_m=200.0)
    policy = Crosses(agent, far_m, **more)
    net = "pavements.net.xml"
    session, fought = session_on(libsumo, folder, policy, pause_s=100.0, rules=rules, net=net)
    step(libsumo, session, steps)
    return session, fought


@pytest.mark.parametrize("started", WALKS, indirect=True)
@pytest.mark.jumps("the plan turns a person at once")
def test_a_person_attacks_and_goes_back_to_the_footway(started):
    _, fought = fight(started, "person p", 3.5, 150)
    (one,) = fought
    rollout, row = one.rollout, one.rollout.tracks.row("person p")
    assert rollout.opponent_id == "person p"
    (plan,) = rollout.plans
    driven = slice(rollout.now + 1, rollout.now + 31)
    assert (rollout.driver[row, driven] == Driver.POLICY).all()
    assert rollout.tracks.position_m[row, driven] == pytest.approx(plan.position_m)
    assert libsumo.person.getLaneID("p") == "wm_0"
    assert libsumo.person.getEdges("p") == ("wm", "me")
    before = libsumo.person.getPosition("p")
    libsumo.simulationStep(libsumo.simulation.getTime() + 5.0)
    assert libsumo.person.getPosition("p")[0] > before[0] + 4.0, "it walks on"


@pytest.mark.parametrize("started", RIDES, indirect=True)
@pytest.mark.jumps("the plan turns a bicycle at once")
def test_a_cyclist_attacks_and_goes_back_to_the_cycle_lane(started):
    _, fought = fight(started, "b", 2.3, 130, ahead_mps=4.0)
    (one,) = fought
    assert one.rollout.opponent_id == "b"
    assert libsumo.vehicle.getLaneID("b").endswith("_1")
    assert abs(libsumo.vehicle.getLateralLanePosition("b")) < 0.2


@pytest.mark.parametrize("started", WALKS, indirect=True)
@pytest.mark.jumps("the plan turns a person at once")
def test_a_session_that_ends_leaves_no_person_where_sumo_does_not_walk_it(started):
    session, _ = fight(started, "person p", 3.5, 35)
    session.close()
    libsumo.simulationStep()
    assert libsumo.person.getLaneID("p") == "wm_0"
    at = libsumo.person.getPosition("p")
    libsumo.simulationStep(libsumo.simulation.getTime() + 5.0)
    assert libsumo.person.getPosition("p")[0] > at[0] + 4.0
