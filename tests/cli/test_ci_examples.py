"""The example workflows of docs/ci, and the action: what they run works, what they name is made."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from deepmf_sumo.results import gate

from tests.support import tiny_network

CI = Path(__file__).resolve().parents[2] / "docs" / "ci"


def commands(job):
    """The shell lines of a GitHub or GitLab job, without installation."""
    lines = job.get("script") or [step["run"] for step in job["steps"] if "run" in step]
    return [line for line in lines if not line.startswith("pip ")]


GITHUB = yaml.safe_load((CI / "github.yml").read_text())["jobs"]["attack"]
GITLAB = yaml.safe_load((CI / "gitlab.yml").read_text())["av"]
ACTION = yaml.safe_load((CI.parents[1] / "action.yml").read_text())


@pytest.fixture
def repository(tmp_path, tiny):
    """A repository as the workflows expect it, and this program on its path."""
    scenarios = tmp_path / "av" / "scenarios"
    shutil.copytree(tiny, scenarios, ignore=shutil.ignore_patterns("*.yaml"))  # others' specs
    for number in range(5):
        tiny_network.spec(scenarios, f"quiet {number}", seed="1")
    text = (CI / "thresholds.yaml").read_text()
    few = text.replace("rule_out: {impact_mps: 3.0}", "rule_out: {impact_mps: 10.0}")
    assert few != text  # five specs that are equal rule out 9 m/s, and nineteen 3 m/s
    (tmp_path / "av" / "thresholds.yaml").write_text(few)
    program = tmp_path / "bin" / "deepmf-sumo"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m deepmf_sumo.cli.main "$@"\n')
    program.chmod(0o755)
    return tmp_path


def run(repository, line, **environment):
    path = f"{repository / 'bin'}{os.pathsep}{os.environ['PATH']}"
    added = {"PATH": path, "GITHUB_STEP_SUMMARY": str(repository / "page.md"), **environment}
    return subprocess.run(
        ["bash", "-e", "-o", "pipefail", "-c", line], cwd=repository, check=False,
        capture_output=True, text=True, env={**os.environ, **added},
    )  # fmt: skip


def test_the_workflow_works(repository):
    """As by hand: attack and make the baseline; then the job, line by line. With fewer seeds."""
    _, attack, check = commands(GITHUB)
    assert "--seeds 1-5 " in attack
    done = run(repository, attack.replace("--seeds 1-5 ", "--seeds 1 "))
    assert done.returncode == 0, done.stdout + done.stderr
    assert run(repository, check).returncode == 2  # there is no baseline yet, and here it is
    shutil.move(repository / "results" / "gate.json", repository / "av" / "baseline.json")
    done = run(repository, check)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "against" in done.stdout
    assert "## deepmf-sumo: passed" in (repository / "page.md").read_text()
    for file in (GITLAB["artifacts"]["reports"]["junit"], "results/gate.json"):
        assert (repository / file).is_file()


@pytest.mark.slow
def test_the_workflow_begins_with_a_look_at_the_machine(repository):
    done = run(repository, commands(GITHUB)[0])
    assert done.returncode == 0, done.stdout + done.stderr
    assert {line.split()[0] for line in done.stdout.splitlines()[1:]} <= {"ok", "warn"}


def test_failed_runs_reach_the_check(repository):
    """`run` ends with 1 or 3: the job goes on; with 2, a wrong spec, it ends."""
    attack = commands(GITHUB)[1]
    for code, passed in ((0, 0), (1, 0), (3, 0), (2, 1), (130, 1)):
        program = repository / "bin" / "deepmf-sumo"
        program.write_text(f"#!/bin/sh\nexit {code}\n")
        assert run(repository, attack).returncode == passed


def test_both_services_run_the_same():
    page = '"$GITHUB_STEP_SUMMARY"'
    assert [line.replace(page, "results/gate.md") for line in commands(GITHUB)] == commands(GITLAB)


def test_the_example_thresholds_are_read():
    found = gate.load(CI / "thresholds.yaml")
    assert found.max_av_collision_rate == 0.5
    assert found.baseline.results.endswith("docs/ci/baseline.json")


def action(repository, name, **inputs):
    """Run a step of the action as GitHub would, with defaults for all other inputs."""
    [step] = [step for step in ACTION["runs"]["steps"] if step.get("name") == name]
    given = {key: spec.get("default") for key, spec in ACTION["inputs"].items()} | inputs
    environment = {
        variable: str(given[re.fullmatch(r"\$\{\{ inputs\.([\w-]+) \}\}", value)[1]])
        for variable, value in step["env"].items()
    }
    assert step["shell"] == "bash"
    return run(repository, step["run"], **environment)


def test_the_action_attacks_and_judges(repository):
    options = "--no-pictures --set adversary=none"
    inputs = {"specs": "av/scenarios/*0.yaml av/scenarios/*1.yaml", "arguments": options}
    done = action(repository, "attack", **inputs)
    assert done.returncode == 0, done.stdout + done.stderr
    done = action(repository, "check")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "## deepmf-sumo: passed" in (repository / "page.md").read_text()
    assert (repository / "results" / "gate.xml").is_file()
    (repository / "old").mkdir()
    shutil.move(repository / "results" / "gate.json", repository / "old" / "base line.json")
    strict = repository / "strict.yaml"
    strict.write_text("version: 1\nmin_judged_runs: 99\n")
    done = action(repository, "check", baseline="old/base line.json", thresholds="strict.yaml")
    assert done.returncode == 3, done.stdout + done.stderr
    assert "base line.json" in done.stdout


def test_failed_runs_of_the_action_reach_the_check(repository):
    for code, passed in ((0, 0), (1, 0), (3, 0), (2, 1), (130, 1)):
        program = repository / "bin" / "deepmf-sumo"
        program.write_text(f"#!/bin/sh\nexit {code}\n")
        assert action(repository, "attack", specs="a.yaml").returncode == passed


def test_the_action_installs_this_package_with_the_build_that_is_asked_for(repository):
    """`pip` and `uv` are replaced by programs that note what they are asked for."""
    for name in ("pip", "uv", "deepmf-sumo"):
        program = repository / "bin" / name
        program.write_text(f'#!/bin/sh\necho {name} "$@" >> asked\n')
        program.chmod(0o755)
    for torch in ("cpu", ""):
        assert action(repository, "install", package="my package", torch=torch).returncode == 0
    install = "uv pip install --quiet --system"
    assert (repository / "asked").read_text().splitlines() == [
        "pip install --quiet uv==0.13.9", f"{install} --torch-backend cpu my package",
        "deepmf-sumo doctor",
        "pip install --quiet uv==0.13.9", f"{install} my package", "deepmf-sumo doctor",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("out", "name"),
    [
        ("results", "results"),
        ("build/results", "build-results"),
        ("./a b/ü:1", "a-b----1"),
        ('x"y\nz', "x-y-z"),
    ],
)
def test_the_artifact_has_a_name_that_github_takes(repository, monkeypatch, out, name):
    monkeypatch.setenv("LC_ALL", "C")
    monkeypatch.setenv("GITHUB_OUTPUT", str(repository / "output"))
    assert action(repository, "name", out=out).returncode == 0
    assert (repository / "output").read_text() == f"artifact={name}\n"


def test_what_others_wrote_is_pinned():
    """A tag can be moved to another program."""
    for steps in (ACTION["runs"]["steps"], GITHUB["steps"]):
        for used in filter(None, (step.get("uses") for step in steps)):
            assert re.fullmatch(r"actions/[a-z-]+@[0-9a-f]{40}", used)


def test_inputs_reach_the_shell_of_the_action_as_variables_alone():
    """Put into the text of a command, an input could be a command itself."""
    steps = ACTION["runs"]["steps"]
    assert not any("${{" in step["run"] for step in steps if "run" in step)
    used = set(re.findall(r"inputs\.([\w-]+)", str(steps) + str(ACTION["outputs"])))
    assert used == set(ACTION["inputs"])
    assert all(spec["description"] for spec in ACTION["inputs"].values())
