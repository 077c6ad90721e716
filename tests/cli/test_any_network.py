"""``deepmf-sumo attack`` on networks not used for tuning: a run, or a reason.

``pytest -m slow -s tests/cli/test_any_network.py`` prints the rows of the table in the documents.
"""

import json
import resource
import subprocess
import sys
import time

import pytest

from tests.support.untuned_networks import HARDER, NOBODY, REFUSED, TEN

MOST_S = 60.0

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]


def attack(config, out, *more):
    """Exit code, what was printed, seconds to the first attack, and seconds of CPU in all."""
    command = [sys.executable, "-m", "deepmf_sumo.cli.main", "attack", str(config)]
    options = ["--out", str(out), "--no-pictures", *more]
    begin, before = time.time(), resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run([*command, *options], capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    ends = [file.stat().st_mtime - begin for file in out.glob("runs/*/result.json")]
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return done.returncode, done.stdout + done.stderr, min(ends, default=None), spent


@pytest.mark.parametrize("name", [*TEN, *HARDER])
def test_everybody_who_can_be_is_attacked(name, tmp_path):
    config = {**TEN, **HARDER}[name](tmp_path)
    out = tmp_path / "out"
    code, printed, first_s, spent_s = attack(config, out, "--moments", "3")
    assert code == 0, printed
    logs = [file.read_text() for file in out.glob("runs/*/log.txt")]
    assert not [text for text in [printed, *logs] if "Traceback" in text]
    results = [json.loads(file.read_text()) for file in out.glob("runs/*/result.json")]
    hits = sum(one["metrics"]["collision"]["value"] or 0 for one in results)
    attacked = sum(one["opponent"] is not None for one in results)
    first = "" if first_s is None else f"{first_s:.1f}"
    print(f"| {name} | {len(results)} | {attacked} | {hits:.0f} | {first} | {spent_s:.1f} |")
    if "no vehicle to attack in" in printed:
        assert name not in TEN
        return
    assert {one["status"] for one in results} == {"ok"}
    assert min(first_s, spent_s) < MOST_S  # seconds of CPU, where others use the cores, too


@pytest.mark.parametrize("name", NOBODY)
def test_where_nobody_can_be_attacked_it_is_said_why(name, tmp_path):
    build, reason = NOBODY[name]
    code, printed, first_s, _ = attack(build(tmp_path), tmp_path / "out")
    assert (code, first_s) == (0, None)
    (line,) = [line for line in printed.splitlines() if line.startswith("no vehicle to attack in")]
    assert reason in line


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_run_is_refused_in_a_line(name, tmp_path):
    build, reason = REFUSED[name]
    code, printed, _, _ = attack(build(tmp_path), tmp_path / "out")
    assert code == 3
    (line,) = printed.strip().splitlines()
    assert reason in line


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        (("--av", "ab-ab.o"), "my.sumocfg; there are ab-ab.0."),
        (("--at", "500"), "there is traffic from 0 to 200 s only"),
    ],
)
def test_what_is_not_there_is_the_users_mistake(more, reason, tmp_path):
    config = TEN["single edge"](tmp_path)
    code, printed, _, _ = attack(config, tmp_path / "out", *more)
    assert code == 2
    assert reason in printed
    assert "Traceback" not in printed
