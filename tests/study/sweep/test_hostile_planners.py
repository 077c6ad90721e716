"""A sweep with planners that misbehave: a row each, the sweep goes on, nobody is left."""

import json
from pathlib import Path

import pytest

from deepmf_sumo import spec
from deepmf_sumo.study.sweep import batch

from tests.support import tiny_network

pytestmark = pytest.mark.sumo

HOSTILE = Path(__file__).parents[2] / "support" / "hostile_planner.py"

ENDS = {
    "raise": "ended with exit code 1 (see log.txt) before it answered step 12.",
    "hang": "did not answer step 12 within 1 s.",
    "nan": "answered wrongly: 'speed_mps' is nan: Input should be a finite number.",
    "wrong_length": "answered [5.0, 0.0, 0.0], which is not a JSON object.",
    "fast": "Input should be less than or equal to 150.",
    "exit": "ended with exit code 3 (see log.txt) before it answered step 12.",
    "gigabyte": "answered step 12 with a line of more than 65536 bytes.",
    "fork": "ended with exit code 0 (see log.txt) before it answered step 12.",
    "close_stdin": "did not answer step 12 within 1 s.",
    "not_json": "which is not JSON; write everything but answers to stderr.",
    "huge_line": "answered step 12 with a line of more than 65536 bytes.",
    "wrong_types": "'speed_mps' is 'fast': Input should be a valid number.",
}
assert len(ENDS) == 12


@pytest.fixture(scope="module")
def out(tiny, tmp_path_factory):
    """Result folder of the sweep, and the folder of the program."""
    folder = tmp_path_factory.mktemp("sweep")
    (tiny / "misbehaving.py").write_text(HOSTILE.read_text())
    planner = "{{name: program, file: misbehaving.py, arguments: [{how}], step_budget_s: 1.0}}"
    paths = [
        tiny_network.spec(tiny, f"how {how}", planner=planner.format(how=how))
        for how in [*ENDS, "behave"]
    ]
    batch.run([spec.load(path) for path in paths], batch.Options(out=folder))
    return folder


def test_each_is_a_row_with_its_error_and_the_sweep_goes_on(out):
    found = [json.loads(path.read_text()) for path in out.glob("runs/*/result.json")]
    results = {one["spec"]: one for one in found}
    assert len(results) == 13
    fine = results.pop("how behave")
    assert (fine["status"], fine["outcome"]) == ("ok", "none")
    for how, end in ENDS.items():
        found = results[f"how {how}"]
        assert found["status"] == "failed"
        assert found["error"].startswith("planner_error: program 'misbehaving.py' ")
        assert found["error"].endswith(end)
        fault = "hung" if "did not answer" in end else "nonsense"
        fault = "crashed" if "before it answered" in end else fault
        assert found["planner_fault"] == fault


def test_what_the_program_says_is_in_the_log(out):
    log = (out / "runs" / "how-raise--tiny--0" / "log.txt").read_text()
    assert "ZeroDivisionError: a bug of the program" in log
    assert sum(path.stat().st_size for path in out.rglob("log.txt")) < 2_000_000


def test_no_process_is_left(out):
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                assert b"misbehaving.py" not in (folder / "cmdline").read_bytes()
            except OSError:
                continue
