from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from deepmf_sumo.errors import UsageError
from deepmf_sumo.results import statistics
from deepmf_sumo.results.changes import change
from deepmf_sumo.results.gate import thresholds
from deepmf_sumo.results.gate.thresholds import Baseline
from deepmf_sumo.results.quantities import COMPARABLE

from tests.support import gate_doubles

IMPACT = Baseline(quantities=("impact_mps",))
RATE = Baseline(quantities=("av_collision_rate",))
PASSED = "within margin"
"""What a gate calls passed."""


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
    found = thresholds.compare(wanted, new, old)
    return [one for one in found if one.state != "not judged"]


def states(wanted, new, old):
    return [one.state for one in compared(wanted, new, old)]


def test_equal_results_pass():
    [found] = compared(RATE, rate_of(7), rate_of(7))
    assert (found.state, found.found.by, found.found.count) == ("within margin", "pairs", 20)
    assert (found.found.old, found.found.new) == (0.35, 0.35)
    assert found.found.difference == pytest.approx((0, -0.1391, 0.1391), abs=1e-4)


def test_a_gate_asks_for_no_more_than_that_nothing_is_worse():
    """It may be better by any amount: only one end of the interval matters."""
    new, old = rate_of(0), rate_of(3)
    [found] = compared(RATE, new, old)
    assert found.state == PASSED
    assert found.found.difference.low < -found.margin
    both = change(COMPARABLE["av_collision_rate"], new.runs, old.runs, found.found.confidence)
    assert (both.found, both.state) == (found.found, "cannot tell")


@pytest.mark.parametrize("specs", [5, 13])
def test_few_equal_specs_rule_nothing_out(specs):
    """None of n has changed: 1 - 0.05^(1 / n) of others may have, which is below 0.2 from 14 on."""
    [found] = compared(RATE, rate_of(0, of=specs), rate_of(0, of=specs))
    assert (found.state, found.needed) == ("cannot tell", 14)
    assert states(RATE, rate_of(0, of=14), rate_of(0, of=14)) == ["within margin"]
    impact = values_of("impact_mps", [0.0] * specs)
    [found] = compared(IMPACT, impact, impact)
    assert (found.state, found.needed) == ("cannot tell", 19)
    assert 20 * (1 - 0.05 ** (1 / 19)) < 3 < 20 * (1 - 0.05 ** (1 / 18))


@pytest.mark.parametrize("specs", [5, 6, 8, 10, 13, 19, 29])
@pytest.mark.parametrize(
    ("name", "step", "rule_out"),
    [
        ("av_collision_rate", 1.0, 0.2), ("impact_mps", 12.0, 3.0), ("impact_mps", 20.0, 3.0),
        ("ttc_s", -9.0, 1.0), ("min_gap_m", -15.0, 2.0),
    ],
)  # fmt: skip
def test_a_worsening_beyond_the_limit_hardly_ever_passes(name, step, rule_out, specs):
    """As many specs have the step that their mean is just too much; all numbers of them counted."""
    share, passed = 1.01 * rule_out / abs(step), 0.0
    old = values_of(name, [10.0] * specs)
    for worse in range(specs + 1):
        values = [10.0 + step] * worse + [10.0] * (specs - worse)
        if name == "av_collision_rate":
            found = states(RATE, rate_of(worse, of=specs), rate_of(0, of=specs))
        else:
            found = states(Baseline(quantities=(name,)), values_of(name, values), old)
        passed += binom.pmf(worse, specs, share) * (found[0] in {"within margin", "better"})
        if passed > 0 and found == ["cannot tell"]:
            break
    assert passed <= 0.05 + 0.03


def test_a_planner_that_is_a_bit_better_and_sometimes_much_worse_hardly_ever_passes():
    """0.5 m/s less in each spec, and 12 m/s more in 30 %: the mean is 3.1 m/s more."""
    for specs in (5, 8, 13):
        passed = 0.0
        for worse in range(specs + 1):
            new = [11.5 + 5] * worse + [4.5] * (specs - worse)
            found = states(
                Baseline(), values_of("impact_mps", new), values_of("impact_mps", [5.0] * specs)
            )
            passed += binom.pmf(worse, specs, 0.3) * (found[0] in {"within margin", "better"})
        assert passed <= 0.05 + 0.03


@pytest.mark.parametrize(
    ("old", "new", "state"),
    [
        (7, 7, "within margin"), (7, 8, "cannot tell"), (7, 11, "cannot tell"), (7, 12, "worse"),
        (13, 7, "better"),
        (0, 20, "worse"),
    ],
)  # fmt: skip
def test_five_more_hits_of_twenty_are_beyond_chance(old, new, state):
    """All changes go one way: one of 2^4 is more than 5 %, one of 2^5 is less."""
    assert states(RATE, rate_of(new), rate_of(old)) == [state]


