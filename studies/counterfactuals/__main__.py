"""Hits in SUMO's traffic judged in three ways: as now, as before, and as live attacks are judged.

Now: by the unattacked episode that each run keeps. Before: by the likeliest prediction of the
attack's own first plan, and without a motion to compare with where the plan predicts nothing. As
live attacks: the opponent keeps lane and speed. The rollouts are the same, of result folders.

    python -m studies.counterfactuals [--by-folder] OUT...
"""

import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final
from unittest.mock import patch

import numpy as np

from deepmf_sumo.judge import hits
from deepmf_sumo.judge.avoidability import encounter
from deepmf_sumo.judge.avoidability.counterfactual import Counterfactual, counterfactual
from deepmf_sumo.judge.avoidability.grading import GRADES, Judgement, judge
from deepmf_sumo.judge.metrics import Episode
from deepmf_sumo.judge.metrics.avoidability import judgement
from deepmf_sumo.judge.metrics.findings import finding
from deepmf_sumo.results import artifacts
from deepmf_sumo.results.reader import Results, Run
from deepmf_sumo.scene import AgentId, Case, Rollout, TrafficCase

WAYS: Final = ("now", "before", "lane")
_NOTHING: Final = Counterfactual(by="lane", position_m=np.zeros((0, 2)), known=np.zeros(0, bool))


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """A hit: its judgement in each of `WAYS`, and whether it is a finding by it.

    ``kept``: whether the run's own grade is that of ``now``: folders round positions.
    """

    method: str
    judgements: dict[str, Judgement]
    valid: dict[str, bool]
    kept: bool

    def grade(self, way: str) -> int:
        """0 (A) to 3 (D)."""
        return GRADES.index(self.judgements[way].grade)


def judged(run: Run) -> Judged:
    """A run with a hit. Raises `stored.DAMAGE`."""
    rollout = run.rollout
    case = TrafficCase(
        name=run.run_id, road=run.road()[0], av_id=rollout.av_id, seed=run.seed,
        duration_steps=run.result["duration_steps"], config=run.folder, start_s=0.0,
        net_file=run.folder,
    )  # fmt: skip
    kept, before = run.unattacked(), artifacts.read_predicted(run.folder)
    assert kept is not None
    answers: dict[str, Callable[[Rollout, Case, AgentId], Counterfactual]] = {
        "now": lambda *_: kept,
        "before": lambda *_: before or _NOTHING,
        "lane": counterfactual,  # the case has no unattacked episode
    }
    judgements, valid = {}, {}
    for way, answer in answers.items():
        with (
            patch.object(encounter, "counterfactual", answer),
            patch.object(hits, "counterfactual", answer),
        ):
            found = judge(rollout, case)
            assert found is not None
            episode = Episode(rollout, case)
            judgements[way] = judgement(episode)
            valid[way] = finding.compute(episode) > 0
    now = GRADES.index(judgements["now"].grade)
    return Judged(
        method=run.method,
        judgements=judgements,
        valid=valid,
        kept=run.metric("avoidance_grade") == now,
    )


def table(folders: list[Path], *, by_folder: bool = False) -> str:
    """Markdown: a row a method, or a folder; then how near the other ways come."""
    attacks: Counter[str] = Counter()
    found: list[Judged] = []
    for folder in folders:
        for run in Results.of(folder).done:
            name = folder.name if by_folder else run.method
            attacks[name] += bool(run.result["opponent"])
            if run.outcome == "av_opponent":
                found.append(replace(judged(run), method=name))
    what = "planner" if by_folder else "method"
    lines = [
        f"| {what} | attacks | hits | avoidable: before, now | valid: before, now | up, down |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for method, count in [*attacks.items(), ("all", sum(attacks.values()))]:
        of = [one for one in found if method in (one.method, "all")]
        lines.append(f"| {method} | {count} | {len(of)} | {_pair(of, _avoidable)} |"
                     f" {_pair(of, _valid)} | {_moved(of)} |")  # fmt: skip
    return "\n".join([*lines, "", _lane(found)])


def _avoidable(one: Judged, way: str) -> bool:
    return one.judgements[way].avoidable


def _valid(one: Judged, way: str) -> bool:
    return one.valid[way]


def _pair(of: list[Judged], what: Callable[[Judged, str], bool]) -> str:
    return ", ".join(str(sum(what(one, way) for one in of)) for way in ("before", "now"))


def _moved(of: list[Judged]) -> str:
    moved = [one.grade("now") - one.grade("before") for one in of]
    return f"{sum(one > 0 for one in moved)}, {sum(one < 0 for one in moved)}"


def _lane(found: list[Judged]) -> str:
    """How often the ways agree with the unattacked episode, and on the grades that runs keep."""
    said = [f"{len(found)} hits; the run's own grade is repeated in {sum(o.kept for o in found)}"]
    for way in WAYS[1:]:
        same = sum(one.grade(way) == one.grade("now") for one in found)
        late = [
            (one.judgements[way].onset_step - one.judgements["now"].onset_step) / 10
            for one in found
        ]
        said.append(
            f"{way}: same grade as now in {same}, same validity in"
            f" {sum(one.valid[way] == one.valid['now'] for one in found)}; onset later by"
            f" {np.mean(late):.2f} s on average, at least 0.3 s earlier in"
            f" {sum(one <= -0.3 for one in late)}, at least 0.3 s later in"
            f" {sum(one >= 0.3 for one in late)}"
        )
    return "\n".join(said)


if __name__ == "__main__":
    given = [one for one in sys.argv[1:] if one != "--by-folder"]
    print(table([Path(one) for one in given], by_folder=len(given) < len(sys.argv) - 1))  # noqa: T201
