from pathlib import Path

import numpy as np
import pytest

from deepmf_sumo.errors import UsageError
from deepmf_sumo.report.risk import two_sides as files
from deepmf_sumo.results import statistics
from deepmf_sumo.results.risk import two_sides
from deepmf_sumo.results.risk.origins import DIMENSIONS, origins

from tests.support import gate_doubles
from tests.support.risk_doubles import Attacks, eastward

ALARMS = {"worse", "better"}


def side(values):
    """Rows of as many moments, by quantity."""
    columns = zip(*values.values(), strict=True)
    rows = [
        gate_doubles.row(f"moment {number}", **dict(zip(values, row, strict=True)))
        for number, row in enumerate(columns)
    ]
    return gate_doubles.results_of(rows, Path())


def drawn(rng, moments, worse=0.0):
    """What one planner does in moments: part is the moment's, part is chance."""
    braking = moments + rng.exponential(0.5, len(moments)) + worse
    hit = (rng.random(len(moments)) < 0.1 + 0.3 * (moments > 1)).astype(float)
    gap = np.maximum(0.0, 5 - moments + rng.normal(0, 1, len(moments)) - worse) * (1 - hit)
    return side(
        {
            "av_collision_rate": hit,
            "collision_rate": hit,
            "ttc_s": np.minimum(10, 2 + gap),
            "min_gap_m": gap,
            "required_braking_mps2": braking,
        }
    )


def states(old, new):
    found = two_sides.differences(old, new, two_sides.COMPARED, 0.95)
    return {one.quantity: one.state for one in found}


@pytest.mark.slow_unit
def test_equal_planners_hardly_ever_alarm():
    """Each job compares eight numbers of 20 moments; 5 % may alarm, in either direction."""
    rng, alarms = np.random.default_rng(3), 0
    for _ in range(25):
        moments = rng.exponential(1.0, 20)
        found = states(drawn(rng, moments), drawn(rng, moments))
        alarms += bool(ALARMS & set(found.values()))
    assert alarms < 2


def test_a_worse_planner_is_found_by_many_small_changes():
    """Each pair is 0.2 m/s2 worse, but three moments are wild: means say nothing, counts do."""
    rng = np.random.default_rng(4)
    calm = rng.exponential(1.0, 40)
    wild = np.zeros(40)
    wild[:3] = 8.0
    old = side({"required_braking_mps2": calm + wild})
    new = side({"required_braking_mps2": calm + 0.2 + wild[::-1]})
    found = two_sides.differences(old, new, ("required_braking_mps2",), 0.95)
    assert {one.quantity: one.state for one in found} == {
        "required_braking_mps2": "cannot tell",
        "pairs with worse required_braking_mps2": "worse",
    }
    assert found[1].found.new == pytest.approx(37 / 40)


def test_a_wide_interval_says_nothing():
    """2 m on both sides is the margin; that none of sixty differs leaves 1.4 m open."""
    rng = np.random.default_rng(6)
    calm = rng.exponential(1.0, 60)
    wild = rng.normal(-5.0, 60.0, 60)
    told = {}
    for name, change in {"wide": wild, "tiny": 0.01 * np.sign(wild), "none": 0 * wild}.items():
        sides = (side({"min_gap_m": calm}), side({"min_gap_m": calm + change}))
        [found, leaning] = two_sides.differences(*sides, ("min_gap_m",), 0.95)
        told[name] = files._state(found, "attacked moment")
        if name == "wide":
            assert found.state == "cannot tell"
            assert found.needed > 60
    assert told == {
        "wide": f"cannot tell; about {told['wide'].split()[3]} attacked moments would",
        "tiny": "at most 2 m apart",
        "none": "at most 2 m apart",
    }
    assert found.found.difference.high == pytest.approx(20 * (1 - 0.0125 ** (1 / 60)), rel=1e-4)
    assert files._state(leaning, "attacked moment") == "at most 0.2 apart"


def test_a_mean_of_zero_says_how_many_would_show_that_it_is_small():
    old, zero = np.arange(24.0), 0.2 * np.tile([1.0, -1.0], 12)
    sides = side({"min_gap_m": old}), side({"min_gap_m": old + zero})
    found, leaning = two_sides.differences(*sides, ("min_gap_m",), 0.95)
    assert found.found.difference.mean == pytest.approx(0.0, abs=1e-9)
    repeated = np.tile(zero, 2)[: found.needed, None]
    assert statistics.paired(repeated, 0.975, 20.0).high < 2
    assert statistics.paired(repeated[:-2], 0.975, 20.0).high > 2
    # half of the pairs on each side: their shares are known worst
    assert leaning.needed > 2 * found.needed


