"""`check`, `compare` and the tables of plans say the same of the same two folders."""

import pytest

from deepmf_sumo.results import run_sets
from deepmf_sumo.results.gate import thresholds
from deepmf_sumo.results.gate.thresholds import Baseline
from deepmf_sumo.results.risk import two_sides as risk
from deepmf_sumo.results.stored import result_of
from deepmf_sumo.study.plans import tables

from tests.support import gate_doubles

HITS = {
    "some more hits": ([0, 3], [0, 1, 3, 4]),
    "far more hits": ([], range(12)),
    "equal": ([2, 5], [2, 5]),
    "far fewer hits": (range(12), []),
}


def folder(out, hits):
    """Twelve specs with two seeds, and one with five; the values of each differ a little."""
    runs = [
        gate_doubles.result(
            f"scene{spec}", seed, spec=f"spec {spec}", hit=spec in hits, perception=None,
            parameters="treiber", method="", samples=None, duration_steps=80,
        )
        for spec in range(13)
        for seed in range(5 if spec == 12 else 2)
    ]  # fmt: skip
    for one in runs:
        one["metrics"]["min_gap"]["value"] += 0.37 * one["seed"] + 0.01 * len(one["scene"])
    return gate_doubles.write_folder(out, runs)


@pytest.mark.parametrize("name", ["collision_rate", "min_gap_m", "delta_v_mps"])
@pytest.mark.parametrize("case", HITS)
def test_the_same_difference_interval_and_answer(tmp_path, case, name):
    old, new = (
        folder(tmp_path / side, set(hits))
        for side, hits in zip(("old", "new"), HITS[case], strict=True)
    )
    sides = run_sets.read(old), run_sets.read(new)
    # 97.5 % at each end are 95 % at both
    wanted = Baseline(quantities=(name,), confidence=0.975)
    [judged] = [
        one for one in thresholds.compare(wanted, sides[1], sides[0]) if one.state != "not judged"
    ]
    # of a number it also counts the pairs: two intervals
    confidence = 0.95 if name.endswith("rate") else 0.9
    compared, *_ = risk.differences(sides[0], sides[1], [name], confidence)
    [listed] = [
        row
        for row in tables.differences(
            {name: results(out) for name, out in (("old", old), ("new", new))},
            baseline="old",
            planner="idm lane",
        )
        if row["quantity"] == name
    ]
    of_all = [judged.found.difference, compared.found.difference]
    if of_all[0] is None:
        assert of_all[1] is None
        assert listed["difference"] is None
        return
    of_all.append((listed["difference"], listed["difference_lo"], listed["difference_hi"]))
    for one in of_all[1:]:
        assert one == pytest.approx(of_all[0], abs=1e-5)
    assert judged.found.units == compared.found.units
    if {judged.state, compared.state} & {"worse", "better"}:
        assert judged.state == compared.state
    else:  # a gate asks for one side only
        assert judged.state == "within margin" or compared.state == "cannot tell"


def results(out):
    found = [result_of(file) for file in sorted(out.glob("runs/*/result.json"))]
    return gate_doubles.runs_of_plan(found)
