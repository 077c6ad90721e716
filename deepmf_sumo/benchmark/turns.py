"""Opponents in turn: each turn judged by itself, and the table of all."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from deepmf_sumo import tables
from deepmf_sumo.datatypes import Case, MetricValue, Rollout, Turn
from deepmf_sumo.datatypes.rollout import decisive

TABLE: Final = "turns.csv"
_RUN: Final = ("run_id", "spec", "scene", "planner", "adversary", "version", "seed")
_TURN: Final = ("turn", "opponent", "begin_s", "end_s", "ended", "outcome", "hit_speed_mps")

Measure = Callable[[Rollout, Case], list[MetricValue]]


def decisive_part(rollout: Rollout, case: Case) -> tuple[Rollout, Case]:
    """What a run's numbers are taken from: the decisive turn; the episode where there is none."""
    chosen = decisive(rollout.turns)
    return (rollout, case) if chosen is None else _part(chosen, rollout, case)


def judged(rollout: Rollout, case: Case, measure: Measure) -> list[dict[str, Any]] | None:
    """All turns, each measured as the attack of its own that it is, as in ``result.json``.

    None where one opponent attacks.
    """
    if case.turns is None:
        return None
    return [_turn(turn, rollout, case, measure) for turn in rollout.turns]


def hits(by_turn: Sequence[dict[str, Any]]) -> int:
    """In how many turns the opponent hit the AV."""
    return sum(turn["ended"] == "contact" for turn in by_turn)


def table(results: Sequence[Mapping[str, Any]]) -> str | None:
    """A row a turn of all runs, or None where no run had opponents in turn."""
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
    """The turn, and the case with what it could have lasted: to the episode's end at most."""
    assert case.turns is not None
    left = rollout.now + case.duration_steps - turn.first_step
    longest = round(case.turns.longest_s / rollout.dt_s)
    return rollout.of_turn(turn), replace(case, duration_steps=min(left, longest))


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
        "metrics": {value.name: value.value for value in measure(cut, its_case)},
    }
