"""The files of a live session: ``attacks.jsonl``, ``session.json``, and a result folder.

`table`, `risk`, `report`, `check` and `compare` read the result folder. What only a run of its own
knows (the planner and its settings, the vehicles that the AV followed) is empty, or a metric with
the reason why it has no value.
"""

import json
import math
import os
import shutil
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import deepmf_sumo
from deepmf_sumo import files, plugins
from deepmf_sumo.errors import RunError
from deepmf_sumo.exporters import fcd
from deepmf_sumo.judge.metrics import Episode, measure, measured
from deepmf_sumo.live.session import LiveAttack, Switch, TimeJump
from deepmf_sumo.results import artifacts, folder, result, sessions, signals, stored, turns
from deepmf_sumo.results.folder import Store
from deepmf_sumo.results.result import Result
from deepmf_sumo.results.tracks import FILE as TRACKS
from deepmf_sumo.results.tracks import write_tracks
from deepmf_sumo.scene import DT_S, AgentId, Attack, Contact, Event, RoadMap, TrafficCase
from deepmf_sumo.scene.rollout import decisive
from deepmf_sumo.spec import Spec, profiles
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.sumo.network import mapping


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """Where live attacks take place.

    Attributes:
        net: the file of the network. road: its map. longest_s: maximum duration of an attack.
        planner: what drives the AV: ``script``, of which nothing is known here, or ``sumo`` if
            there is no other client.
    """

    net: Path
    road: RoadMap
    longest_s: float
    planner: str = "script"

    @property
    def name(self) -> str:
        """The name of the network's file without suffixes."""
        return self.net.name.removesuffix(".gz").removesuffix(".xml").removesuffix(".net")


class SessionResults:
    """The result folder ``out``, complete after each attack."""

    def __init__(self, out: Path, spec: Spec, setting: Setting) -> None:
        self._store, self._spec = Store(out), spec
        self._keys: dict[str, str] = {}
        self._nets: dict[tuple[Path, int, int], Path] = {}
        self._simulations = 0
        self.move_to(setting)
        self._found: list[Result] = []
        self._store.runs.mkdir(exist_ok=True)
        self._write()

    def move_to(self, setting: Setting) -> None:
        """The attacks from now on take place there, in another simulation."""
        self._setting = setting
        self._simulations += 1
        about = setting.net.stat()  # a file of the same name may be another one
        self._net = setting.net, about.st_mtime_ns, about.st_size

    def add(self, attack: LiveAttack) -> None:
        """Measure an attack, and write its folder and the tables."""
        run_id = f"attack-{len(self._found) + 1:03d}"
        folder = self._store.runs / run_id
        (folder / "sumo").mkdir(parents=True, exist_ok=True)
        write_tracks(folder / TRACKS, attack.rollout)
        signals.write_signals(folder / signals.FILE, attack.rollout, self._setting.road)
        artifacts.write_plans(folder / artifacts.PLANS, attack.rollout)
        self._keep_net(folder / "sumo")
        self._keep_map(folder / "sumo")
        scene = f"{attack.rollout.av_id}-{attack.begin_s:.12g}s"
        if self._simulations > 1:  # of another traffic, perhaps
            scene = f"{self._simulations}-{scene}"
        task = Task(run_id=run_id, spec=self._spec, scene=scene)
        found = self._measured(task, attack, folder)
        files.write_json(folder / stored.RESULT, found)
        self._keys[run_id] = task.key
        self._found.append(found)
        self._write()

    def _write(self) -> None:
        self._store.manifest(self._keys, {})
        self._store.finish(self._found, junit_too=False, interrupted=False)

    def _measured(self, task: Task, attack: LiveAttack, folder: Path) -> Result:
        """The row of the attack; one that cannot be measured has the reason instead."""
        begin = time.perf_counter()
        try:
            found = _finished(task, attack, self._setting, folder)
        except Exception as error:  # noqa: BLE001 - it must not end the user's simulation
            traceback.print_exc()
            reason = f"not measured: {type(error).__name__}: {error}"
            found = result.unfinished(task, "failed", reason, time.perf_counter() - begin)
        found["settings"]["planner"] = {}
        return {
            **found,
            "network": self._setting.name,
            "planner": self._setting.planner,
            "planner_label": self._setting.planner,
            "perception": None,
            "parameters": None,
            "expectations_broken": [],
        }

    def _keep_net(self, folder: Path) -> None:
        """Link the network into the folder of each run; only the first on it has a copy."""
        net = self._setting.net
        kept = folder / f"net.net.xml{'.gz' * (net.suffix == '.gz')}"
        if self._net in self._nets:
            with suppress(OSError):  # a file system without hard links
                os.link(self._nets[self._net], kept)
                return
        shutil.copyfile(net, kept)
        self._nets[self._net] = kept

    def _keep_map(self, folder: Path) -> None:
        """Buildings and water beside the network, which hide people and keep them away."""
        if shapes := mapping.beside(self._setting.road):
            mapping.write_additional(shapes, folder / fcd.MAP)


