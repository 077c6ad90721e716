"""The gate with real attacks: equal planners pass, one that never brakes does not.

By comparison with the baseline alone: specs without `expect`, thresholds without a bound.
"""

import itertools
import json
import random
from pathlib import Path

import pytest

from deepmf_sumo import spec
from deepmf_sumo.cli import main

ROOT = Path(__file__).resolve().parents[2]

SPECS = (
    "cut_in", "merge_from_ramp", "minor_road_crossing", "leader_brakes", "red_light_runner",
)  # fmt: skip
EVERY = tuple(sorted(path.stem for path in (ROOT / "scenarios").glob("*.yaml")))
SEEDS = 5  # of a set
POOL = 6 * SEEDS
"""Seeds from which sets are drawn; two sets that are compared have none in common."""
DRAWS = 7
NEVER_BRAKES = "planner={name: constant_velocity, follow_route: true}"


def run(out, names, seeds, *sets):
    files = [str(ROOT / "scenarios" / f"{name}.yaml") for name in names]
    more = [word for one in ("expect={}", *sets) for word in ("--set", one)]
    arguments = [*files, *more, "--seeds", seeds, "--out", str(out), "--no-pictures", "--jobs", "2"]
    assert main._run(["run", *arguments]) == 0
    return out


def part(out, wholes, names, seeds):
    """A result folder of some of the runs of others."""
    manifest, runs = {}, {}
    (out / "runs").mkdir(parents=True)
    for whole in wholes:
        manifest = json.loads((whole / "manifest.json").read_text())
        for name, key in manifest["runs"].items():
            found = json.loads((whole / "runs" / name / "result.json").read_text())
            if found["spec"] in names and int(name.rpartition("-")[2]) in seeds:
                runs[name] = key
                (out / "runs" / name).symlink_to(whole / "runs" / name)
    (out / "manifest.json").write_text(json.dumps(manifest | {"runs": runs}))
    return out


def drawn(whole, folder):
    """Sets of runs, in a list for each draw."""
    rng, pool = random.Random(1), list(range(1, POOL + 1))
    for draw in range(DRAWS):
        rng.shuffle(pool)
        yield [
            part(folder / f"{draw}-{first}", [whole], named(SPECS), pool[first : first + SEEDS])
            for first in range(0, POOL, SEEDS)
        ]


def named(files):
    """What the specs of the files are called."""
    return {spec.load(ROOT / "scenarios" / f"{file}.yaml").name for file in files}


def check(out, baseline):
    thresholds = out.parent / "thresholds.yaml"
    thresholds.write_text("version: 1\n")
    return main._run(["check", str(out), "-t", str(thresholds), "--baseline", str(baseline)])


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_equal_planners_pass_and_one_that_never_brakes_does_not(tmp_path, capsys):
    good = run(tmp_path / "good", SPECS, f"1-{POOL}")
    draws = list(drawn(good, tmp_path / "sets"))
    codes = [check(*pair) for sets in draws for pair in zip(sets, sets[1:] + sets[:1], strict=True)]
    assert len(codes) == 42
    assert codes.count(0) >= 41

    every_bad = run(tmp_path / "every bad", EVERY, f"1-{SEEDS}", NEVER_BRAKES)
    first, second = range(1, SEEDS + 1), range(SEEDS + 1, 2 * SEEDS + 1)
    bad = part(tmp_path / "bad", [every_bad], named(SPECS), first)
    for baseline in itertools.chain.from_iterable(draws):
        capsys.readouterr()
        code = check(bad, baseline)
        assert code in {1, 3}
        assert code == 1 or "specs would tell" in capsys.readouterr().out

    rest = run(tmp_path / "rest", [one for one in EVERY if one not in SPECS], f"1-{2 * SEEDS}")
    every_good = part(tmp_path / "every good", [good, rest], named(EVERY), first)
    other = part(tmp_path / "other seeds", [good, rest], named(EVERY), second)
    assert check(every_bad, every_good) == 1
    assert check(other, every_good) == 0
