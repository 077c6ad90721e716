"""The search for the smallest reproducer: one thing after another, until nothing more helps.

Each candidate is simulated as `deepmf-sumo run` does it, and judged.
"""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from shutil import rmtree
from typing import Any, Final, Literal

import numpy as np

from deepmf_sumo import files
from deepmf_sumo.errors import RunError
from deepmf_sumo.files import cache_folder
from deepmf_sumo.results import findings, quantities, stored, tracks
from deepmf_sumo.results import result as result_module
from deepmf_sumo.results.findings import Worth
from deepmf_sumo.results.result import Result
from deepmf_sumo.scene import DT_S, AgentId, Floats, agent_ids
from deepmf_sumo.spec import Spec
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.study.shrink.candidate import (
    AFTER_STEPS,
    Candidate,
    changes_of_plan,
    path_of,
    spec_values,
    undisturbed_values,
)
from deepmf_sumo.study.shrink.failure import RecordedHit
from deepmf_sumo.study.sweep.episode import TaskRunner
from deepmf_sumo.study.sweep.limits import MEMORY_MB, TIMEOUT_S
from deepmf_sumo.study.sweep.workers import Worker


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CandidateTrial:
    """What a candidate's simulation showed.

    Attributes:
        candidate: what was tried. values: its spec.
        why: why the opponent did not hit the AV; empty where it did.
        contact: step of the contact, counted from the run's start.
        road_users: that were there up to the contact, with the AV.
        accident: metric ``accident_type``. worth: of the hit; None: not judged.
        feasible: the opponent drove within the limits of a car.
        contact_mps: relative speed at the contact.
        hardest_mps2: largest acceleration of the opponent from the begin to the contact.
        digest: of ``tracks.csv.gz``.
    """

    candidate: Candidate
    values: dict[str, Any]
    why: str = ""
    contact: int = 0
    road_users: int = 0
    accident: float | None = None
    worth: Worth | None = None
    feasible: bool = False
    contact_mps: float = np.inf
    hardest_mps2: float = np.inf
    digest: str = ""

    @property
    def hit(self) -> bool:
        """Whether the opponent hit the AV."""
        return not self.why

    @property
    def steps(self) -> int:
        """From begin to contact."""
        return self.contact - self.candidate.begin


class Simulator:
    """A worker process that does one run after another, until `close`."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="deepmf-sumo-shrink-")
        self._runs = Path(self._folder.name) / "runs"
        self._runs.mkdir()
        self._worker: Worker | None = None
        self.done = 0

    def close(self) -> None:
        """End the process, and remove what runs wrote."""
        self.renew()
        self._folder.cleanup()

    def renew(self) -> None:
        """Let a new process do the next run."""
        if self._worker is not None:
            self._worker.kill()
        self._worker = None

    @contextmanager
    def run(self, task: Task) -> Iterator[tuple[Result, Path]]:
        """The result of a run, and its folder, which is gone after the block."""
        self.done += 1
        if self._worker is None or not self._worker.alive:
            work = TaskRunner(runs=self._runs, cache=cache_folder(), sumo=False)
            self._worker = Worker(work, TIMEOUT_S, MEMORY_MB)
        ending = self._worker.do(task)
        folder = self._runs / task.run_id
        if ending.status == "done":
            yield stored.result_of(folder / stored.RESULT), folder
        else:
            yield result_module.unfinished(task, "failed", ending.reason), folder
        rmtree(folder, ignore_errors=True)


def task_of(failure: RecordedHit, values: dict[str, Any]) -> Task:
    """The run of a spec with the failure's scene."""
    return replace(failure.task, run_id="candidate", spec=Spec.model_validate(values))


def trial(
    simulator: Simulator, failure: RecordedHit, candidate: Candidate, values: dict[str, Any]
) -> CandidateTrial:
    """Simulate a candidate with a spec."""
    with simulator.run(task_of(failure, values)) as (result, folder):
        blank = CandidateTrial(candidate=candidate, values=values)
        if result["status"] != "ok":
            return replace(blank, why=result["error"] or result["status"])
        if result["outcome"] != "av_opponent":
            return replace(blank, why=f"no hit (outcome: {result['outcome']})")
        return _judged(blank, failure, result, folder)