def test_less_time_to_collision_is_worse():
    """Another spec may gain 10 s as well: 3 s less in eight tell, 1 s less in eight do not."""
    wanted = Baseline(quantities=("ttc_s",))
    old, new = values_of("ttc_s", [6.0] * 12), values_of("ttc_s", [3.0] * 12)
    assert states(wanted, new, old) == ["worse"]
    assert states(wanted, old, new) == ["better"]


def test_tolerance_is_allowed_for():
    wanted = Baseline(quantities=("ttc_s",), tolerance={"ttc_s": 1.0})
    old, new = values_of("ttc_s", [2.0] * 200), values_of("ttc_s", [1.25] * 200)
    assert states(wanted, new, old) == ["within margin"]
    assert states(Baseline(quantities=("ttc_s",)), new, old) == ["worse"]


@pytest.mark.parametrize(("by", "state"), [(1e-5, PASSED), (0.04, PASSED), (9.0, "worse")])
def test_rounding_is_not_a_regression(by, state):
    """Every run a little nearer, to the last: sure, but it does not matter."""
    wanted = Baseline(quantities=("min_gap_m",))
    old = values_of("min_gap_m", [number + 10.0 for number in range(30)])
    new = values_of("min_gap_m", [number + 10.0 - by for number in range(30)])
    assert states(wanted, new, old) == [state]


def test_a_baseline_that_can_never_alarm_is_no_pass():
    """Four specs: that all change by chance alone, one of 2^4, is more than 5 %."""
    [found] = compared(RATE, rate_of(4, of=4), rate_of(0, of=4))
    assert (found.state, found.needed) == ("cannot tell", 5)
    assert states(RATE, rate_of(0, of=4), rate_of(0, of=4)) == ["cannot tell"]
    assert states(RATE, rate_of(5, of=5), rate_of(0, of=5)) == ["worse"]


def test_a_quantity_that_is_named_twice_counts_once():
    twice = Baseline(quantities=("ttc_s", "min_gap_m", "ttc_s"))
    assert twice == Baseline(quantities=("ttc_s", "min_gap_m"))


def test_several_quantities_need_more_specs():
    wanted = Baseline(quantities=("av_collision_rate", "collision_rate"))
    rows = [gate_doubles.row(f"s{n}", av_collision_rate=0.0, collision_rate=0.0) for n in range(5)]
    same = gate_doubles.results_of(rows, Path())
    found = compared(wanted, same, same)
    assert [(one.state, one.needed) for one in found] == [("cannot tell", 17)] * 2
    assert 1 - 0.025 ** (1 / 17) < 0.2 < 1 - 0.025 ** (1 / 16)


def test_what_may_be_much_worse_does_not_pass():
    """Four of five specs are worse and one is a little better: chance is 2 of 32, also no pass."""
    old = values_of("impact_mps", [3.0, 0.0, 4.0, 10.0, 17.4])
    new = values_of("impact_mps", [3.5, 10.0, 6.0, 17.4, 17.1])
    [found] = compared(IMPACT, new, old)
    assert found.state == "cannot tell"
    assert found.needed > 5
    assert found.found.difference.high > 10
    [back] = compared(IMPACT, old, new)
    assert back.state == "cannot tell"
    wide = Baseline(quantities=("impact_mps",), rule_out={"impact_mps": 15.0})
    assert states(wide, new, old) == ["within margin"]


def test_how_many_units_would_tell():
    """So many like these do, and one in a hundred fewer do not."""
    [found] = compared(RATE, rate_of(8), rate_of(7))
    assert found.state == "cannot tell"
    for units, told in ((found.needed, True), (found.needed - 1, False)):
        high = statistics.of_pairs(found.found.values[0].as_many(units), 0.9, 1.0).high
        assert (high < 0.2) == told
    [never] = compared(RATE, rate_of(11), rate_of(7))  # 0.2, as much as must be ruled out, or more
    assert never.needed is not None
    wanted = Baseline(quantities=("av_collision_rate",), tolerance={"av_collision_rate": 0.2})
    assert compared(wanted, rate_of(11), rate_of(7))[0].needed is None


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
    old, new = of_scenes(0, 2, range(5), 14), of_scenes(0, 2, range(50, 55), 14)
    [found] = compared(RATE, new, old)
    assert (found.found.by, found.found.count, found.state) == ("scenes", 14, "within margin")
    assert found.found.difference.mean == 0
    assert states(RATE, of_scenes(0, 9, range(50, 55), 14), old) == ["worse"]


