"""Attacks in a simulation that the test steps itself."""

import libsumo
import numpy as np
import pytest

from deepmf_sumo.deepmf.networks import lanes
from deepmf_sumo.errors import UsageError
from deepmf_sumo.live import observer
from deepmf_sumo.live.session import parts_of_a_step
from deepmf_sumo.live.triggers import AtEdge, AtTime, AtTtc, least_ttc_s, parse
from deepmf_sumo.scene import Driver, TurnRules
from deepmf_sumo.sumo.simulation.frame import Frame

from tests.support.live_doubles import OPTIONS, Brake, session_on, step
from tests.support.tiny_network import build

pytestmark = pytest.mark.sumo


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return build(tmp_path_factory.mktemp("tiny")).parent


@pytest.fixture
def sumo(folder):
    """Starts SUMO in this process."""

    def start(step_length="0.1"):
        command = ["sumo", "-c", str(folder / "tiny.sumocfg"), *OPTIONS, "--remote-port", "0"]
        libsumo.start([*command, "--step-length", step_length])
        return libsumo

    yield start
    libsumo.close()


def alone(steps, start):
    """Where the vehicles are without us."""
    api = start()
    track = []
    for _ in range(steps):
        api.simulationStep()
        track.append({one: api.vehicle.getPosition(one) for one in api.vehicle.getIDList()})
    api.close()
    return track


def test_a_leader_that_brakes_is_driven_and_handed_back(folder, sumo):
    api, policy = sumo(), Brake()
    session, fought = session_on(api, folder, policy, pause_s=100.0)
    step(api, session, 40)
    (one,) = fought
    rollout = one.rollout
    assert (rollout.opponent_id, rollout.ended) == ("leader", "plan_ended")
    assert one.begin_s == pytest.approx(1.1)
    row = rollout.tracks.row("leader")
    drivers = rollout.driver[row, rollout.now + 1 :]
    assert (drivers[:20] == Driver.POLICY).all()
    speed = rollout.tracks.speed_mps[row, rollout.now :]
    assert np.diff(speed[:20]) == pytest.approx(-0.3, abs=1e-6)
    assert {event.kind for event in rollout.events} == {"plan_ended", "handed_back"}
    before = api.vehicle.getSpeed("leader")
    step(api, session, 10)
    assert api.vehicle.getSpeed("leader") > before + 1.0
    assert api.vehicle.getRoute("leader") == ("ab",)


def test_the_policy_sees_the_last_second_as_it_was(folder, sumo):
    api, policy = sumo(), Brake()
    session, _ = session_on(api, folder, policy)
    step(api, session, 12)
    (view,) = policy.views
    assert view.history.ids == ("leader", "av")
    assert view.history.valid.shape == (2, 11)
    assert view.history.valid.all()
    row = view.history.row("leader")
    moved = np.diff(view.history.position_m[row, :, 0])
    assert moved == pytest.approx(view.history.speed_mps[row, 1:] * 0.1, abs=1e-6)


def test_the_av_is_never_commanded_and_nothing_changes_before_an_attack(folder, sumo):
    expected = alone(30, sumo)
    api = sumo()
    session, _ = session_on(api, folder, Brake(opponent="nobody"))
    for positions in expected:
        step(api, session, 1)
        now = {one: api.vehicle.getPosition(one) for one in api.vehicle.getIDList()}
        assert now == positions
    assert session.attacks == 0
    assert session.last_failure == "no vehicle around the AV can attack"


def test_closing_leaves_no_trace(folder, sumo):
    api = sumo()
    session, fought = session_on(api, folder, Brake(sideways=1.0))
    step(api, session, 15)
    assert session.attacking == "leader"
    assert api.poi.getIDCount() == 1
    session.close()
    assert api.poi.getIDCount() == 0
    assert [one.rollout.ended for one in fought] == ["time"]
    api.simulationStep()
    assert api.vehicle.getLaneID("leader")
    assert not api.poi.getAllContextSubscriptionResults()


def test_the_session_does_not_touch_subscriptions_of_the_script(folder, sumo):
    api = sumo()
    api.simulationStep()
    api.vehicle.subscribeContext("av", 0xA4, 10.0, [0x40])
    session, _ = session_on(api, folder, Brake(opponent="nobody"))
    step(api, session, 5)
    seen = api.vehicle.getContextSubscriptionResults("av")
    assert set(seen) == {"av"}
    assert set(seen["av"]) == {0x40}
    session.close()
    api.simulationStep()
    assert set(api.vehicle.getContextSubscriptionResults("av")) == {"av"}


