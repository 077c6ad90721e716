"""Results of versions that judged an attack in SUMO's traffic by the attack's own plan."""

import json

import numpy as np
import pytest

from deepmf_sumo.cli import main
from deepmf_sumo.report.page import document
from deepmf_sumo.results.reader import Results, judged_before
from deepmf_sumo.results.stored import DAMAGE

from tests.support.result_folders import Folder

pytestmark = pytest.mark.sumo  # recordings are read in a process
WORD = "an earlier version judged 1 of 2 runs"


@pytest.fixture
def old(tmp_path):
    """Two runs as earlier versions left them; the first is said to be of a network."""
    folder = Folder(tmp_path)
    folder.add("one")
    folder.add("two")
    for number, run in enumerate(Results.open(folder.out).runs):
        file = run.folder / "result.json"
        values = json.loads(file.read_text())
        assert values.pop("counterfactual") == "log"
        if number == 0:
            values["network"] = "town"
            (run.folder / "spec.yaml").unlink()
        file.write_text(json.dumps(values))
    manifest = {"tool": "deepmf-sumo", "format_version": 1, "runs": {}}
    (folder.out / "manifest.json").write_text(json.dumps(manifest))
    return folder.out


def test_they_are_read_as_they_were_judged(old):
    network, recording = Results.open(old).runs
    kept = network.unattacked()
    assert kept.by == "prediction"
    with np.load(network.folder / "plans.npz") as arrays:
        assert arrays["00/first_step"] == 11
        np.testing.assert_allclose(kept.position_m[11:], arrays["00/candidate_position_m"][0])
    assert not kept.known[:11].any()
    assert kept.known[11:].all()
    assert recording.unattacked().by == "log"
    assert (network.judged_by_plan, recording.judged_by_plan) == (True, False)


@pytest.mark.parametrize("command", [["show"], ["show", "--failures"]])
def test_commands_that_compare_say_so(old, command, capsys):
    main.run([*command, str(old)])
    said = capsys.readouterr().err
    assert WORD in said
    assert "run them again" in said


def test_the_page_says_so_beside_the_run(old):
    text = document.write(old).read_text()
    assert text.count("an earlier version judged this run by its own plan") == 1


def test_runs_of_this_version_need_no_word(tmp_path):
    folder = Folder(tmp_path)
    folder.add("one")
    assert judged_before(Results.open(folder.out).runs) == ""


@pytest.mark.parametrize("first", [-1, 10**12])
def test_a_plan_from_a_step_that_cannot_be_is_damage(old, first):
    run = Results.open(old).runs[0]
    with np.load(run.folder / "plans.npz") as arrays:
        changed = {**arrays, "00/first_step": np.array(first)}
    np.savez(run.folder / "plans.npz", **changed)
    with pytest.raises(DAMAGE, match="first step"):
        run.unattacked()
