"""Live attacks as a result folder, which `table`, `risk`, `report`, `check` and `compare` read.

What a run of ours knows and a live attack does not (the planner and its settings, the lights, whom
it followed) is empty, or a metric with the reason why it has no value.
"""

import os
import shutil
import time
import traceback
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from deepmf_sumo import files
from deepmf_sumo.benchmark import artifacts, result
from deepmf_sumo.benchmark.result import Result
from deepmf_sumo.benchmark.store import Store
from deepmf_sumo.benchmark.tasks import Task
from deepmf_sumo.datatypes import DT_S, Attack, RoadMap, TrafficCase
from deepmf_sumo.errors import RunError
from deepmf_sumo.live.session import Fought
from deepmf_sumo.metrics import measure
from deepmf_sumo.spec import Spec


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """Where live attacks take place.

    Attributes:
        net: the network's file. road: its map. longest_s: how long an attack may last.
        planner: who drives the AV: ``script``, of which nothing is known here, or ``sumo`` where
            there is no other client.
    """

    net: Path
    road: RoadMap
    longest_s: float
    planner: str = "script"

    @property
    def name(self) -> str:
        """Of the network, without suffixes."""
        return self.net.name.removesuffix(".gz").removesuffix(".xml").removesuffix(".net")


class Results:
    """The folder ``out``, whole after each attack."""

    def __init__(self, out: Path, spec: Spec, stage: Stage) -> None:
        self._store, self._spec, self._stage = Store(out), spec, stage
        self._keys: dict[str, str] = {}
        self._found: list[Result] = []
        self._store.runs.mkdir(exist_ok=True)
        self._write()

    def add(self, fought: Fought) -> None:
        """Measure an attack, and write its folder and the tables."""
        run_id = f"attack-{fought.number:03d}"
        folder = self._store.runs / run_id
        (folder / "sumo").mkdir(parents=True, exist_ok=True)
        artifacts.write_tracks(folder / "tracks.csv.gz", fought.rollout)
        artifacts.write_plans(folder / "plans.npz", fought.rollout)
        self._keep_net(folder / "sumo")
        scene = f"{fought.rollout.av_id}-{fought.begin_s:g}s"
        task = Task(run_id=run_id, spec=self._spec, scene=scene)
        found = self._measured(task, fought)
        files.write_json(folder / "result.json", found)
        self._keys[run_id] = task.key
        self._found.append(found)
        self._write()

    def _write(self) -> None:
        self._store.manifest(self._keys, {})
        self._store.finish(self._found, junit_too=False, interrupted=False)

    def _measured(self, task: Task, fought: Fought) -> Result:
        """The row; one that cannot be measured says why, and the session goes on."""
        begin = time.perf_counter()
        try:
            found = _finished(task, fought, self._stage, begin)
        except Exception as error:  # noqa: BLE001 - somebody else's simulation is not to end by it
            traceback.print_exc()
            reason = f"not measured: {type(error).__name__}: {error}"
            found = result.unfinished(task, "failed", reason, time.perf_counter() - begin)
        found["settings"]["planner"] = {}
        return {
            **found,
            "network": self._stage.name,
            "planner": self._stage.planner,
            "planner_label": self._stage.planner,
            "perception": None,
            "parameters": None,
            "expectations_broken": [],
        }

    def _keep_net(self, folder: Path) -> None:
        """The network belongs to each run's folder; it is there once, under many names."""
        net = self._stage.net
        kept = folder / f"net.net.xml{'.gz' * (net.suffix == '.gz')}"
        first = self._store.runs / "attack-001" / "sumo" / kept.name
        with suppress(OSError):  # a file system without hard links, or the first one
            os.link(first, kept)
            return
        shutil.copyfile(net, kept)


def _finished(task: Task, fought: Fought, stage: Stage, begin: float) -> Result:
    rollout = replace(fought.rollout, turns=())  # an attack of its own
    case = TrafficCase(
        name=task.run_id,
        road=stage.road,
        av_id=rollout.av_id,
        duration_steps=round(stage.longest_s / DT_S),
        seed=task.spec.seed,
        config=stage.net,
        start_s=fought.begin_s,
        net_file=stage.net,
    )
    spent = [sum(one.reason.milliseconds.values()) for one in rollout.plans if one.reason]
    attack = Attack(rollout=rollout, generation_s=sum(spent) / 1000)
    metrics = measure(rollout, case)
    found = result.finished(task, case, attack, metrics, time.perf_counter() - begin)
    found["timings"]["simulation_s"] = None  # SUMO was somebody else's
    found["search"]["simulations"] = 0
    wrong = result.not_finite(found)
    if wrong:
        raise RunError(f"{wrong} is not a finite number")
    return found


__all__ = ["Results", "Stage"]
