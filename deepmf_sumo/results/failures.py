"""What went wrong in a run, in the words of traffic safety; and what is wrong with a planner.

A failure is a hit of the opponent, or an error of the planner: one that crashed, hung, or answered
nonsense. A hit is described in the words of `judge.hits`.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Final, Literal

from deepmf_sumo.errors import DeepmfError
from deepmf_sumo.judge.conflict_types import ConflictType, Side, Who
from deepmf_sumo.judge.hits import Action, Hit, described
from deepmf_sumo.results import stored
from deepmf_sumo.results.findings import Worth, cause_of
from deepmf_sumo.results.reader import Results, Run
from deepmf_sumo.scene import RoadMap, Rollout

Kind = Literal[
    "hit", "planner crashed", "planner hung", "planner answered nonsense", "run timed out"
]  # fmt: skip
_PLANNER: Final = "planner_error:"
_FAULTS: Final[dict[str, Kind]] = {
    "crashed": "planner crashed",
    "hung": "planner hung",
    "nonsense": "planner answered nonsense",
}
_HUNG: Final = re.compile(r"did not answer .* within \S+ s\.$")
_CRASHED: Final = re.compile(r"ended its process|before it answered|\(see log\.txt\)")
"""The words of errors in results of earlier versions, which do not name the fault."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """A run that failed. Of planner errors only ``run``, ``kind`` and ``reason`` say something.

    What is not listed here is that of the hit, see `judge.hits.Hit`.

    Attributes:
        reason: what the planner did wrong.
        worth: what the hit is worth, and who avoids it from the onset on; None: not known.
        ordinary_mps2: rms acceleration of the opponent; None where it is not known.
        reasons, av_error, opponent_error: of the hit, see `judge.ladder.Verdict`; empty in results
            of versions without a ladder.
        cause: of a finding, see `findings.cause_of`; None where it is none.
        change, what, last_moment_s: of a finding, see `judge.causes.Cause`; empty where it is none.
    """

    run: Run
    kind: Kind
    reason: str = ""
    conflict: ConflictType | None = None
    side: Side | None = None
    priority: Who = ""
    turned: Who = ""
    strayed: bool = False
    action: Action | None = None
    late: bool = False
    braking_mps2: float = 0.0
    onset_s: float | None = None
    worth: Worth | None = None
    delta_v_mps: float = 0.0
    ordinary_mps2: float | None = None
    opponent: str = "car"
    ran_red: bool = False
    stood: bool = False
    person: bool = False
    emerged: str = ""
    on_crossing: bool = False
    reasons: tuple[str, ...] = ()
    av_error: str = ""
    opponent_error: str = ""
    cause: tuple[str, ...] | None = None
    change: str = ""
    what: str = ""
    last_moment_s: Mapping[str, float | None] = field(default_factory=dict)

    @property
    def last_moment(self) -> tuple[str, float] | None:
        """The driver that could take over last and avoid the hit, and how long before it.

        The search, which needs no time to react, only where no reference driver could.
        """
        known = [(at, name) for name, at in self.last_moment_s.items() if at is not None]
        drivers = [one for one in known if one[1] != "search"]
        return min(drivers or known)[::-1] if known else None


def failures(results: Results) -> Iterator[tuple[Run, Failure | None, str]]:
    """Each run with its failure, or None; and why a hit could not be described."""
    for run in results.runs:
        try:
            yield run, failure_of(run), ""
        except stored.DAMAGE as error:
            yield run, None, f"{type(error).__name__}: {error}"


def failure_of(run: Run, road: RoadMap | None = None) -> Failure | None:
    """What went wrong in a run; None where nothing did.

    ``road``: its map, where it is known already. Raises `stored.DAMAGE`.
    """
    if run.status in {"failed", "timeout"}:
        return _of_planner(run)
    if run.status != "ok" or not run.hit:
        return None
    rollout = run.rollout
    if rollout.first("av_opponent") is None:
        return None
    if road is None:
        try:
            road = run.road()[0]
        except DeepmfError:
            road = None
    return _of_hit(run, rollout, road)


def _of_planner(run: Run) -> Failure | None:
    """A planner's error, or a run out of time: by the planner, the attack or a slow machine."""
    error = run.row.get("error", "")
    if run.status == "timeout":
        return Failure(run=run, kind="run timed out", reason=f"it took {error}")
    reason = error.removeprefix(_PLANNER).strip()
    fault = run.result.get("planner_fault") if run.has_result else None
    if fault is None and error.startswith(_PLANNER):
        fault = "nonsense"
        if _CRASHED.search(reason):
            fault = "crashed"
        elif _HUNG.search(reason):
            fault = "hung"
    return Failure(run=run, kind=_FAULTS[fault], reason=reason) if fault in _FAULTS else None


def _of_hit(run: Run, rollout: Rollout, road: RoadMap | None) -> Failure:
    red = bool(run.metric("red_light"))
    hit = described(rollout, road, run.unattacked(), begin=_begin(run, rollout), ran_red=red)
    return Failure(
        run=run,
        kind="hit",
        worth=run.worth,
        ordinary_mps2=run.metric("opponent_rms_acceleration"),
        cause=cause_of(run.result, hit.conflict),
        **_judged(run),
        **{name: getattr(hit, name) for name in _of_the_hit()},
    )


def _judged(run: Run) -> dict[str, Any]:
    """What the result says of errors and cause."""
    verdict, cause = run.result.get("finding") or {}, run.result.get("cause") or {}
    found = {name: cause[name] for name in ("change", "what", "last_moment_s") if cause}
    if verdict:
        found |= {name: verdict[name] for name in ("av_error", "opponent_error")}
        found["reasons"] = tuple(verdict["reasons"])
    return found


def _of_the_hit() -> set[str]:
    """Names of what a failure says of its hit."""
    return {one.name for one in fields(Hit)} & {one.name for one in fields(Failure)}


def _begin(run: Run, rollout: Rollout) -> int:
    """Step at which the attack that hit began: of opponents in turn that of its turn."""
    turns = run.result["turns"] or []
    hit = next((one for one in turns if one["ended"] == "contact"), None)
    return rollout.now + (round(hit["begin_s"] / rollout.dt_s) if hit else 0)
