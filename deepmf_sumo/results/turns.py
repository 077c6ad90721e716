"""The attacks of several opponents in an episode: what a run's numbers are of, and ``turns.csv``.

A run has one decisive attack, of which its numbers are. Where several vehicles attack, together or
in turn, each attack is measured as if it were alone.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from deepmf_sumo import tables
from deepmf_sumo.judge.avoidability.counterfactual import (
    By,
    Counterfactual,
    counterfactual,
)
from deepmf_sumo.scene import (
    Case,
    MetricValue,
    Rollout,
    Turn,
)
from deepmf_sumo.scene.rollout import decisive

TABLE: Final = "turns.csv"
_RUN: Final = ("run_id", "spec", "scene", "planner", "adversary", "version", "seed")
_TURN: Final = ("turn", "opponent", "begin_s", "end_s", "ended", "outcome", "hit_speed_mps")

Measure = Callable[[Rollout, Case], list[MetricValue]]


def decisive_part(rollout: Rollout, case: Case) -> tuple[Rollout, Case]:
    """What a run's numbers are of: the decisive turn, or the episode where one vehicle attacks."""
    chosen = decisive(rollout.turns)
    return (rollout, case) if chosen is None else _part(chosen, rollout, case)


def judged(rollout: Rollout, case: Case, measure: Measure) -> list[dict[str, Any]] | None:
    """The attack of each vehicle, measured as a separate attack, as in ``result.json``.

    None where one vehicle attacks.
    """
    if case.turns is None and not rollout.turns:
        return None
    return [_turn(turn, rollout, case, measure) for turn in rollout.turns]


def hits(by_turn: Sequence[dict[str, Any]]) -> int:
    """In how many turns the opponent hit the AV."""
    return sum(turn["ended"] == "contact" for turn in by_turn)


def table(results: Sequence[Mapping[str, Any]]) -> str | None:
    """One row per turn of all runs, or None where no run had several attackers."""
    runs = [one for one in results if one.get("turns") is not None]
    if not runs:
        return None
    metrics = sorted({name for one in runs for turn in one["turns"] for name in turn["metrics"]})
    rows = [
        {
            **{key: one.get(key) for key in _RUN},
            **{key: {**turn, "turn": number}[key] for key in _TURN},
            **{name: turn["metrics"].get(name) for name in metrics},
        }
        for one in runs
        for number, turn in enumerate(one["turns"], start=1)
    ]
    return tables.to_csv(rows, [*_RUN, *_TURN, *metrics])


def _part(turn: Turn, rollout: Rollout, case: Case) -> tuple[Rollout, Case]:
    """The turn, and the case with its longest duration: at most to the episode's end."""
    steps = rollout.now + case.duration_steps - turn.first_step
    if case.turns is not None:
        steps = min(steps, round(case.turns.longest_s / rollout.dt_s))
    return rollout.of_turn(turn), replace(case, duration_steps=steps)


def counterfactual_of(rollout: Rollout, case: Case) -> Counterfactual | None:
    """Where the opponent would have been without the attack; None where no vehicle attacked."""
    opponent = rollout.opponent_id
    if opponent is None or opponent not in rollout.tracks.ids:
        return None
    return counterfactual(rollout, case, opponent)


def compared_with(rollout: Rollout, case: Case) -> By | None:
    """What tells where the opponent would have been; None where no vehicle attacked."""
    alone = counterfactual_of(rollout, case)
    return alone.by if alone is not None else None


def _turn(turn: Turn, rollout: Rollout, case: Case, measure: Measure) -> dict[str, Any]:
    cut, its_case = _part(turn, rollout, case)
    hit = cut.first("av_opponent")
    return {
        "opponent": turn.opponent_id,
        "begin_s": round((turn.first_step - rollout.now) * rollout.dt_s, 3),
        "end_s": round((turn.last_step - rollout.now) * rollout.dt_s, 3),
        "ended": turn.ended,
        "outcome": cut.outcome,
        "hit_speed_mps": hit.relative_mps if hit else None,
        "counterfactual": compared_with(cut, its_case),
        "metrics": {value.name: value.value for value in measure(cut, its_case)},
    }
