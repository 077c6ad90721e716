"""What happened to a running simulation: ``attacks.jsonl``, ``session.json``, a result folder."""

import json
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import deepmf_sumo
from deepmf_sumo import files
from deepmf_sumo.benchmark import store
from deepmf_sumo.benchmark.live.results import Results, Stage
from deepmf_sumo.datatypes import AgentId, Contact, Event
from deepmf_sumo.live.session import Fought
from deepmf_sumo.spec import Spec

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
            store.check(out, resume=False, overwrite=overwrite, ways=ways)

    def begin(self, stage: Stage) -> None:
        """The session begins; only now earlier results in the folder are deleted.

        Raises OutputError as the class.
        """
        if self._out is not None:
            self._held.enter_context(
                store.opened(self._out, resume=False, overwrite=self._overwrite, ways=self._ways)
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