def test_too_few_pairs_are_told_with_how_many_are_needed():
    few = side({"min_gap_m": [1.0, 2.0, 3.0]})
    found = two_sides.differences(few, few, ("min_gap_m",), 0.95)
    assert [files._state(one, "attacked moment") for one in found] == [
        "cannot tell; at least 42 attacked moments would",
        "cannot tell; at least 20 attacked moments would",
    ]
    assert 20 * (1 - 0.0125 ** (1 / 42)) < 2 < 20 * (1 - 0.0125 ** (1 / 41))
    assert 1 - 0.0125 ** (1 / 20) < 0.2 < 1 - 0.0125 ** (1 / 19)


def folder(out, hits, planner="idm lane", spec="city", version="0.1.0", network="four_way"):
    """Twelve moments, hit in these; the later hit, the farther east."""
    runs = Attacks(out, version)
    for number in range(12):
        step = 40 + 40 * (number % 2) if number in hits else None
        runs.add(
            f"car{number}-30s", av=eastward(x=-130.0), opponent=eastward(x=-140.0), hit=step,
            planner=planner, spec=spec, network=network,
        )  # fmt: skip
    return out


def test_two_planners_are_paired_and_hits_come_from_places(tmp_path):
    """A is hit at even moments (x = -90 m), B at all (odd ones at x = -50 m)."""
    a = folder(tmp_path / "a", {0, 2, 4})
    b = folder(tmp_path / "b", {0, 2, 4, *range(1, 12, 2)}, planner="cautious")
    found = two_sides.compare(a, b)
    assert found.pairs == 12
    assert found.differs == {"planner": (("idm lane",), ("cautious",))}
    by_place = {one.value: one.hits for one in found.origins if one.dimension == "place"}
    assert sum(hits[1] - hits[0] for hits in by_place.values()) == 6
    assert by_place["w_in (w_pocket to centre)"] == (0, 6)
    [moved] = [one for one in found.origins if one.value == "w_in (w_pocket to centre)"]
    assert moved.found.difference.mean == pytest.approx(0.5)
    assert {one.dimension for one in found.origins} == {"place", "accident", "sector", "worth"}


def test_shares_of_places_add_up_to_the_difference():
    rng = np.random.default_rng(5)

    def tagged(rate):
        rows = [gate_doubles.row(f"m{n}", collision_rate=0.0) for n in range(30)]
        places = rng.choice(["J1", "J2", "J3"], 30)
        found = gate_doubles.results_of(rows, Path()).runs.assign(**dict.fromkeys(DIMENSIONS))
        return found.assign(place=[str(place) if rng.random() < rate else None for place in places])

    old, new = tagged(0.2), tagged(0.6)
    found = origins(old, new, 0.95)
    rate = [side["place"].notna().mean() for side in (old, new)]
    assert sum(one.found.difference.mean for one in found) == pytest.approx(rate[1] - rate[0])


def test_two_networks_with_few_common_moments_say_so(tmp_path):
    a = folder(tmp_path / "a", {0}, spec="before", network="before")
    b = Attacks(tmp_path / "b")
    for number in range(9, 20):
        b.add(f"car{number}-30s", av=eastward(), opponent=eastward(), spec="after", network="after")
    found = two_sides.compare(a, tmp_path / "b")
    assert found.pairs == 3
    assert set(found.differs) == {"network", "spec", "method"}
    assert any("8 of 11 runs have no partner" in note for note in found.notes)
    assert {one.found.by for one in found.differences if one.unit == "1"} >= {"nothing"}


def test_several_runs_of_one_moment_are_averaged_and_told(tmp_path):
    """A has two planners, B one of them: each moment counts once."""
    a = folder(tmp_path / "a" / "first", {0, 1})
    folder(tmp_path / "a" / "second", {0, 1}, planner="cautious")
    found = two_sides.compare(a.parent, folder(tmp_path / "b", {0, 1}))
    assert found.pairs == 12
    assert "A holds several runs of one moment and seed: their means are compared" in found.notes
    counts = {one.quantity: one.found.count for one in found.differences}
    assert counts["min_gap_m"] == counts["pairs with worse min_gap_m"] == 12


def test_hits_on_recorded_scenes_come_from_kinds_alone(tmp_path):
    a, b = (folder(tmp_path / name, {0, 1}, network=None) for name in "ab")
    found = two_sides.compare(a, b)
    assert found.pairs == 12
    assert {one.dimension for one in found.origins} == {"accident", "sector", "worth"}