def _finished(task: Task, attack: LiveAttack, setting: Setting, folder: Path) -> Result:
    begin = time.perf_counter()
    rollout = attack.rollout
    if len(rollout.turns) == 1:
        rollout = replace(rollout, turns=())  # an attack of its own
    case = TrafficCase(
        name=task.run_id,
        road=setting.road,
        av_id=rollout.av_id,
        duration_steps=round(setting.longest_s / DT_S),
        seed=task.spec.seed,
        config=setting.net,
        start_s=attack.begin_s,
        net_file=setting.net,
    )
    spent = [sum(one.reason.milliseconds.values()) for one in rollout.plans if one.reason]
    found_attack = Attack(rollout=rollout, generation_s=sum(spent) / 1000)
    decisive_part = turns.decisive_part(rollout, case)
    episode = Episode(*decisive_part)
    values, by_turn = measured(episode), turns.judged(rollout, case, measure)
    artifacts.write_unattacked(folder, *decisive_part)
    wall_s = time.perf_counter() - begin
    found = result.finished(task, case, found_attack, values, wall_s, by_turn, episode)
    found["timings"]["simulation_s"] = None  # another program ran SUMO
    found["search"]["simulations"] = 0
    wrong = result.not_finite(found)
    if wrong:
        raise RunError(f"{wrong} is not a finite number")
    return found


FORMAT_VERSION: Final = 2
SUMO_FILES: Final = "sumo"
"""Folder of what SUMO itself has written under `serve`."""
WAYS: Final = "--overwrite deletes them, another folder for --out keeps them"