@pytest.mark.parametrize(("step_length", "parts"), [("0.05", 2), ("0.02", 5)])
def test_shorter_steps_of_the_simulation(folder, sumo, step_length, parts):
    api = sumo(step_length)
    session, fought = session_on(api, folder, Brake(), pause_s=100.0)
    x = []
    for _ in range(40 * parts):
        step(api, session, 1)
        x.append(api.vehicle.getPosition("leader")[0])
    assert [one.rollout.ended for one in fought] == ["plan_ended"]
    moves = np.diff(x)[11 * parts : 30 * parts]
    assert moves.min() > 0
    # the speed falls by 0.3 m/s every 0.1 s, and nothing jumps in between
    assert np.abs(np.diff(moves)).max() < 0.031 / parts


@pytest.mark.parametrize("step_s", [1.0, 0.25, 0.3, 0.03])
def test_steps_that_do_not_fit_are_refused(step_s):
    with pytest.raises(UsageError, match=f"steps by {step_s:g} s.*--step-length 0.1"):
        parts_of_a_step(step_s)


def test_the_index_of_the_road_is_made_before_the_first_step(folder, sumo, monkeypatch):
    """On the network of a town it takes seconds, which no step of a script should."""
    session, _ = session_on(sumo(), folder, Brake(opponent="nobody"))
    monkeypatch.setattr(lanes, "_pixels", None)  # part of making an index
    assert lanes.road_index(session.surroundings.road).lane_ids


def test_a_script_that_steps_twice_is_told(folder, sumo):
    api = sumo()
    session, _ = session_on(api, folder, Brake(opponent="nobody"))
    step(api, session, 5)
    api.simulationStep()
    with pytest.raises(UsageError, match="around every single step"):
        step(api, session, 10)


def test_contact_ends_the_attack_and_is_recorded(folder, sumo):
    api = sumo()
    api.simulationStep()
    session, fought = session_on(api, folder, Brake(brake_mps2=6.0), triggers=())
    api.vehicle.setSpeedMode("av", 0)
    api.vehicle.setLaneChangeMode("av", 0)
    api.vehicle.setSpeed("leader", 6.0)
    api.vehicle.setSpeed("av", 13.0)
    while api.vehicle.getPosition("leader")[0] - api.vehicle.getPosition("av")[0] > 20.0:
        step(api, session, 1)
    session.attack()
    step(api, session, 30)
    rollout = fought[0].rollout
    contact = rollout.first("av_opponent")
    assert rollout.ended == "contact"
    assert contact.striker_id == "av"
    assert contact.sector == 0
    assert contact.relative_mps > 5
    assert api.vehicle.getSpeed("av") == pytest.approx(13.0)


def test_an_av_that_sumo_teleports_ends_the_attack_and_may_be_attacked_again(
    folder, sumo, monkeypatch
):
    api = sumo()
    session, fought = session_on(api, folder, Brake())
    step(api, session, 15)
    assert session.attacking == "leader"
    with monkeypatch.context() as patched:
        patched.setattr(api.simulation, "getStartingTeleportIDList", lambda: ("av",))
        step(api, session, 1)
    assert session.attacking is None
    step(api, session, 80)
    assert fought[0].rollout.ended == "av_gone"
    assert session.av_present
    assert len(fought) > 1


def test_an_av_that_vanishes_ends_the_attack_and_may_come_back(folder, sumo):
    api = sumo()
    session, fought = session_on(api, folder, Brake())
    step(api, session, 15)
    api.vehicle.remove("av")
    step(api, session, 2)
    assert [one.rollout.ended for one in fought] == ["av_gone"]
    assert not session.av_present
    api.route.add("again", ["ab"])
    api.vehicle.add("av", "again", departPos="10", departSpeed="5")
    step(api, session, 80)
    assert session.av_present
    assert len(fought) > 1


def test_who_has_attacked_lately_rests(folder, sumo):
    api = sumo()
    rules = TurnRules(longest_s=5.0, again_after_s=1000.0)
    policy = Brake()
    session, fought = session_on(api, folder, policy, pause_s=0.5, rules=rules)
    step(api, session, 60)
    assert len(fought) > 1
    # once without the leader, where nobody was left, and once with it
    seen = ["leader" in view.history.ids for view in policy.views]
    assert seen[:3] == [True, False, True]


def test_a_time_begins_one_attack_and_until_then_nothing_is_asked(folder, sumo):
    api = sumo()
    session, fought = session_on(api, folder, Brake(), triggers=(AtTime(4.0),), pause_s=0.5)
    step(api, session, 20)
    assert api.poi.getIDCount() == 0
    assert session.av_present
    step(api, session, 80)
    assert [one.begin_s for one in fought] == [pytest.approx(4.0)]


def test_an_edge_begins_an_attack(folder, sumo):
    api = sumo()
    session, fought = session_on(api, folder, Brake(), triggers=(AtEdge("ba"),))
    step(api, session, 30)
    assert session.attacking is None
    assert not fought
    here, _ = session_on(api, folder, Brake(), triggers=(AtEdge("ab"),))
    step(api, here, 15)
    assert here.attacking == "leader"


