"""Python planners that misbehave, and what the guard lets pass."""

import os
import signal
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from deepmf_sumo.errors import PlannerError
from deepmf_sumo.planners._checked import Guard, check
from deepmf_sumo.scene import Command
from deepmf_sumo.sumo.simulation import network_case, simulate

from tests.support.tiny_network import build


@pytest.fixture(scope="module")
def config(tmp_path_factory, starts_sumo):
    return build(tmp_path_factory.mktemp("tiny"))


class Planner:
    model = None

    def __init__(self, act):
        self._act = act

    def reset(self, case, rng):
        self.steps = 0

    def act(self, view):
        self.steps += 1
        return self._act(view) if self.steps == 3 else Command(kind="sumo")


def fork(view):
    os.fork()
    raise RuntimeError("forked")


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda view: 1 / 0, "ZeroDivisionError: division by zero (see log.txt)"),
        (lambda view: sys.exit(3), "SystemExit: 3"),
        (lambda view: None, "the planner returned None at step 12, which is not a Command"),
        (lambda view: [1.0, 2.0], "returned [1.0, 2.0] at step 12, which is not a Command"),
        (
            lambda view: Command(kind="fly"),
            "kind at step 12 is 'fly'; known: sumo, speed, leader, pose",
        ),
        (
            lambda view: Command(kind="speed", speed_mps=float("nan")),
            "speed_mps at step 12 is nan, not a finite number",
        ),
        (
            lambda view: Command(kind="speed", speed_mps=np.zeros(3)),
            "not a finite number",
        ),
        (lambda view: Command(kind="speed", speed_mps="fast"), "is 'fast', not a finite"),
        (lambda view: Command(kind="speed", speed_mps=1e9), "no vehicle drives faster"),
        (lambda view: Command(kind="speed", speed_mps=-3.0), "cannot drive backwards"),
        (lambda view: Command(kind="leader", leader_mps=-1e9), "leader_mps at step 12 is -1e+09"),
        (lambda view: Command(kind="pose", x_m=1e6), "farther than it gets in 0.1 s"),
        (lambda view: Command(kind="pose", x_m=1e308), "is 1e+308 m from the AV, farther"),
        (
            lambda view: Command(kind="pose", heading_rad=1e300),
            "heading_rad at step 12 is 1e+300; it must be an angle between -10000 and 10000 rad",
        ),
        (fork, "RuntimeError: forked"),
    ],
)
def test_a_hostile_class_is_a_planner_error(config, act, message):
    case = network_case(config, 3.0, "av", 6, seed=0)
    me = os.getpid()
    with pytest.raises(PlannerError) as found:
        simulate(case, Planner(act), None, rng=np.random.default_rng(0))
    assert os.getpid() == me
    assert str(found.value).startswith("planner_error: ")
    assert message in str(found.value)


@pytest.mark.parametrize("number", [np.float32, np.float64, np.float16, np.int64, np.uint8, int])
@pytest.mark.parametrize(
    "command", [{"kind": "speed", "speed_mps": 9}, {"kind": "leader", "gap_m": 7, "leader_mps": 8}]
)
def test_numbers_of_numpy_drive_as_plain_ones(config, command, number):
    case = network_case(config, 3.0, "av", 6, seed=0)
    ways = []
    for of in (float, number):
        numbers = {name: one if name == "kind" else of(one) for name, one in command.items()}
        planner = Planner(lambda view, numbers=numbers: Command(**numbers))
        rollout = simulate(case, planner, None, rng=np.random.default_rng(0))
        ways.append(rollout.tracks.position_m)
    assert np.array_equal(*ways, equal_nan=True)


def test_a_pose_of_float32_is_driven(config):
    def act(view):
        x, y = view.history.position_m[view.history.row("av"), -1].astype(np.float32)
        return Command(kind="pose", x_m=x + np.float32(0.5), y_m=y, speed_mps=np.float32(5))

    case = network_case(config, 3.0, "av", 6, seed=0)
    rollout = simulate(case, Planner(act), None, rng=np.random.default_rng(0))
    assert rollout.tracks.valid[rollout.tracks.row("av")].all()


def test_a_planner_is_closed_however_the_episode_ends(config):
    closed = []

    class Closing(Planner):
        def close(self):
            closed.append(self.steps)

    case = network_case(config, 3.0, "av", 4, seed=0)
    simulate(case, Closing(lambda view: Command(kind="sumo")), None, rng=np.random.default_rng(0))
    with pytest.raises(PlannerError):
        simulate(case, Closing(lambda view: 1 / 0), None, rng=np.random.default_rng(0))
    assert closed == [4, 3]


@pytest.mark.parametrize(
    ("ctrl_c", "sigterm", "error"),
    [
        (signal.default_int_handler, signal.SIG_DFL, KeyboardInterrupt),
        (signal.SIG_IGN, signal.default_int_handler, KeyboardInterrupt),  # started with `&`
        (signal.SIG_IGN, signal.SIG_DFL, PlannerError),  # as in workers
    ],
)
def test_an_interrupt_is_the_planners_error_only_where_none_can_come_from_outside(
    ctrl_c, sigterm, error
):
    def interrupt(view):
        raise KeyboardInterrupt

    guard = Guard(Planner(interrupt))
    guard.reset(None, np.random.default_rng(0))
    view = SimpleNamespace(step=3)
    for _ in range(2):
        guard.act(view)
    before = signal.signal(signal.SIGINT, ctrl_c), signal.signal(signal.SIGTERM, sigterm)
    try:
        with pytest.raises(error):
            guard.act(view)
    finally:
        signal.signal(signal.SIGINT, before[0])
        signal.signal(signal.SIGTERM, before[1])


def test_what_was_fixed_before_may_jump():
    position = np.zeros((1, 1, 2))
    history = SimpleNamespace(position_m=position, row=lambda agent: 0)
    view = SimpleNamespace(step=3, dt_s=0.1, av_id="av", history=history)
    far = Command(kind="pose", x_m=15.1)
    check(far, view, may_jump=True)
    check(Command(kind="pose", x_m=14.9), view, may_jump=False)
    with pytest.raises(PlannerError, match=r"15.1 m from the AV"):
        check(far, view, may_jump=False)