def undisturbed(
    simulator: Simulator, failure: RecordedHit, values: dict[str, Any]
) -> tuple[Floats | None, str]:
    """(N, 3) poses of the opponent from the start on without an attack; or None, and why."""
    with simulator.run(task_of(failure, values)) as (result, folder):
        if result["status"] != "ok":
            return None, result["error"] or result["status"]
        found = tracks.read_tracks(folder / tracks.FILE, [failure.opponent])
        if failure.opponent not in found.tracks.ids:
            return None, f"'{failure.opponent}' is not there without the attack"
        row = found.tracks.row(failure.opponent)
        there = found.tracks.valid[row, found.now :]
        steps = len(there) if there.all() else int(there.argmin())
        shown = slice(found.now, found.now + steps)
        if not steps:
            return None, f"'{failure.opponent}' is not there at the start"
        poses = np.column_stack(
            [found.tracks.position_m[row, shown], found.tracks.heading_rad[row, shown]]
        )
        return poses, ""


def _judged(
    blank: CandidateTrial, failure: RecordedHit, result: Result, folder: Path
) -> CandidateTrial:
    file = folder / tracks.FILE
    found = tracks.read_tracks(file)
    hit = next(one for one in result["contacts"] if one["kind"] == "av_opponent")
    metrics = quantities.values(result)
    shown = slice(found.now, hit["step"] + 1)
    there = np.flatnonzero(found.tracks.valid[:, shown].any(axis=1))
    return replace(
        blank,
        contact=blank.candidate.begin + hit["step"] - found.now,
        road_users=len(agent_ids.wholes(found.tracks.ids[row] for row in there)),
        accident=metrics.get("accident_type"),
        worth=findings.worth(metrics),
        feasible=bool(metrics.get("feasible")),
        contact_mps=float(hit["relative_mps"]),
        hardest_mps2=_hardest(found, failure.opponent, hit["step"]),
        digest=files.sha256(file),
    )


def _hardest(found: tracks.RecordedTracks, agent: str, contact: int) -> float:
    """Largest acceleration of an agent after the current step, up to a step, in m/s2."""
    row = found.tracks.row(agent)
    first = max(found.now - 2 * _SPAN, int(found.tracks.valid[row].argmax()))
    position = found.tracks.position_m[row, first : contact + 1]
    if len(position) <= 2 * _SPAN:
        return 0.0
    second = position[2 * _SPAN :] - 2 * position[_SPAN:-_SPAN] + position[: -2 * _SPAN]
    return float(np.hypot(*second.T).max() / (_SPAN * DT_S) ** 2)


