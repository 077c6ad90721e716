"""One episode: the loop over a simulated world, and sumo-gui, which follows the AV in real time."""

import time
from collections import defaultdict
from collections.abc import Sequence
from contextlib import AbstractContextManager, closing
from typing import Final, Literal, Protocol

import numpy as np

from deepmf_sumo.planners import sumo
from deepmf_sumo.planners._checked import Guard
from deepmf_sumo.planners.base import FixedPlanner, Planner
from deepmf_sumo.scene import DT_S, AgentId, Case, RecordedCase, Rollout, TrafficCase, VehicleModel
from deepmf_sumo.scene.policy import Policy
from deepmf_sumo.sumo.simulation import log_only, log_world, traffic_world
from deepmf_sumo.sumo.simulation.frame import Frame
from deepmf_sumo.sumo.simulation.in_sight import InSight
from deepmf_sumo.sumo.simulation.recorder import EpisodeRecord, timed
from deepmf_sumo.sumo.simulation.sumo_api import Backend, SumoApi
from deepmf_sumo.sumo.simulation.world import World

_AV_COLOUR: Final = (200, 30, 30, 255)
_OPPONENT_COLOUR: Final = (240, 140, 0, 255)
_FORMER_OPPONENT_COLOUR: Final = (250, 215, 160, 255)
_RADIUS_M: Final = 40.0
"""Shown around the AV."""
_LAST_LOOK_S: Final = 2.0
"""For which the end stays on the screen."""


class Observer(Protocol):
    """Watches an episode, e.g. to show it; changes nothing in it."""

    def on_step(self, frame: Frame, attackers: Sequence[AgentId]) -> None:
        """A step has happened, in which a policy could drive the attackers."""
        ...

    def on_end(self) -> None:
        """The episode is over."""
        ...


def simulate(
    case: Case,
    planner: Planner,
    policy: Policy | None,
    *,
    rng: np.random.Generator,
    gui: bool = False,
    backend: Backend | None = None,
) -> Rollout:
    """Simulate one episode of a case.

    Args:
        case: the AV, the start, the duration, and what drives the other agents.
        planner: drives the AV.
        policy: drives the opponents of its choice; None: no attack.
        rng: for the policy. SUMO and the planner have the case's seed, in the process and outside,
            so a planner's random numbers do not depend on the attack.
        gui: show the episode in sumo-gui.
        backend: how SUMO is run; None: libsumo, or sumo-gui if ``gui``, or no SUMO at all if
            nothing would react to the attack (`log_only`).

    Raises SimulationError if SUMO refuses something or the AV is absent at the start, PlannerError
    if the planner fails.
    """
    with closing(Guard(planner)) as guarded:
        guarded.reset(case, np.random.default_rng(case.seed))
        if (
            backend is None
            and not gui
            and case.turns is None
            and isinstance(planner, FixedPlanner)
            and isinstance(case, RecordedCase)
            and case.traffic == "log"
        ):
            return log_only.run(case, planner, policy, rng)
        backend = backend or ("gui" if gui else "libsumo")
        with _opened(case, guarded.model, backend) as (api, world):
            observers = [GuiWindow(api, case.av_id)] if backend == "gui" else []
            return run(case, world, guarded, policy, rng, observers)


def plain(case: TrafficCase) -> Rollout:
    """The episode of a case with neither planner nor attack: SUMO drives everybody.

    Raises SimulationError as `simulate`.
    """
    with traffic_world.opened_plain(case) as world:
        driver = sumo.build(sumo.Settings())
        return run(case, world, driver, None, np.random.default_rng(case.seed))


def _opened(
    case: Case, model: VehicleModel | None, backend: Backend
) -> AbstractContextManager[tuple[SumoApi, World]]:
    """SUMO, and the world of a case at its current step."""
    if isinstance(case, RecordedCase):
        return log_world.opened(case, model, backend)
    return traffic_world.opened(case, model, backend)


def run(
    case: Case,
    world: World,
    planner: Planner,
    policy: Policy | None,
    rng: np.random.Generator,
    observers: Sequence[Observer] = (),
) -> Rollout:
    """The loop: plan, drive, step and record until a hit ends it or the time is over."""
    seconds: dict[str, float] = defaultdict(float)
    with timed(seconds, "policy"):
        record = EpisodeRecord.begun(case, world, policy, rng)
    ended: Literal["time", "contact", "av_gone"] = "time"
    leaders, lights = [], []
    sight = InSight() if case.in_sight else None
    while record.step < record.end:
        with timed(seconds, "policy"):
            record.replan()
        with timed(seconds, "planner"):
            view = record.view(world.av.path())
            command = planner.act(view if sight is None else sight.limited(view))
        with timed(seconds, "simulation"):
            attackers = record.schedule.attackers
            frame = world.step(command, record.schedule.advance(record.step + 1))
            over = record.add(frame)
        for observer in observers:
            observer.on_step(frame, attackers)
        leaders.append(world.av.leaders)
        lights.append(view.signals)
        if over:
            ended = "contact"
            break
        if not world.av.present:
            ended = "av_gone"
            break
    for observer in observers:
        observer.on_end()
    return record.rollout(
        ended, world.events, seconds=dict(seconds), leaders=leaders, signals=lights
    )


class GuiWindow:
    """Observer of an episode in sumo-gui: the AV is red, its opponents are orange."""

    def __init__(self, api: SumoApi, av: AgentId) -> None:
        self._api = api
        self._av = av
        self._due = time.monotonic()
        self._followed = False
        self._opponents: Sequence[AgentId] = ()

    def on_step(self, frame: Frame, attackers: Sequence[AgentId]) -> None:  # noqa: ARG002 - SUMO shows it
        """Colour the vehicles, and wait until the step is over in real time."""
        self._show(attackers)
        now = time.monotonic()
        self._due = max(self._due + DT_S, now)  # time spent on planning is not caught up
        time.sleep(self._due - now)

    def on_end(self) -> None:
        """Leave the end on the screen for a moment."""
        time.sleep(_LAST_LOOK_S)

    def _show(self, opponents: Sequence[AgentId]) -> None:
        vehicle, gui = self._api.vehicle, self._api.gui
        there = set(vehicle.getIDList())
        for one in self._opponents:
            if one not in opponents and one in there:
                vehicle.setColor(one, _FORMER_OPPONENT_COLOUR)
        self._opponents = opponents
        for one in opponents:
            if one in there:
                vehicle.setColor(one, _OPPONENT_COLOUR)
        if self._av not in there:
            return
        vehicle.setColor(self._av, _AV_COLOUR)
        if not self._followed:
            view = gui.getIDList()[0]
            x, y = vehicle.getPosition(self._av)
            gui.setBoundary(view, x - _RADIUS_M, y - _RADIUS_M, x + _RADIUS_M, y + _RADIUS_M)
            gui.trackVehicle(view, self._av)
            if gui.getSchema(view) == "standard":  # the user's configuration chose no other
                gui.setSchema(view, "real world")
            self._followed = True
