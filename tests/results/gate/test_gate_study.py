"""The gate with real attacks, at the moments that `init` lays out and with thresholds by default.

Equal planners pass, and one that never brakes does not.
"""

from pathlib import Path

import pytest

from deepmf_sumo.cli import main
from deepmf_sumo.results import gate

ROOT = Path(__file__).resolve().parents[3]
SUITE = sorted(map(str, (ROOT / "suite").glob("*.yaml")))
NEVER_BRAKES = "planner={name: constant_velocity, follow_route: true}"


def run(out, *sets, seed=1):
    more = [word for one in ("adversary.tries=1", *sets) for word in ("--set", one)]
    arguments = [*SUITE, *more, "--seed", str(seed), "--out", str(out), "--jobs", "2"]
    assert main.run(["run", *arguments, "--no-pictures"]) == 0
    return out


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_equal_planners_pass_and_one_that_never_brakes_does_not(tmp_path):
    """Other moments than the baseline's may leave something open; they raise no alarm."""
    good, other = run(tmp_path / "good"), run(tmp_path / "other", seed=2)
    same = gate.check(good, gate.load(None), good)
    assert same.exit_code == 0
    assert {one.found.units for one in same.comparisons if one.state == "within margin"} == {48}
    assert gate.check(other, gate.load(None), good).exit_code in {0, 3}

    bad = gate.check(run(tmp_path / "bad", NEVER_BRAKES), gate.load(None), good)
    assert bad.exit_code == 1
    told = " ".join(bad.findings())
    assert all(kind in told for kind in ("red run: ", "late at a signal: ", "near collision: "))
