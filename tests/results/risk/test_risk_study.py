"""Comparisons of real attacks: equal planners do not alarm, a planner made worse is found."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from deepmf_sumo.cli import main
from deepmf_sumo.results.risk import two_sides

from tests.support import gate_doubles

NETS = Path(__file__).resolve().parents[3] / "sumo_nets"
SEEDS, MOMENTS = range(1, 21), 5
GROUPINGS = 100
POWER_SEEDS, POWER_MOMENTS = (1, 2, 3), 40
SAMPLES, PAIRS = 60, 120


def attack(config, out, seed, moments, *more):
    arguments = [str(NETS / config), "--moments", str(moments), "--seed", str(seed), "--out", out]
    arguments += ["--set", "adversary.rule=expected"]  # as studies/notebook/compare.md has it
    assert (
        main.run(
            ["attack", *map(str, arguments), "--no-pictures", "--set", "sweep.risk=false", *more]
        )
        == 0
    )


def alarms(old, new, wanted):
    """Whether any of the compared quantities is told to be different that way."""
    sides = (gate_doubles.results_of(side, Path()) for side in (old, new))
    found = two_sides.differences(*sides, two_sides.COMPARED, 0.95)
    return any(one.state in wanted for one in found)


def runs_of(folder):
    """Rows with the ids by which the two sides are paired."""
    side = two_sides._side(folder)
    return two_sides._alike(side, {"planner"}).runs.to_dict("records")


def sampled(runs, draw):
    """Pairs drawn anew are moments of their own."""
    return [
        {**runs[key], "run_id": f"{number}", "scene": f"{number}"}
        for number, key in enumerate(draw)
    ]


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_seeds_against_other_seeds_do_not_alarm(tmp_path):
    """Half of twenty seeds against the other half, grouped in a hundred ways."""
    for seed in SEEDS:
        attack("four_way/four_way.sumocfg", tmp_path / f"{seed:02d}", seed, MOMENTS)
    runs = runs_of(tmp_path)
    # with the first seed on one side: the mirrored groupings say the same
    halves = list(itertools.combinations(SEEDS[1:], len(SEEDS) // 2 - 1))
    count = 0
    for half in halves[:: len(halves) // GROUPINGS][:GROUPINGS]:
        mine = {SEEDS[0], *half}
        sides = ([row for row in runs if (row["seed"] in mine) == one] for one in (True, False))
        count += alarms(*sides, {"worse", "better"})
    assert count <= 0.05 * GROUPINGS


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_shorter_headway_is_found(tmp_path):
    """A headway of 0.8 instead of 1.5 s, in 95 % of samples of 120 pairs."""
    for seed in POWER_SEEDS:
        for name, more in (("old", ()), ("new", ("--set", "planner.headway_s=0.8"))):
            out = tmp_path / name / str(seed)
            attack("arterial/arterial.sumocfg", out, seed, POWER_MOMENTS, *more)
    old, new = ({row["run_id"]: row for row in runs_of(tmp_path / name)} for name in ("old", "new"))
    both = sorted(old.keys() & new.keys())
    rng = np.random.default_rng(0)
    draws = [rng.choice(both, PAIRS) for _ in range(SAMPLES)]
    found = sum(alarms(sampled(old, draw), sampled(new, draw), {"worse"}) for draw in draws)
    assert found >= 0.95 * SAMPLES