def test_a_low_ttc_begins_an_attack_at_the_right_moment(folder, sumo):
    api = sumo()
    api.simulationStep()
    session, _ = session_on(api, folder, Brake(), triggers=(AtTtc(2.0),))
    api.vehicle.setSpeedMode("av", 0)
    api.vehicle.setLaneChangeMode("av", 0)
    api.vehicle.setSpeed("leader", 5.0)
    step(api, session, 20)
    assert session.attacking is None
    api.vehicle.setSpeed("av", 12.0)
    ttc = []
    while session.attacking is None:
        step(api, session, 1)
        gap = api.vehicle.getPosition("leader")[0] - api.vehicle.getPosition("av")[0] - 5.0
        closing = api.vehicle.getSpeed("av") - api.vehicle.getSpeed("leader")
        ttc.append(gap / closing if closing > 0 else np.inf)
    assert ttc[-1] < 2.0 <= ttc[-2]


def test_a_call_begins_an_attack(folder, sumo):
    api = sumo()
    session, _ = session_on(api, folder, Brake(), triggers=())
    step(api, session, 20)
    assert session.attacking is None
    session.attack()
    step(api, session, 13)
    assert session.attacking == "leader"


@pytest.mark.parametrize("text", ["", "time", "time=", "time=soon", "ttc=-1", "speed=3", "ttc=nan"])
def test_triggers_that_are_none(text):
    with pytest.raises(UsageError, match="must be time=SECONDS, edge=ID or ttc=SECONDS"):
        parse([text])


def test_triggers_as_on_the_command_line():
    assert parse(["time=12.5", "edge=a=b", "ttc=3"]) == (AtTime(12.5), AtEdge("a=b"), AtTtc(3.0))


def test_who_leaves_while_it_is_remembered_does_no_harm(folder, sumo):
    api = sumo()
    api.simulationStep()
    api.route.add("again", ["ab"])
    api.vehicle.add("third", "again", departPos="100", departLane="1", departSpeed="5")
    session, _ = session_on(api, folder, Brake())
    step(api, session, 5)
    assert "third" in api.vehicle.getIDList()
    api.vehicle.remove("third")
    step(api, session, 15)
    assert session.attacking == "leader"


def test_an_av_on_its_own_is_left_in_peace(folder, sumo):
    api, policy = sumo(), Brake()
    api.simulationStep()
    api.vehicle.remove("leader")
    session, _ = session_on(api, folder, policy)
    step(api, session, 20)
    assert session.last_failure == "nobody is near the AV"
    assert policy.views == []


def test_circles_never_miss_what_boxes_touch():
    rng = np.random.default_rng(3)
    for _ in range(300):
        x, y, u, v = rng.uniform(-20, 20, 4)
        heading = float(np.arctan2(v, u))
        size = np.array([[4.6, 1.9], [4.6, 1.9]])
        frame = Frame(
            ids=["av", "other"],
            position_m=np.array([[0.0, 0.0], [x, y]]),
            z_m=np.zeros(2),
            heading_rad=np.array([0.3, heading]),
            velocity_mps=np.array([[9.6, 2.9], [u, v]]),
            driver=np.zeros(2, np.uint8),
        )
        radius = np.hypot(4.6, 1.9) / 2
        circles = observer._meeting_s((0, 0, 9.6, 2.9, radius), (x, y, u, v, radius))
        assert circles <= least_ttc_s(frame, size, "av") + 1e-9


def test_persons_are_seen_from_when_they_come(folder, sumo):
    api, policy = sumo(), Brake(opponent="nobody")
    session, _ = session_on(api, folder, policy)
    step(api, session, 12)
    api.person.add("walker", "ab", 80.0)
    api.person.appendWalkingStage("walker", ["ab"], 200.0)
    step(api, session, 45)
    assert "person walker" not in policy.views[0].history.ids
    row = policy.views[-1].history.row("person walker")
    assert policy.views[-1].history.kinds[row] == "pedestrian"


def test_while_nothing_can_happen_one_step_may_last_longer(folder, sumo):
    """The same attack as in steps of 0.1 s, after a few long ones."""

    def attacked(*, long):
        api = sumo()
        session, fought = session_on(
            api, folder, Brake(), triggers=[AtTime(9.0)], pause_s=100.0, rules=None
        )
        steps = 0
        while session.time_s < 14.0:
            frames = session.idle_frames() if long else 0
            if frames > 1:
                api.simulationStep(session.time_s + 0.1 * frames)
                session.after_long_step(frames)
            else:
                step(api, session, 1)
            steps += 1
        (one,) = fought
        api.close()
        return steps, one.begin_s, one.rollout

    (short, begin_s, rollout), (fewer, again_s, same) = attacked(long=False), attacked(long=True)
    sumo()
    assert (short, begin_s) == (140, pytest.approx(9.0))
    assert fewer < short - 60
    assert again_s == begin_s
    np.testing.assert_array_equal(same.tracks.position_m, rollout.tracks.position_m)
