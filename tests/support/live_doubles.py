"""A policy that needs no networks, and sessions on the tiny network."""

import subprocess
from pathlib import Path

import numpy as np
import sumo

from deepmf_sumo.live.connection import shared
from deepmf_sumo.live.engagement import LiveRoad, Scenery
from deepmf_sumo.live.observer import LiveObserver
from deepmf_sumo.live.session import Session
from deepmf_sumo.live.triggers import Trigger
from deepmf_sumo.scene import Plan, TurnRules

OPTIONS = ("--no-step-log", "--no-warnings", "--collision.action", "none")


class Brake:
    """The leader brakes for two seconds, ``sideways`` off its lane; or nobody can."""

    period_steps = None

    def __init__(self, sideways=0.0, opponent="leader", brake_mps2=3.0):
        self.sideways, self.opponent, self.brake_mps2 = sideways, opponent, brake_mps2
        self.views = []

    def reset(self, view, rng):
        self.views.append(view)
        return (self.opponent,) if self.opponent in view.history.ids else ()

    def plan(self, view):
        row = view.history.row(self.opponent)
        x, y = view.history.position_m[row, -1]
        braked = self.brake_mps2 * 0.1 * np.arange(1, 21)
        speed = np.maximum(view.history.speed_mps[row, -1] - braked, 0.0)
        return {
            self.opponent: Plan(
                agent_id=self.opponent,
                first_step=view.step + 1,
                position_m=np.column_stack(
                    [x + np.cumsum(speed) * 0.1, y + self.sideways * np.linspace(0.05, 1, 20)]
                ),
                heading_rad=np.zeros(20),
                speed_mps=speed,
            )
        }


def session_on(
    api,
    folder,
    policy,
    *,
    triggers=None,
    pause_s=5.0,
    rules=None,
    av="av",
    net="tiny.net.xml",
):
    """A session, and the list in which its attacks will be."""
    fought = []
    live = shared(api)
    scenery = Scenery(
        api=live,
        av_id=av,
        observer=LiveObserver(live, av, 80.0),
        surroundings=LiveRoad(live, folder / net, ()),
        rules=rules or TurnRules(longest_s=5.0),
        pause_s=pause_s,
    )
    triggers = (Trigger(),) if triggers is None else triggers
    rng = np.random.default_rng(0)
    return Session(scenery, policy, triggers, rng, fought.append), fought


def step(api, session, count):
    """Steps as a script does them."""
    for _ in range(count):
        session.before_step()
        api.simulationStep()
        session.after_step()


def started(folder: Path, port: int, *more: str, clients: int = 2) -> subprocess.Popen:
    """SUMO on a port."""
    return subprocess.Popen(
        [Path(sumo.SUMO_HOME) / "bin" / "sumo", "-c", "tiny.sumocfg", *OPTIONS,
         "--step-length", "0.1",
         "--remote-port", str(port), "--num-clients", str(clients), *more],
        cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
