"""Hits of attacks with supporters, repeated with and without them: which of them need support?

    python -m studies.support FOLDER OUT...

``OUT`` are result folders, ``FOLDER`` is for the repeated runs; those that it has are kept. The
attacker drives again what it drove. With the supporter the hit has to come again (else nothing is
known of it); the supporter is needed where the hit, or the finding, does not come without it. Also
counted: contacts of supporters, findings by rung, and KG-ASG's three rates as far as its abstract
defines them (arXiv 2605.18895): hits, hits within rules and physics, hits of several vehicles.
"""

import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from deepmf_sumo import spec as spec_module
from deepmf_sumo.files import cache_folder
from deepmf_sumo.judge.ladder import FINDINGS
from deepmf_sumo.report.table import supporters
from deepmf_sumo.results.reader import Results, Run
from deepmf_sumo.results.result import Result
from deepmf_sumo.spec import Plugin, tasks
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.study.sweep import batch

ADVERSARY: Final = "studies.support.again:Again"
_ASTRAY: Final = {"against_traffic", "off_road", "infeasible"}
"""Reasons of rung C for which a hit is not within rules and physics."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Repeated:
    """A supported hit, and what came of it with its supporters and without.

    Attributes:
        with_it, without: the rung of the hit; empty for a miss; None where the run failed.
    """

    run: Run
    rung: str
    with_it: str | None
    without: str | None

    @property
    def known(self) -> bool:
        """Whether the hit came again with everybody where it was."""
        return bool(self.with_it) and self.without is not None

    @property
    def needed_for_hit(self) -> bool:
        """Whether it does not come without the supporters."""
        return self.known and not self.without

    @property
    def needed_for_finding(self) -> bool:
        """Whether it is a finding with them, and without them a miss or none."""
        return self.known and self.with_it in FINDINGS and self.without not in FINDINGS


def repeated(out: Sequence[Path], folder: Path, jobs: int = 2) -> list[Repeated]:
    """Each hit of the folders whose attack was supported, repeated twice."""
    runs = [run for one in out for run in Results.of(one).done if run.hit]
    runs = [run for run in runs if supporters(run.result)]
    todo = [_task(run, supported=supported) for run in runs for supported in (True, False)]
    options = batch.Options(out=folder, jobs=jobs, resume=folder.exists(), sumo=False)
    done = batch.run_tasks(todo, options, lambda _: None) if todo else []
    came = {result["run_id"]: _came(result) for result in done}
    return [
        Repeated(
            run=run,
            rung=str(run.result["finding"]["rung"]),
            with_it=came[_id(run, supported=True)],
            without=came[_id(run, supported=False)],
        )
        for run in runs
    ]


def _id(run: Run, *, supported: bool) -> str:
    return f"{'with' if supported else 'without'}-{run.run_id}"


def _task(run: Run, *, supported: bool) -> Task:
    """The run again, everybody of the attack on the way that it drove."""
    (task,) = tasks.plan([spec_module.load(run.folder / "spec.yaml")], cache_folder())
    values = {"folder": str(run.folder.resolve()), "supporters": supported}
    adversary = Plugin.model_validate({"name": ADVERSARY, **values})
    return replace(
        task,
        run_id=_id(run, supported=supported),
        spec=task.spec.model_copy(update={"adversary": adversary}),
    )


def _came(result: Result) -> str | None:
    if result["status"] != "ok":
        return None
    verdict = result["finding"]
    return str(verdict["rung"]) if verdict else ""


def by_method(out: Sequence[Path]) -> Iterator[str]:
    """A row of Markdown per planner and method."""
    yield (
        "| planner | method | attacks | hits | A, B, C, D | supported attacks, hits, findings |"
        " contacts of supporters: attacks, findings | time per attack, s |"
    )
    yield "| --- | --- | --- | --- | --- | --- | --- | --- |"
    groups: dict[tuple[str, str], list[Run]] = {}
    for one in out:
        for run in Results.of(one).done:
            groups.setdefault((run.planner, run.method), []).append(run)
    for (planner, method), runs in groups.items():
        attacked = [run for run in runs if run.result["opponent"]]
        hits = [run for run in attacked if run.hit]
        rungs = Counter(run.result["finding"]["rung"] for run in hits)
        helped = [run for run in attacked if supporters(run.result)]
        touched = [run for run in helped if _touched(run)]
        spent = sum(run.result["timings"]["wall_s"] for run in attacked) / max(len(attacked), 1)
        yield (
            f"| {planner} | {method} | {len(attacked)} | {len(hits)} |"
            f" {', '.join(str(rungs[rung]) for rung in 'ABCD')} |"
            f" {len(helped)}, {sum(run.hit for run in helped)}, {sum(map(_found, helped))} |"
            f" {len(touched)}, {sum(map(_found, touched))} | {spent:.1f} |"
        )


def _found(run: Run) -> bool:
    verdict = run.result["finding"]
    return verdict is not None and verdict["rung"] in FINDINGS


def _touched(run: Run) -> bool:
    """Whether a supporter touched anybody."""
    names = supporters(run.result)
    return any({one["first_id"], one["second_id"]} & names.keys() for one in run.result["contacts"])


def needs(found: Sequence[Repeated]) -> str:
    """How many hits and findings need their supporters."""
    known = [one for one in found if one.known]
    findings = [one for one in known if one.with_it in FINDINGS]
    return (
        f"supported hits: {len(found)}; come again with the supporter: {len(known)}, of them"
        f" without it, too: {sum(not one.needed_for_hit for one in known)}; findings among them:"
        f" {len(findings)}, findings without it, too:"
        f" {sum(not one.needed_for_finding for one in findings)}"
    )


def published_rates(out: Sequence[Path]) -> Iterator[str]:
    """KG-ASG's rates of each planner and method, over all attacks."""
    groups: dict[tuple[str, str], list[Run]] = {}
    for one in out:
        for run in Results.of(one).done:
            groups.setdefault((run.planner, run.method), []).append(run)
    yield "| planner | method | scenes | hits | within rules and physics | with other contacts |"
    yield "| --- | --- | --- | --- | --- | --- |"
    for (planner, method), runs in groups.items():
        hits = [run for run in runs if run.hit]
        within = [run for run in hits if _within(run)]
        several = [run for run in hits if len(run.result["contacts"]) > 1]
        rates = (f"{len(some)} ({len(some) / len(runs):.1%})" for some in (hits, within, several))
        yield f"| {planner} | {method} | {len(runs)} | {' | '.join(rates)} |"


def _within(run: Run) -> bool:
    """Within rules and physics: feasible, on its side of the road, past no red light, alone."""
    reasons = {*run.result["finding"]["reasons"]}
    red = run.result["metrics"]["red_light"]["value"]
    return not reasons & _ASTRAY and not red and len(run.result["contacts"]) == 1


def main(folder: Path, out: Sequence[Path]) -> None:
    """Print the tables, and what each supported hit is without its supporter."""
    lines = [*by_method(out), "", *published_rates(out), ""]
    found = repeated(out, folder)
    lines += [
        f"{one.run.run_id}: {one.rung}; again {one.with_it or 'miss'}, alone"
        f" {one.without or 'miss'}; {supporters(one.run.result)}"
        for one in found
    ]
    print("\n".join([*lines, needs(found)]))  # noqa: T201


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(one) for one in sys.argv[2:]])
