"""Files that a repository is expected to have, and that they say what is so."""

import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
import yaml

import deepmf_sumo

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
ACTION = yaml.safe_load((ROOT / "action.yml").read_text("utf-8"))


def test_citation_and_project_agree():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert (citation["title"], citation["license"]) == (PROJECT["name"], PROJECT["license"])
    assert set(citation["keywords"]) <= set(PROJECT["keywords"])
    names = {author["name"] for author in PROJECT["authors"]}
    assert {author["name"] for author in citation["authors"]} == names
    paper = citation["references"][0]
    assert "2412.17487" in paper["url"]
    assert len(paper["authors"]) == 5


def test_classifiers_name_the_versions_that_are_supported():
    supported = {one for one in PROJECT["classifiers"] if one.startswith("Programming Language")}
    least = PROJECT["requires-python"].removeprefix(">=")
    assert f"Programming Language :: Python :: {least}" in supported
    assert "Typing :: Typed" in PROJECT["classifiers"]
    assert (ROOT / "deepmf_sumo" / "py.typed").exists()


def test_the_image_has_a_supported_python_and_all_that_the_wheel_needs():
    text = (ROOT / "Dockerfile").read_text("utf-8")
    versions = re.findall(r"^FROM python:(\d+\.\d+)-slim", text, re.MULTILINE)
    assert len(set(versions)) == 1
    assert f"Programming Language :: Python :: {versions[0]}" in PROJECT["classifiers"]
    copied = {word for line in re.findall(r"^COPY (?!--)(.*) \S+$", text, re.MULTILINE)
              for word in line.split()}  # fmt: skip
    assert all((ROOT / name).exists() for name in copied)
    wanted = set((ROOT / ".dockerignore").read_text("utf-8").split())
    assert {f"!{name}" for name in copied} <= wanted
    build = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["hatch"]["build"]
    included = build["targets"]["wheel"]["force-include"]
    assert {Path(name).parts[0] for name in included} <= copied


@pytest.mark.sumo
@pytest.mark.slow
def test_the_image_is_built_and_runs():
    if shutil.which("docker") is None:
        pytest.skip("docker is not installed")
    if subprocess.run(["docker", "info"], check=False, capture_output=True).returncode:
        pytest.skip("no docker daemon is running")
    subprocess.run(["docker", "build", "-t", "deepmf-sumo:test", "."], cwd=ROOT, check=True)
    run = ["docker", "run", "--rm", "deepmf-sumo:test", "--version"]
    done = subprocess.run(run, check=True, capture_output=True, text=True)
    assert deepmf_sumo.__version__ in done.stdout


def test_the_action_passes_all_its_inputs_by_the_environment():
    """An input inside a command would be run as code."""
    used = set()
    for step in ACTION["runs"]["steps"]:
        assert "${{" not in step["run"]
        used |= set(re.findall(r"inputs\.(\w+)", " ".join(step["env"].values())))
    assert used == set(ACTION["inputs"])


@pytest.mark.sumo
def test_the_action_attacks_and_judges(tmp_path):
    """Its commands, on a spec whose expectation breaks: the gate, and no step before, says so."""
    shell = {step["name"]: step["run"] for step in ACTION["runs"]["steps"]}
    values = {
        "SPECS": str(ROOT / "scenarios" / "cut_in.yaml"), "SEEDS": "1-2", "OUT": "out",
        "THRESHOLDS": "limits.yaml", "BASELINE": "", "GITHUB_STEP_SUMMARY": "summary.md",
    }  # fmt: skip
    (tmp_path / "limits.yaml").write_text("version: 1\nmax_av_collision_rate: 0.0\n")
    program = Path(os.environ.get("VIRTUAL_ENV", ROOT / ".venv")) / "bin"
    env = {**os.environ, **values, "PATH": f"{program}:{os.environ['PATH']}"}
    codes = [
        subprocess.run(
            ["bash", "-e", "-c", shell[name]], cwd=tmp_path, env=env, check=False, timeout=200
        ).returncode
        for name in ("attack", "check")
    ]
    assert codes == [0, 1]
    assert "max_av_collision_rate" in (tmp_path / "summary.md").read_text("utf-8")
    assert {"gate.xml", "gate.json"} <= {path.name for path in (tmp_path / "out").iterdir()}