SearchEnd = Literal["nothing helps", "budget", "interrupted"]
SIMULATIONS: Final = 60
_LEAST_STEPS: Final = 10
"""From begin to contact: a shorter one would be no task for a planner."""
_FINE_STEPS: Final = 2
_MILDER_MPS2: Final = 0.1
_ROUNDED_MPS2: Final = 0.05
_FASTER_MPS: Final = 0.5
"""A contact may be faster than the first by at most this."""
"""What rounding of poses may add to an acceleration."""
_AVERAGED: Final = (10, 5, 2)
_SCALES: Final = (0.5, 0.7, 0.85, 0.95)
_SPAN: Final = 2
"""Steps on each side of a second difference, as in metrics of motion."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shrunk:
    """What was found.

    Attributes:
        failure: what it comes from. first: the run with a fixed trajectory, nothing made smaller.
        best: the smallest that fails in the same way.
        simulations: all that were done, the last check included.
        end: what ended the search.
        kept: what was left as it is, and why; empty where all could be tried.
    """

    failure: RecordedHit
    first: CandidateTrial
    best: CandidateTrial
    simulations: int
    end: SearchEnd
    kept: str = ""

    def changes(self) -> tuple[int, int]:
        """Changes of plan in the run, and in the reproducer."""
        whole = replace(self.first.candidate, contact=self.failure.contact)
        return (
            changes_of_plan(whole, self.failure),
            changes_of_plan(replace(self.best.candidate, contact=self.best.contact), self.failure),
        )


class _Spent(Exception):  # noqa: N818 - no error
    """The budget is spent."""


def shrink(
    failure: RecordedHit,
    simulations: int = SIMULATIONS,
    report: Callable[[str], None] = lambda _: None,
) -> Shrunk:
    """Find the smallest reproducer of a failure, and check it in a new process.

    An interrupt ends the search: the smallest so far is checked and returned; a second one, and one
    before the hit was repeated, is passed on.

    ``simulations``: maximum number, at least 3. ``report`` hears of each step that helped.

    Raises RunError where the run does not fail again with the recorded path, or a reproducer does
    not repeat byte for byte.
    """
    with closing(Simulator()) as simulator:
        search = _Shrinking(failure, simulator, max(simulations, 3) - 1, report)
        end = search.run()
        best = search.best
        simulator.renew()
        again = trial(simulator, failure, best.candidate, best.values)
        if again.digest != best.digest:
            raise RunError(
                f"{failure.run_id}: the reproducer gave another motion in a second simulation:"
                f" planner '{failure.planner}' does not repeat itself."
            )
        return Shrunk(
            failure=failure,
            first=search.first,
            best=best,
            simulations=simulator.done,
            end=end,
            kept=search.kept,
        )


class _Shrinking:
    """The best candidate so far, and the steps that try to make it smaller.

    ``first``: nothing is made smaller yet. ``kept``: what cannot be, and why.
    """

    def __init__(
        self,
        failure: RecordedHit,
        simulator: Simulator,
        budget: int,
        report: Callable[[str], None],
    ) -> None:
        self._failure, self._simulator = failure, simulator
        self._budget, self._report = budget, report
        self._tried: set[Candidate] = set()
        self._calm: Floats | None = None
        self.kept = ""
        self.first = self.best = self._repeated()

    def run(self) -> SearchEnd:
        """Make it smaller until nothing more helps, the budget is spent, or an interrupt comes."""
        try:
            self._learn_undisturbed()
            helped = True
            while helped:
                steps = (self._later, self._fewer_road_users, self._fewer_plans, self._milder)
                helped = sum(step() for step in steps) > 0  # each of them, in turn
        except _Spent:
            return "budget"
        except KeyboardInterrupt:
            return "interrupted"
        return "nothing helps"

    def _repeated(self) -> CandidateTrial:
        """The run with the recorded path, from its start, or from the opponent's turn."""
        failure, why = self._failure, ""
        whole = Candidate(
            last=failure.contact + AFTER_STEPS,
            contact=failure.contact,
            only=failure.spec.source.only,
            plans=len(failure.plans),
        )
        for begin in dict.fromkeys((0, failure.begin)):
            if begin:
                self._learn_undisturbed(always=True)
            found = self._simulated(replace(whole, begin=begin))
            if found.hit:
                return found
            why = why or found.why
        raise RunError(
            f"{failure.run_id} does not fail again when '{failure.opponent}' follows its recorded"
            f" path ({why}); it cannot be shrunk."
        )

    def _learn_undisturbed(self, *, always: bool = False) -> None:
        if self._calm is not None or self.kept:
            return
        if not always:
            self._count()
        found, why = undisturbed(self._simulator, self._failure, undisturbed_values(self._failure))
        self._calm = found
        if found is None:
            self.kept = f"begin and motion: no undisturbed motion is known ({why})"

    def _count(self) -> None:
        if self._simulator.done >= self._budget:
            raise _Spent

    def _simulated(self, candidate: Candidate) -> CandidateTrial:
        self._tried.add(candidate)
        path = path_of(candidate, self._failure, self._calm)
        values = spec_values(candidate, self._failure, path)
        return trial(self._simulator, self._failure, candidate, values)

    def _try(self, said: str, *, milder: bool = False, **changes: Any) -> bool:
        """Whether a candidate with changes fails in the same way; then it is the best."""
        candidate = replace(
            self.best.candidate,
            **{"last": self.best.contact + AFTER_STEPS, "contact": self.best.contact} | changes,
        )
        if candidate in self._tried:
            return False
        self._count()
        found = self._simulated(candidate)
        if not self._same(found) or (
            milder and found.hardest_mps2 > self.best.hardest_mps2 - _MILDER_MPS2
        ):
            return False
        self.best = found
        self._report(said)
        return True

    def _same(self, found: CandidateTrial) -> bool:
        """Whether it is the first trial's: of its kind, on its rung, no longer, no harder."""
        first = self.first
        return (
            found.hit
            and found.steps <= first.steps
            and found.accident == first.accident
            and _as_much(found.worth, first.worth)
            and found.feasible >= first.feasible
            and found.hardest_mps2 <= first.hardest_mps2 + _ROUNDED_MPS2
            and found.contact_mps <= first.contact_mps + _FASTER_MPS
        )

    def _later(self) -> bool:
        """Let it begin later: at the latest begin first, then half-way to it."""
        if self._calm is None:
            return False
        begun = self.best.candidate.begin
        begin = min(self.best.contact - _LEAST_STEPS, len(self._calm) - 1)
        too_late = begin + 1
        while begin - self.best.candidate.begin >= _FINE_STEPS:
            if not self._try(f"begins {begin * DT_S:.1f} s later", begin=begin):
                too_late = begin
            begin = (self.best.candidate.begin + too_late) // 2
        return self.best.candidate.begin > begun

    def _fewer_road_users(self) -> bool:
        """Leave road users out: all, else those farther away, else one by one."""
        failure, only = self._failure, self.best.candidate.only
        if only == (failure.opponent,):
            return False
        left = [one for one in failure.others if only is None or one in only]
        before, kept = len(left), self._nearest(left)
        for agent in [] if kept is None else kept[::-1]:
            fewer = [one for one in kept or [] if one != agent]
            if self._try_with(fewer):
                kept = fewer
        return kept is not None and len(kept) < before

    def _nearest(self, left: list[AgentId]) -> list[AgentId] | None:
        """The fewest of the nearest road users with which it fails; None: with no fewer."""
        if self._try_with([]):
            return []
        enough, too_few, found = len(left), 0, None
        while enough - too_few > 1:
            some = (enough + too_few) // 2
            if self._try_with(left[:some]):
                enough, found = some, left[:some]
            else:
                too_few = some
        return found if found is not None else left if self._listed(left) else None

    def _listed(self, left: list[AgentId]) -> bool:
        """Whether road users are named already, so that fewer can be tried one by one."""
        return self.best.candidate.only is not None or self._try_with(left)

    def _try_with(self, others: list[AgentId]) -> bool:
        said = f"{len(others) + 2} road users"
        return self._try(said, only=(self._failure.opponent, *others))

    def _fewer_plans(self) -> bool:
        """Follow an earlier plan to its end: the earliest first."""
        candidate = self.best.candidate
        least = changes_of_plan(replace(candidate, contact=self.best.contact), self._failure)
        if not least:
            return False
        for plans in range(max(1, candidate.plans - least), candidate.plans):
            last = len(self._failure.path(plans)) - 1
            last = min(last, self._failure.contact + 2 * AFTER_STEPS)
            if last > candidate.begin and self._try(
                f"{plans} plan{'s' * (plans > 1)}", plans=plans, last=last
            ):
                return True
        return False

    def _milder(self) -> bool:
        """Average the opponent's deviation over time, and leave less of it."""
        if self._calm is None:
            return False
        helped, now = False, self.best.candidate
        for half in (one for one in _AVERAGED if one > now.smooth):
            if self._try(f"motion averaged over {2 * half * DT_S:.1f} s", milder=True, smooth=half):
                helped = True
                break
        for scale in _SCALES:
            share = round(now.scale * scale, 3)
            said = f"{100 * share:.0f} % of the opponent's deviation"
            if self._try(said, milder=True, scale=share):
                return True
        return helped


def _as_much(found: Worth | None, first: Worth | None) -> bool:
    """Whether a hit is on the rung of the first, and all who avoid that one avoid it, too."""
    if found is None or first is None:
        return found is first
    same = (found.rung, found.finding) == (first.rung, first.finding)
    return same and set(first.avoided_by or ()) <= set(found.avoided_by or ())
