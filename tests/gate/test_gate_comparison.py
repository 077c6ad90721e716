from pathlib import Path

import numpy as np
import pytest

from deepmf_sumo.errors import UsageError
from deepmf_sumo.gate import comparison
from deepmf_sumo.gate.thresholds import Baseline
from deepmf_sumo.results import difference

from tests.support import gate_doubles

RATE = Baseline(quantities=("av_collision_rate",))


def rate_of(hits, of=20, first=0, seed=0):
    """The first ``hits`` of ``of`` specs are hit."""
    rows = [
        gate_doubles.row("a", seed, spec=f"spec {first + n}", av_collision_rate=float(n < hits))
        for n in range(of)
    ]
    return gate_doubles.results_of(rows, Path("new"))


def values_of(name, values):
    rows = [gate_doubles.row(f"s{n}", **{name: value}) for n, value in enumerate(values)]
    return gate_doubles.results_of(rows, Path())


def compared(wanted, new, old):
    found = comparison.compare(wanted, new, old)
    return [one for one in found if one.state != "not judged"]


def states(wanted, new, old):
    return [one.state for one in compared(wanted, new, old)]


def test_equal_results_pass():
    [found] = compared(RATE, rate_of(7), rate_of(7))
    assert (found.state, found.found.by, found.found.count) == ("passed", "pairs", 20)
    assert (found.found.old, found.found.new) == (0.35, 0.35)
    assert found.found.difference == (0, 0, 0)


@pytest.mark.parametrize(
    ("old", "new", "state"),
    [
        (7, 8, "passed"), (7, 11, "cannot tell"), (7, 12, "worse"), (13, 7, "better"),
        (0, 20, "worse"),
    ],
)  # fmt: skip
def test_five_more_hits_of_twenty_are_beyond_chance(old, new, state):
    """All changes go one way: one of 2^4 is more than 5 %, one of 2^5 is less."""
    assert states(RATE, rate_of(new), rate_of(old)) == [state]


def test_less_time_to_collision_is_worse():
    wanted = Baseline(quantities=("ttc_s",))
    old, new = values_of("ttc_s", [2.0] * 8), values_of("ttc_s", [1.0] * 8)
    assert states(wanted, new, old) == ["worse"]
    assert states(wanted, old, new) == ["better"]


def test_tolerance_is_allowed_for():
    wanted = Baseline(quantities=("ttc_s",), tolerance={"ttc_s": 1.0})
    old, new = values_of("ttc_s", [2.0] * 8), values_of("ttc_s", [1.25] * 8)
    assert states(wanted, new, old) == ["passed"]


@pytest.mark.parametrize(("by", "state"), [(1e-5, "passed"), (0.04, "passed"), (0.06, "worse")])
def test_rounding_is_not_a_regression(by, state):
    """Every run a little nearer, to the last: sure, but it does not matter."""
    wanted = Baseline(quantities=("min_gap_m",))
    old = values_of("min_gap_m", [number + 1.0 for number in range(20)])
    new = values_of("min_gap_m", [number + 1.0 - by for number in range(20)])
    assert states(wanted, new, old) == [state]


def test_a_baseline_that_can_never_alarm_is_no_pass():
    """Four specs: one of 2^4 swaps is more than 5 %, even where the results are the same."""
    [found] = compared(RATE, rate_of(4, of=4), rate_of(0, of=4))
    assert (found.state, found.needed) == ("cannot tell", 5)
    assert states(RATE, rate_of(0, of=4), rate_of(0, of=4)) == ["cannot tell"]
    assert states(RATE, rate_of(0, of=5), rate_of(0, of=5)) == ["passed"]
    assert states(RATE, rate_of(5, of=5), rate_of(0, of=5)) == ["worse"]


def test_several_quantities_need_more_specs():
    wanted = Baseline(quantities=("av_collision_rate", "collision_rate"))
    rows = [gate_doubles.row(f"s{n}", av_collision_rate=0.0, collision_rate=0.0) for n in range(5)]
    same = gate_doubles.results_of(rows, Path())
    found = compared(wanted, same, same)
    assert [(one.state, one.needed) for one in found] == [("cannot tell", 6)] * 2


def test_what_may_be_much_worse_does_not_pass():
    """Four of five specs are worse and one is a little better: chance is 2 of 32, no pass either.

    The means of two, three, ... more specs like these would lie beyond it.
    """
    wanted = Baseline()
    old = values_of("impact_mps", [3.0, 0.0, 4.0, 10.0, 17.4])
    new = values_of("impact_mps", [3.5, 10.0, 6.0, 17.4, 17.1])
    [found] = compared(wanted, new, old)
    assert (found.state, found.needed) == ("cannot tell", 6)
    assert (found.found.difference.low, found.found.difference.high) == pytest.approx((-0.3, 10))
    [back] = compared(wanted, old, new)
    assert back.state == "passed"
    wide = Baseline(rule_out={"impact_mps": 11.0})
    assert states(wide, new, old) == ["passed"]


def test_how_many_units_would_tell():
    """An interval that reaches twice as far as the bound is away halves with four times as many."""
    [found] = compared(RATE, rate_of(7), rate_of(7))
    assert difference.units_needed(found.found, 2.0, 1.0) == 80
    assert difference.units_needed(found.found, 1.0, 2.0) == 21
    assert difference.units_needed(found.found, 1.0, 0.0) is None
    assert difference.units_needed(found.found, 1.0, 1e-9) is None


