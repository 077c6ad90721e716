"""One episode: the loop over SUMO."""

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Literal

import numpy as np

from deepmf_sumo.datatypes import DT_S, Case, Floats, RecordedCase, Rollout, View
from deepmf_sumo.planners._checked import Guard
from deepmf_sumo.planners.base import FixedPlanner, Planner
from deepmf_sumo.policies.base import Policy
from deepmf_sumo.simulation import log_only, world
from deepmf_sumo.simulation.attack_schedule import Turns
from deepmf_sumo.simulation.contacts import Judge
from deepmf_sumo.simulation.frame import Frame
from deepmf_sumo.simulation.recorder import Recorder
from deepmf_sumo.simulation.sumo_api import Backend
from deepmf_sumo.simulation.world import Stage


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
        case: who is the AV, from when, for how long, who drives the others.
        planner: drives the AV.
        policy: drives one opponent of its choice, or one after another; None attacks nobody.
        rng: for planner and policy; SUMO's own seed is the case's.
        gui: show the episode in sumo-gui.
        backend: how SUMO is run; by default libsumo, or sumo-gui where ``gui``, or not at all where
            nothing would react to the opponent (`log_only`).

    Raises SimulationError where SUMO refuses something or the AV is not there, PlannerError where
    the planner does not do its part.
    """
    with closing(Guard(planner)) as guarded:
        guarded.reset(case, rng)
        if (
            backend is None
            and not gui
            and case.turns is None
            and isinstance(planner, FixedPlanner)
            and isinstance(case, RecordedCase)
            and case.traffic == "log"
        ):
            return log_only.episode(case, planner, policy, rng)
        with world.opened(case, guarded.model, backend or ("gui" if gui else "libsumo")) as stage:
            return _episode(case, stage, guarded, policy, rng)


def _episode(
    case: Case, stage: Stage, planner: Planner, policy: Policy | None, rng: np.random.Generator
) -> Rollout:
    seconds: dict[str, float] = defaultdict(float)
    recorder, frame = _recorded(stage, case.duration_steps)
    now, end = recorder.step, recorder.step + case.duration_steps

    def look(path: Floats | None = None) -> View:
        left = end - recorder.step
        return recorder.view(case.av_id, case.road, stage.signals(), left, path)

    with _timed(seconds, "policy"):
        attack = Turns(policy, look(), rng, case.turns)
    judge = Judge(case.av_id, attack.attacker)
    judge.look(now, frame, recorder.sizes_m(frame.ids))
    ended: Literal["time", "contact", "av_gone"] = "time"
    leaders, lights = [], []
    while recorder.step < end:
        if attack.due(recorder.step):
            with _timed(seconds, "policy"):
                attack.replan(look())
        if attack.attacker != judge.opponent_id:
            judge.turn_to(attack.attacker, recorder.step, frame, recorder.sizes_m(frame.ids))
        with _timed(seconds, "planner"):
            view = look(stage.av_path())
            command = planner.act(view)
        with _timed(seconds, "simulation"):
            pose = attack.pose(recorder.step + 1)
            frame = stage.advance(command, attack.id, pose)
            recorder.add(frame)
            size_m = recorder.sizes_m(frame.ids)
            judge.look(recorder.step, frame, size_m)
        leaders.append(stage.av_leaders())
        lights.append(view.signals)
        if attack.after_step(recorder.step, frame, size_m, hit=judge.hit(recorder.step)):
            ended = "contact"
            break
        if not stage.av_present():
            ended = "av_gone"
            break
    attack.finish(recorder.step, ended)
    tracks, driver = recorder.tracks()
    events = [*stage.events, *attack.events, *judge.events]
    return Rollout(
        tracks=tracks,
        driver=driver,
        now=now,
        dt_s=DT_S,
        av_id=case.av_id,
        opponent_id=attack.opponent_id,
        contacts=tuple(judge.contacts),
        events=tuple(sorted(events, key=lambda event: event.step)),
        plans=tuple(attack.plans),
        ended=ended,
        seconds=dict(seconds),
        leaders=tuple(leaders),
        signals=tuple(lights),
        turns=attack.closed,
    )


def _recorded(stage: Stage, steps: int) -> tuple[Recorder, Frame]:
    """What was before, with room for so many more steps, and the last frame of it."""
    history = stage.history()
    recorder = Recorder(len(history) + steps, stage.body)
    for frame in history:
        recorder.add(frame)
    return recorder, history[-1]


@contextmanager
def _timed(seconds: dict[str, float], part: str) -> Iterator[None]:
    begin = time.perf_counter()
    try:
        yield
    finally:
        seconds[part] += time.perf_counter() - begin