def test_a_quantity_that_is_asked_for_twice_is_compared_once(tmp_path):
    a, b = (folder(tmp_path / name, {0, 1}) for name in "ab")
    twice = two_sides.compare(a, b, ("ttc_s", "min_gap_m", "ttc_s"))
    once = two_sides.compare(a, b, ("ttc_s", "min_gap_m"))
    assert twice.differences == once.differences


def test_what_cannot_be_compared_is_refused(tmp_path):
    a = folder(tmp_path / "a", {0})
    b = folder(tmp_path / "b", {0}, version="0.2.0")
    with pytest.raises(UsageError, match=r"made by version 0\.1\.0"):
        two_sides.compare(a, b)
    with pytest.raises(UsageError, match="'speed' is not a quantity"):
        two_sides.compare(a, a, ("speed",))
    with pytest.raises(UsageError, match="is not a result folder"):
        two_sides.compare(a, tmp_path / "a" / "runs")


def test_settings_are_told_where_both_planners_have_them(tmp_path):
    """An unset number is said to be one; what only one planner has, its name says already."""
    settings = [{"accel_mps2": None, "headway_s": 1.5}, {"accel_mps2": 2.0, "margin_m": 3.0}]
    for name, own in zip("ab", settings, strict=True):
        out = Attacks(tmp_path / name)
        both = {"planner": own, "adversary": {}}
        out.add("car-3s", av=eastward(), opponent=eastward(), settings=both)
    found = two_sides.compare(tmp_path / "a", tmp_path / "b")
    assert found.differs == {"planner.accel_mps2": (("not set",), ("2.0",))}


def attacked(out, **setup):
    """Two moments; the opponent's id and other settings of the attack as given, one each."""
    runs = Attacks(out)
    for number in range(2):
        settings = {"planner": {}, "adversary": {key: one[number] for key, one in setup.items()}}
        runs.add(f"car{number}-3s", av=eastward(), opponent=eastward(), settings=settings)
    return out


def test_settings_of_the_attack_that_differ_are_named(tmp_path):
    a = attacked(tmp_path / "a", period_s=(1.0, 1.0), rule=("expected", "expected"))
    b = attacked(tmp_path / "b", period_s=(2.0, 2.0), rule=("expected", "expected"))
    told = "the attack is set up differently (adversary.period_s: 1.0 in A, 2.0 in B)"
    assert any(note.startswith(told) for note in two_sides.compare(a, b).notes)
    assert not any("set up differently" in note for note in two_sides.compare(a, a).notes)


def test_whom_the_av_meets_is_no_setting_of_the_attack(tmp_path):
    """With `adversary.opponent=met` each moment has an opponent of its own."""
    a = attacked(tmp_path / "a", opponent=("car7", "car8"))
    b = attacked(tmp_path / "b", opponent=("car7", "bus1"))
    assert not any("set up differently" in note for note in two_sides.compare(a, b).notes)
    c = attacked(tmp_path / "c", opponent=("argmax", "argmax"))
    d = attacked(tmp_path / "d", opponent=("sample", "sample"))
    [note] = [one for one in two_sides.compare(c, d).notes if "set up differently" in one]
    assert "(adversary.opponent: argmax in A, sample in B)" in note


def test_runs_without_a_partner_are_counted_by_moments(tmp_path):
    """Each side holds its one moment twice: nobody is alone."""
    for name in "ab":
        for part in ("first", "second"):
            Attacks(tmp_path / name / part).add("car-3s", av=eastward(), opponent=eastward())
    found = two_sides.compare(tmp_path / "a", tmp_path / "b")
    assert (found.runs, found.pairs) == ((2, 2), 1)
    assert not any("no partner" in note for note in found.notes)


def test_runs_that_are_not_there_yet_differ_in_nothing(tmp_path):
    for name in "ab":
        out = Attacks(tmp_path / name)
        out.add("car-3s", av=eastward(), opponent=eastward())
    out.keys["city--car-9s--0"] = "never begun"
    out.write()
    found = two_sides.compare(tmp_path / "a", tmp_path / "b")
    assert (found.differs, found.pairs) == ({}, 1)
    assert "1 runs of B failed, timed out or are missing, and are not compared" in found.notes


def test_hits_that_an_earlier_version_judged_by_plans_are_told_apart(tmp_path):
    def folder(name, by):
        out = Attacks(tmp_path / name)
        for seed in range(2):
            out.add("crossing", seed, av=eastward(), opponent=eastward(), hit=20, counterfactual=by)
        return tmp_path / name

    new, old = folder("new", "episode"), folder("old", None)
    said = "an earlier version judged 2 of 4 runs"
    assert any(said in one for one in two_sides.compare(old, new).notes)
    assert not any("earlier version" in one for one in two_sides.compare(new, new).notes)