def test_other_seeds_and_planners_are_compared_by_spec():
    [found] = compared(RATE, rate_of(18, seed=9), rate_of(4))
    assert (found.found.by, found.found.count, found.state) == ("scenes", 20, "worse")


def test_other_specs_are_not_compared():
    """A planner that never brakes would pass against the hits of harder situations."""
    with pytest.raises(UsageError, match=r"in common \('spec 100', 'spec 101' and 18 more;"):
        compared(RATE, rate_of(18, first=100), rate_of(4))


def test_nothing_to_compare():
    empty = gate_doubles.results_of([gate_doubles.row("a", 1, spec="spec 0")], Path("old"))
    [found] = compared(RATE, rate_of(3), empty)
    assert (found.state, found.found.count, found.found.difference) == ("cannot tell", 0, None)


def test_seeds_of_one_spec_are_not_independent():
    """Forty seeds of one spec are one unit, and of twelve specs twelve."""

    def folder(changed, specs=12, seeds=5):
        return gate_doubles.results_of(
            [
                gate_doubles.row(
                    "a", seed, spec=f"s{spec}", av_collision_rate=float(spec < changed)
                )
                for spec in range(specs)
                for seed in range(seeds)
            ],
            Path(),
        )

    [found] = compared(RATE, folder(4), folder(0))
    assert (found.found.count, found.found.units, found.found.specs) == (60, 12, True)
    assert found.state == "cannot tell"
    assert states(RATE, folder(7), folder(0)) == ["worse"]
    [alone] = compared(RATE, folder(1, 1, 40), folder(0, 1, 40))
    assert (alone.found.count, alone.found.units, alone.state) == (40, 1, "cannot tell")


def of_scenes(first, hits, seeds, scenes=12):
    """The first ``hits`` scenes are hit with every seed."""
    rows = [
        gate_doubles.row(f"s{first + scene}", seed, av_collision_rate=float(scene < hits))
        for scene in range(scenes)
        for seed in seeds
    ]
    return gate_doubles.results_of(rows, Path())


def test_scenes_with_other_seeds_are_paired_by_scene():
    old, new = of_scenes(0, 2, range(5)), of_scenes(0, 2, range(50, 55))
    [found] = compared(RATE, new, old)
    assert (found.found.by, found.found.count, found.state) == ("scenes", 12, "passed")
    assert found.found.difference == (0, 0, 0)
    assert states(RATE, of_scenes(0, 9, range(50, 55)), old) == ["worse"]


def test_other_scenes_count_once_each():
    """6 of 12 scenes instead of 3: with 5 seeds each it would be 30 of 60 instead of 15."""
    old, new = of_scenes(0, 3, range(5)), of_scenes(100, 6, range(5))
    [found] = compared(RATE, new, old)
    assert (found.found.by, found.found.units, found.state) == ("nothing", 24, "cannot tell")
    assert states(RATE, of_scenes(100, 12, range(5)), old) == ["worse"]


def test_each_spec_by_itself():
    """One of four specs has changed: each is judged over its ten scenes."""

    def folder(hit):
        rows = [
            gate_doubles.row(f"s{scene}", spec=name, av_collision_rate=float(name == hit))
            for name in ("one", "two", "three", "four")
            for scene in range(10)
        ]
        return gate_doubles.results_of(rows, Path())

    wanted = Baseline(quantities=("av_collision_rate",), by="spec")
    found = compared(wanted, folder("two"), folder(""))
    assert {one.group: one.state for one in found} == {
        "spec four": "passed", "spec one": "passed", "spec three": "passed", "spec two": "worse",
    }  # fmt: skip


def test_what_is_shown_is_not_judged():
    rows = [
        [gate_doubles.row(f"s{n}", impact_mps=0.0, ttc_s=ttc) for n in range(8)] for ttc in (5, 1)
    ]
    old, new = (gate_doubles.results_of(side, Path()) for side in rows)
    found = {one.quantity: one.state for one in comparison.compare(Baseline(), new, old)}
    assert found == {
        "impact_mps": "passed", "av_collision_rate": "not judged",
        "valid_collision_rate": "not judged", "ttc_s": "not judged", "min_gap_m": "not judged",
    }  # fmt: skip


QUANTITIES = ("impact_mps", "av_collision_rate", "ttc_s", "min_gap_m")


def test_false_alarms_are_rare_and_regressions_are_found():
    """A/A of 20 specs, four quantities that depend on each other: at most 5 % are alarms."""
    rng = np.random.default_rng(3)

    def results(hit_rate):
        rows = []
        for scene in range(20):
            hit = float(rng.random() < hit_rate)
            gap = 0.0 if hit else rng.exponential(2.0)
            rows.append(
                gate_doubles.row(
                    f"s{scene}", impact_mps=hit * rng.exponential(8.0), av_collision_rate=hit,
                    ttc_s=gap / 2, min_gap_m=gap,
                )
            )  # fmt: skip
        return gate_doubles.results_of(rows, Path())

    wanted = Baseline(quantities=QUANTITIES)
    alarms = sum("worse" in states(wanted, results(0.4), results(0.4)) for _ in range(80))
    found = sum("worse" in states(wanted, results(0.95), results(0.2)) for _ in range(20))
    assert alarms <= 4
    assert found >= 19
