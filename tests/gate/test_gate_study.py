"""The gate with real attacks: equal planners pass, one that never brakes does not.

By comparison with the baseline alone: specs without `expect`, thresholds without a bound.
"""

import json
from pathlib import Path

import pytest

from deepmf_sumo.cli import main

ROOT = Path(__file__).resolve().parents[2]

SPECS = (
    "cut_in", "merge_from_ramp", "minor_road_crossing", "leader_brakes", "red_light_runner",
)  # fmt: skip
SEEDS = 5
SETS = 20
"""Of the seeds 1 to 100; each is compared with the one before and the one after it."""
NEVER_BRAKES = "planner={name: constant_velocity, follow_route: true}"


def run(out, names, seeds, *sets):
    files = [str(ROOT / "scenarios" / f"{name}.yaml") for name in names]
    more = [word for one in ("expect={}", *sets) for word in ("--set", one)]
    arguments = [*files, *more, "--seeds", seeds, "--out", str(out), "--no-pictures", "--jobs", "2"]
    assert main._run(["run", *arguments]) == 0
    return out


def of_seeds(whole, out, seeds):
    """A result folder of some of the runs."""
    manifest = json.loads((whole / "manifest.json").read_text())
    manifest["runs"] = {
        name: key for name, key in manifest["runs"].items() if int(name.rpartition("-")[2]) in seeds
    }
    (out / "runs").mkdir(parents=True)
    for name in manifest["runs"]:
        (out / "runs" / name).symlink_to(whole / "runs" / name)
    (out / "manifest.json").write_text(json.dumps(manifest))
    return out


def check(out, baseline):
    thresholds = out.parent / "thresholds.yaml"
    thresholds.write_text("version: 1\n")
    return main._run(["check", str(out), "-t", str(thresholds), "--baseline", str(baseline)])


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_equal_planners_pass_and_one_that_never_brakes_does_not(tmp_path, capsys):
    good = run(tmp_path / "good", SPECS, f"1-{SETS * SEEDS}")
    sets = [
        of_seeds(good, tmp_path / f"set{one}", range(one * SEEDS + 1, (one + 1) * SEEDS + 1))
        for one in range(SETS)
    ]
    pairs = [(sets[one], sets[(one + 1) % SETS]) for one in range(SETS)]
    codes = [check(*pair) for pair in (*pairs, *(pair[::-1] for pair in pairs))]
    assert codes.count(0) >= 39

    bad = run(tmp_path / "bad", SPECS, f"1-{SEEDS}", NEVER_BRAKES)
    for baseline in sets:
        capsys.readouterr()
        code = check(bad, baseline)
        assert code in {1, 3}
        assert code == 1 or "specs would tell" in capsys.readouterr().out

    every = sorted(path.stem for path in (ROOT / "scenarios").glob("*.yaml"))
    good = run(tmp_path / "every good", every, f"1-{SEEDS}")
    bad = run(tmp_path / "every bad", every, f"1-{SEEDS}", NEVER_BRAKES)
    assert check(bad, good) == 1
    other = run(tmp_path / "other seeds", every, f"{SEEDS + 1}-{2 * SEEDS}")
    assert check(other, good) == 0
