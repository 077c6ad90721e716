"""What happened to a running simulation: ``attacks.jsonl``, ``session.json``, a result folder.

Live attacks as a result folder, which `table`, `risk`, `report`, `check` and `compare` read.

What a run of ours knows and a live attack does not (the planner and its settings, the lights, whom
it followed) is empty, or a metric with the reason why it has no value.
"""

import json
import os
import shutil
import time
import traceback
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import deepmf_sumo
from deepmf_sumo import files
from deepmf_sumo.datatypes import DT_S, AgentId, Attack, Contact, Event, RoadMap, TrafficCase
from deepmf_sumo.errors import RunError
from deepmf_sumo.live.session import Fought
from deepmf_sumo.metrics import measure
from deepmf_sumo.results import artifacts, folder, result
from deepmf_sumo.results.folder import Store
from deepmf_sumo.results.result import Result
from deepmf_sumo.results.tracks import write_tracks
from deepmf_sumo.spec import Spec
from deepmf_sumo.tasks import Task


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
        write_tracks(folder / "tracks.csv.gz", fought.rollout)
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


FORMAT_VERSION: Final = 1
WAYS: Final = "--overwrite deletes them, another folder for --out keeps them"


class Record:
    """The attacks of a session; the files are whole after each of them.

    Args:
        out: the folder; None writes nothing.
        av: who is attacked.
        spec: with which settings.
        overwrite: delete the results of an earlier command in the folder.
        ways: what can be done about them, for the message.

    Raises OutputError where the folder cannot be written, is in use, or holds something else, or
    earlier results without ``overwrite``.
    """

    def __init__(
        self,
        out: Path | None,
        av: AgentId,
        spec: Spec,
        *,
        overwrite: bool = False,
        ways: str = WAYS,
    ) -> None:
        self.rows: list[dict[str, Any]] = []
        self._out, self._spec = out, spec
        self._overwrite, self._ways = overwrite, ways
        self._results: Results | None = None
        self._held = ExitStack()
        self._about = {
            "format_version": FORMAT_VERSION,
            "tool": "deepmf-sumo",
            "version": deepmf_sumo.__version__,
            "av": av,
            "adversary": spec.adversary.model_dump(mode="json"),
            "weights": spec.weights,
            "seed": spec.seed,
        }
        if out is not None:
            folder.check(out, resume=False, overwrite=overwrite, ways=ways)

    def begin(self, stage: Stage) -> None:
        """The session begins; only now earlier results in the folder are deleted.

        Raises OutputError as the class.
        """
        if self._out is not None:
            self._held.enter_context(
                folder.opened(self._out, resume=False, overwrite=self._overwrite, ways=self._ways)
            )
            self._results = Results(self._out, self._spec, stage)
            self._write("going on", None)

    def add(self, fought: Fought) -> None:
        """An attack that is over."""
        self.rows.append(row(fought))
        if self._out is None or self._results is None:
            return
        lines = [json.dumps(one, sort_keys=True, ensure_ascii=False) for one in self.rows]
        files.write(self._out / "attacks.jsonl", "".join(f"{line}\n" for line in lines))
        self._write("going on", fought.end_s)
        self._results.add(fought)

    def finish(self, end: str, time_s: float) -> None:
        """The session is over."""
        if self._out is not None:
            self._write(end, time_s)
        self._held.close()

    def _write(self, end: str, time_s: float | None) -> None:
        assert self._out is not None
        values = {**self._about, "ended": end, "time_s": time_s, "attacks": len(self.rows)}
        files.write_json(self._out / "session.json", values)


def row(fought: Fought) -> dict[str, Any]:
    """One attack as plain values; times are the simulation's."""
    rollout = fought.rollout
    contact = rollout.first("av_opponent")
    plans = [plan.reason for plan in rollout.plans if plan.reason]
    turn = rollout.turns[0]
    return {
        "number": fought.number,
        "opponent": rollout.opponent_id,
        "begin_s": round(fought.begin_s, 3),
        "end_s": round(fought.end_s, 3),
        "ended": rollout.ended,
        "contact": None if contact is None else _contact(contact, fought),
        "min_gap_m": round(turn.gap_m, 3),
        "others_touched": sorted(
            {one.second_id for one in rollout.contacts if one.kind == "opponent_other"}
        ),
        "av_touched": sorted({one.second_id for one in rollout.contacts if one.kind == "av_other"}),
        "plans": len(plans),
        "plan_ms": [round(sum(one.milliseconds.values()), 1) for one in plans],
        "events": [_event(fought, one) for one in rollout.events],
    }


def _contact(contact: Contact, fought: Fought) -> dict[str, Any]:
    return {
        "time_s": round(_time(fought, contact.step), 3),
        "relative_mps": round(contact.relative_mps, 3),
        "delta_v_mps": round(contact.delta_v_mps, 3),
        "sector": contact.sector,
        "striker": contact.striker_id,
    }


def _event(fought: Fought, event: Event) -> dict[str, Any]:
    values = asdict(event)
    return {"time_s": round(_time(fought, values.pop("step")), 3), **values}


def _time(fought: Fought, step: int) -> float:
    return fought.begin_s + (step - fought.rollout.now) * fought.rollout.dt_s