class SessionRecord:
    """The attacks of a session, or of one after the other in another simulation each.

    The files are complete after each attack, and after each switch of attacks.

    Args:
        out: the folder; None writes nothing.
        avs: the attacked vehicles.
        spec: the settings of the attacks.
        overwrite: delete the results of an earlier command in the folder.
        ways: what the user can do about them, for the message.

    Attributes:
        rows: the attacks. switches: when new attacks were turned off and on, as in
            ``session.json``. switched: called with each of them; may be replaced.
        jumps: of SUMO's time. jumped: called with each of them; may be replaced.
        client_step_s: of the client of `serve`, where SUMO steps by 0.1 s in its place.

    Raises OutputError if the folder cannot be written, is in use, or contains something else, or
    earlier results without ``overwrite``.
    """

    def __init__(
        self,
        out: Path | None,
        avs: Sequence[AgentId],
        spec: Spec,
        *,
        overwrite: bool = False,
        ways: str = WAYS,
    ) -> None:
        self.rows: list[dict[str, Any]] = []
        self.switches: list[dict[str, Any]] = []
        self.jumps: list[dict[str, Any]] = []
        self.jumped: Callable[[dict[str, Any]], None] = lambda _: None
        self.switched: Callable[[dict[str, Any]], None] = lambda _: None
        self.client_step_s: float | None = None
        self.simulations = 0
        self._now: tuple[str, float | None] = ("going on", None)
        self._writing = threading.Lock()
        self._out, self._spec = out, spec
        self._overwrite, self._ways = overwrite, ways
        self._results: SessionResults | None = None
        self._held = ExitStack()
        choice = spec.adversary
        settings = plugins.settings("adversaries", choice.name, choice.settings)
        constraints = sorted(settings.constrained - {"sector"})
        self.profile = profiles.described(spec.profile, constraints)
        self._about = {
            "format_version": FORMAT_VERSION,
            "tool": "deepmf-sumo",
            "version": deepmf_sumo.__version__,
            "avs": list(avs),
            "profile": spec.profile,
            "constraints": constraints,
            "adversary": spec.adversary.model_dump(mode="json"),
            "weights": spec.weights,
            "seed": spec.seed,
        }
        if out is not None:
            folder.check(out, resume=False, overwrite=overwrite, ways=ways)

    def begin(self, setting: Setting) -> None:
        """Start a session; only with the first one earlier results in the folder are deleted.

        Raises OutputError as the class.
        """
        self.simulations += 1
        if self._results is not None:
            self._results.move_to(setting)
        elif self._out is not None:
            self._held.enter_context(
                folder.opened(self._out, resume=False, overwrite=self._overwrite, ways=self._ways)
            )
            self._results = SessionResults(self._out, self._spec, setting)
        if self._out is not None:
            self._write("going on", None)

    def add(self, attack: LiveAttack) -> None:
        """Add an attack that is over."""
        self.rows.append(row(attack, len(self.rows) + 1, self.simulations))
        if self._out is None or self._results is None:
            return
        lines = [json.dumps(one, sort_keys=True, ensure_ascii=False) for one in self.rows]
        files.write(self._out / "attacks.jsonl", "".join(f"{line}\n" for line in lines))
        self._write("going on", attack.end_s)
        self._results.add(attack)

    def switch(self, change: Switch) -> None:
        """Note that new attacks were turned on or off. Called from any thread."""
        values = {
            "simulation": self.simulations,
            "av": change.av,
            "time_s": round(change.time_s, 3),
            "new_attacks": "on" if change.on else "off",
            "door": change.door,
        }
        self.switches.append(values)
        if self._out is not None and self._results is not None:
            self._write(*self._now)
        self.switched(values)

    def jump(self, jump: TimeJump) -> None:
        """Note that SUMO's time jumped."""
        values = {
            "simulation": self.simulations,
            "from_s": round(jump.from_s, 3),
            "to_s": round(jump.to_s, 3),
            "attacks": len(self.rows),
        }
        self.jumps.append(values)
        if self._out is not None and self._results is not None:
            self._write(*self._now)
        self.jumped(values)

    def finish(self, end: str, time_s: float) -> None:
        """End the session."""
        if self._out is not None and self._results is not None:
            self._write(end, time_s)

    @contextmanager
    def written_by_sumo(self) -> Iterator[Path]:
        """An empty folder for what SUMO writes, which comes into the results as ``sumo``."""
        with tempfile.TemporaryDirectory(prefix="deepmf-sumo-") as folder:
            try:
                yield Path(folder)
            finally:
                if self._out is not None and self._results is not None and any(os.scandir(folder)):
                    shutil.copytree(folder, self._out / SUMO_FILES, dirs_exist_ok=True)

    def close(self) -> None:
        """Give the folder free: no other session follows."""
        self._held.close()

    def _write(self, end: str, time_s: float | None) -> None:
        assert self._out is not None
        with self._writing:
            self._now = end, time_s
            values = {
                **self._about,
                "ended": end,
                "time_s": time_s,
                "attacks": len(self.rows),
                "simulations": self.simulations,
                "client_step_s": self.client_step_s,
                "switches": self.switches,
                "jumps": self.jumps,
            }
            files.write_json(self._out / sessions.FILE, values)


def row(attack: LiveAttack, number: int, simulation: int) -> dict[str, Any]:
    """One attack as plain values; times are those of the simulation of this number.

    ``min_gap_m`` is None where the two were never there together.
    """
    rollout = attack.rollout
    contact = rollout.first("av_opponent")
    plans = [plan.reason for plan in rollout.plans if plan.reason]
    turn = decisive(rollout.turns)
    assert turn is not None
    return {
        "number": number,
        "simulation": simulation,
        "av": rollout.av_id,
        "opponent": rollout.opponent_id,
        "begin_s": round(attack.begin_s, 3),
        "end_s": round(attack.end_s, 3),
        "ended": rollout.ended,
        "contact": None if contact is None else _contact(contact, attack),
        "min_gap_m": round(turn.gap_m, 3) if math.isfinite(turn.gap_m) else None,
        "others_touched": sorted(
            {one.second_id for one in rollout.contacts if one.kind == "opponent_other"}
        ),
        "av_touched": sorted({one.second_id for one in rollout.contacts if one.kind == "av_other"}),
        "plans": len(plans),
        "plan_ms": [round(sum(one.milliseconds.values()), 1) for one in plans],
        "events": [_event(attack, one) for one in rollout.events],
    }


def _contact(contact: Contact, attack: LiveAttack) -> dict[str, Any]:
    return {
        "time_s": round(_time(attack, contact.step), 3),
        "relative_mps": round(contact.relative_mps, 3),
        "delta_v_mps": round(contact.delta_v_mps, 3),
        "sector": contact.sector,
        "striker": contact.striker_id,
    }


def _event(attack: LiveAttack, event: Event) -> dict[str, Any]:
    values = asdict(event)
    return {"time_s": round(_time(attack, values.pop("step")), 3), **values}


def _time(attack: LiveAttack, step: int) -> float:
    return attack.begin_s + (step - attack.rollout.now) * attack.rollout.dt_s
