from pathlib import Path

import gate_doubles
import numpy as np
import pytest

from deepmf_sumo.benchmark.gate import comparison
from deepmf_sumo.benchmark.gate.thresholds import Baseline
from deepmf_sumo.errors import UsageError

RATE = Baseline(quantities=("av_collision_rate",))


def rate_of(hits, of=20, seed=0):
    rows = [
        gate_doubles.row("a", seed + number, av_collision_rate=float(number < hits))
        for number in range(of)
    ]
    return gate_doubles.results_of(rows, Path("new"))


def states(wanted, new, old):
    return [one.state for one in comparison.compare(wanted, new, old)]


def test_equal_results_are_the_same():
    [found] = comparison.compare(RATE, rate_of(7), rate_of(7))
    assert (found.state, found.found.by, found.found.count) == ("same", "pairs", 20)
    assert (found.found.old, found.found.new) == (0.35, 0.35)
    assert found.found.difference.mean == 0


@pytest.mark.parametrize(
    ("old", "new", "state"),
    [(7, 8, "same"), (7, 12, "same"), (7, 13, "worse"), (13, 7, "better"), (0, 20, "worse")],
)
def test_six_more_hits_of_twenty_are_beyond_chance(old, new, state):
    """All changes go one way: 1 of 2^5 is more than 2.5 %, 1 of 2^6 is less."""
    assert states(RATE, rate_of(new), rate_of(old)) == [state]


def test_less_time_to_collision_is_worse():
    wanted = Baseline(quantities=("ttc_s",))
    old, new = (
        gate_doubles.results_of([gate_doubles.row("a", seed, ttc_s=s) for seed in range(8)], Path())
        for s in (2.0, 1.0)
    )
    assert states(wanted, new, old) == ["worse"]
    assert states(wanted, old, new) == ["better"]


def test_tolerance_is_allowed_for():
    wanted = Baseline(quantities=("ttc_s",), tolerance={"ttc_s": 1.0})
    old, new = (
        gate_doubles.results_of([gate_doubles.row("a", seed, ttc_s=s) for seed in range(8)], Path())
        for s in (2.0, 1.25)
    )
    assert states(wanted, new, old) == ["same"]


@pytest.mark.parametrize(("by", "state"), [(1e-5, "same"), (0.04, "same"), (0.06, "worse")])
def test_rounding_is_no_regression(by, state):
    """Every run a little nearer, to the last: sure, but nobody minds."""
    wanted = Baseline(quantities=("min_gap_m",))
    old, new = (
        gate_doubles.results_of(
            [gate_doubles.row("a", seed, min_gap_m=seed + gap) for seed in range(20)], Path()
        )
        for gap in (1.0, 1.0 - by)
    )
    assert states(wanted, new, old) == [state]


def test_other_seeds_are_compared_unpaired():
    [found] = comparison.compare(RATE, rate_of(18), rate_of(4, seed=100))
    assert (found.found.by, found.found.count, found.state) == ("nothing", 40, "worse")
    assert states(RATE, rate_of(8), rate_of(6, seed=100)) == ["same"]


def test_nothing_to_compare():
    empty = gate_doubles.results_of([gate_doubles.row("a", 1)], Path("old"))
    [found] = comparison.compare(RATE, rate_of(3), empty)
    assert (found.state, found.found.count, found.found.difference) == ("too few", 0, None)


def test_runs_of_one_scene_are_one_unit_where_scenes_are_many():
    def folder(changed):
        return gate_doubles.results_of(
            [
                gate_doubles.row(f"s{scene}", seed, av_collision_rate=float(scene < changed))
                for scene in range(12)
                for seed in range(5)
            ],
            Path(),
        )

    [found] = comparison.compare(RATE, folder(4), folder(0))
    assert (found.found.count, found.found.units, found.state) == (60, 12, "same")
    assert states(RATE, folder(7), folder(0)) == ["worse"]


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
    [found] = comparison.compare(RATE, new, old)
    assert (found.found.by, found.found.count, found.state) == ("scenes", 12, "same")
    assert found.found.difference == (0, 0, 0)
    assert states(RATE, of_scenes(0, 9, range(50, 55)), old) == ["worse"]


def test_other_scenes_count_once_each():
    """6 of 12 scenes instead of 3: with 5 seeds each it would be 30 of 60 instead of 15."""
    old, new = of_scenes(0, 3, range(5)), of_scenes(100, 6, range(5))
    [found] = comparison.compare(RATE, new, old)
    assert (found.found.by, found.found.units, found.state) == ("nothing", 24, "same")
    assert states(RATE, of_scenes(100, 12, range(5)), old) == ["worse"]


def test_each_spec_by_itself():
    """Ten of forty runs have changed: little of all, everything of one spec."""

    def folder(hit):
        rows = [
            gate_doubles.row("a", seed, spec=spec, av_collision_rate=float(spec == hit))
            for spec in ("one", "two", "three", "four")
            for seed in range(10)
        ]
        return gate_doubles.results_of(rows, Path())

    wanted = Baseline(quantities=("av_collision_rate",), by="spec")
    found = comparison.compare(wanted, folder("two"), folder(""))
    assert {one.group: one.state for one in found} == {
        "spec four": "same", "spec one": "same", "spec three": "same", "spec two": "worse",
    }  # fmt: skip


def test_false_alarms_are_rare_and_regressions_are_found():
    """A/A of 20 seeds, four quantities that depend on each other: at most 2.5 % are alarms."""
    rng = np.random.default_rng(3)

    def results(hit_rate):
        rows = []
        for seed in range(20):
            hit = float(rng.random() < hit_rate)
            gap = 0.0 if hit else rng.exponential(2.0)
            rows.append(
                gate_doubles.row(
                    "a", seed, av_collision_rate=hit, valid_collision_rate=hit, ttc_s=gap / 2,
                    min_gap_m=gap,
                )
            )  # fmt: skip
        return gate_doubles.results_of(rows, Path())

    alarms = sum("worse" in states(Baseline(), results(0.4), results(0.4)) for _ in range(80))
    found = sum("worse" in states(Baseline(), results(0.95), results(0.2)) for _ in range(20))
    assert alarms <= 4
    assert found >= 19


def test_another_version_is_refused():
    old = gate_doubles.results_of([gate_doubles.row()], Path("base.json"), version="0.0.9")
    with pytest.raises(UsageError, match=r"base\.json was made by version 0\.0\.9"):
        comparison.compare(RATE, rate_of(1), old)