def test_other_scenes_count_once_each():
    """6 of 12 scenes instead of 3: with 5 seeds each it would be 30 of 60 instead of 15."""
    old, new = of_scenes(0, 3, range(5)), of_scenes(100, 6, range(5))
    [found] = compared(RATE, new, old)
    assert (found.found.by, found.found.units, found.state) == ("nothing", 24, "cannot tell")
    assert states(RATE, of_scenes(100, 12, range(5)), old) == ["worse"]


def test_each_spec_by_itself():
    """One of four specs has changed: each is judged over its twenty scenes."""

    def folder(hit):
        rows = [
            gate_doubles.row(f"s{scene}", spec=name, av_collision_rate=float(name == hit))
            for name in ("one", "two", "three", "four")
            for scene in range(20)
        ]
        return gate_doubles.results_of(rows, Path())

    wanted = Baseline(quantities=("av_collision_rate",), by="spec")
    found = compared(wanted, folder("two"), folder(""))
    assert {one.group: one.state for one in found} == {
        "spec four": PASSED, "spec one": PASSED, "spec three": PASSED, "spec two": "worse",
    }  # fmt: skip


def test_what_is_shown_is_not_judged():
    rows = [
        [gate_doubles.row(f"s{n}", impact_mps=0.0, ttc_s=ttc) for n in range(20)] for ttc in (5, 1)
    ]
    old, new = (gate_doubles.results_of(side, Path()) for side in rows)
    found = {one.quantity: one.state for one in thresholds.compare(IMPACT, new, old)}
    assert found == {
        "impact_mps": "within margin", "av_collision_rate": "not judged",
        "finding_rate": "not judged", "ttc_s": "not judged", "min_gap_m": "not judged",
    }  # fmt: skip


QUANTITIES = ("impact_mps", "av_collision_rate", "ttc_s", "min_gap_m")


@pytest.mark.slow_unit
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
    alarms = sum("worse" in states(wanted, results(0.4), results(0.4)) for _ in range(40))
    found = sum("worse" in states(wanted, results(0.95), results(0.2)) for _ in range(10))
    assert alarms <= 2
    assert found == 10


def lean(wanted, new, old):
    return [(one.quantity, one.found.new, one.found.old) for one in
            thresholds.leanings(wanted, new, old, [])]  # fmt: skip


@pytest.mark.parametrize(("worse", "better"), [(2, 0), (3, 3), (6, 1), (9, 4), (9, 0), (12, 2)])
def test_a_quantity_is_worse_where_more_pairs_are_than_chance_explains(worse, better):
    """The sign test is another measure; small differences count for nothing."""
    changes = [0.3] * worse + [-0.3] * better + [0.04] * 9 + [0.0] * 10
    new, old = values_of("impact_mps", changes), values_of("impact_mps", [0.0] * len(changes))
    pairs, tells = len(changes), binom.sf(worse - 1, worse + better, 0.5) < 0.05
    told = [("pairs with worse impact_mps", worse / pairs, better / pairs)]
    assert lean(IMPACT, new, old) == (told if tells else [])
    assert lean(IMPACT, old, new) == []
    assert states(IMPACT, new, old) != ["worse"]


def test_less_time_in_most_pairs_is_worse_and_more_is_not():
    less = values_of("ttc_s", [4.5] * 7 + [5.0] * 20)
    more = values_of("ttc_s", [5.0] * 27)
    wanted = Baseline(quantities=("ttc_s",))
    assert lean(wanted, less, more) == [("pairs with worse ttc_s", 7 / 27, 0.0)]
    assert lean(wanted, more, less) == []
    assert lean(RATE, rate_of(15), rate_of(0)) == []  # rates are compared as they are


@pytest.mark.slow_unit
def test_more_pairs_of_four_quantities_are_rarely_worse_by_chance():
    """Equally good planners that drive differently, in 30 situations: at most 5 % of the jobs."""
    rng = np.random.default_rng(5)

    def results():
        some = rng.normal(0, 1, 30) * (rng.random(30) < 0.8)
        each = (some + rng.normal(0, 0.3, 30) for _ in QUANTITIES)
        shown = dict(zip(QUANTITIES, (0.3 * one for one in each), strict=True))
        rows = [gate_doubles.row(f"s{n}", **{name: float(values[n]) for name, values in
                shown.items()}) for n in range(30)]  # fmt: skip
        return gate_doubles.results_of(rows, Path())

    wanted = Baseline(quantities=QUANTITIES)
    alarms = sum(bool(thresholds.leanings(wanted, results(), results(), [])) for _ in range(60))
    assert alarms <= 0.05 * 60 + 2 * np.sqrt(0.05 * 0.95 * 60)
