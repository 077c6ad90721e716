"""What people expect in a repository, citation to image: it says what the package says."""

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import libsumo
import pytest
import sumo
import yaml
from packaging.requirements import Requirement

import deepmf_sumo

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
DOCKERFILE = (ROOT / "Dockerfile").read_text("utf-8").replace("\\\n", " ")
OLDEST = PROJECT["requires-python"].removeprefix(">=")
FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))
PACKAGES = {
    "libX11 libxcb libXau libXdmcp libbsd libmd": "libx11-6",
    "libXext": "libxext6",
    "libXrender": "libxrender1",
    "libGL libGLX libGLdispatch": "libgl1",
    "libatomic": "libatomic1",
    "libexpat": "libexpat1",
    "libz": "zlib1g",
    "libc libm libdl librt libpthread libresolv libstdc++ libgcc_s ld-linux-x86-64": "",
}
"""Debian packages of libraries, with what they depend on; the last ones are in every image."""


def recipe(target):
    """The lines that `make` runs for a target."""
    text = (ROOT / "Makefile").read_text("utf-8").replace("$(VENV)", ".venv")
    return re.search(rf"^{target}:.*\n((?:\t.*\n)+)", text, re.MULTILINE)[1].split("\n\t")


def test_the_citation_names_this_version_and_the_paper():
    found = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert found["cff-version"] == "1.2.0"
    assert {"message", "title", "authors"} <= set(found)
    assert found["version"] == deepmf_sumo.__version__
    assert found["license"] == PROJECT["license"]
    assert [one["name"] for one in found["authors"]] == [one["name"] for one in PROJECT["authors"]]
    [paper] = found["references"]
    assert {"type", "title", "authors"} <= set(paper)
    assert paper["url"].endswith("2412.17487")


def parts_of_the_changelog():
    text = (ROOT / "CHANGELOG.md").read_text("utf-8")
    return re.findall(r"^## (\S+)", text, re.MULTILINE)


def test_the_changelog_begins_with_this_version():
    parts = parts_of_the_changelog()
    assert parts[0] == deepmf_sumo.__version__
    assert len(set(parts)) == len(parts)


@pytest.mark.sumo
@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no Git history")
def test_tags_are_versions_of_the_changelog_and_that_of_this_commit_is_this_version():
    def tags(*which):
        command = ["git", "-C", str(ROOT), "tag", *which]
        names = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
        return {name for name in names if re.fullmatch(r"v\d+\.\d+\.\d+", name)}

    assert {name.removeprefix("v") for name in tags()} <= set(parts_of_the_changelog())
    assert tags("--points-at", "HEAD") <= {f"v{deepmf_sumo.__version__}"}


def test_what_continuous_integration_installs_is_locked_and_fits_what_is_asked_for():
    text = (ROOT / ".github" / "requirements-ci.txt").read_text("utf-8")
    locked = {}
    for block in re.split(r"\n(?=[a-z0-9])", text):
        if found := re.match(r"([a-z0-9][a-z0-9.-]*)==([^ ;]+)", block):
            assert "--hash=sha256:" in block
            locked.setdefault(found[1], set()).add(found[2])
    assert "://" not in text  # where the files come from is each machine's own affair
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["dependency-groups"]
    for line in (*PROJECT["dependencies"], *groups["dev"]):
        wanted = Requirement(line)
        versions = locked[wanted.name.lower().replace("_", "-")]
        assert all(wanted.specifier.contains(one) for one in versions), line
    for line in (ROOT / "constraints.txt").read_text("utf-8").splitlines():
        name, _, version = line.partition("==")
        if version and not line.startswith("#"):
            assert locked[name] == {version}


def test_python_of_classifiers_image_and_action_are_those_that_are_required():
    listed = [one.rpartition(" :: ")[2] for one in PROJECT["classifiers"] if "Python :: 3." in one]
    assert listed[0] == OLDEST
    images = re.findall(r"^FROM python:([\d.]+)-slim", DOCKERFILE, re.MULTILINE)
    action = yaml.safe_load((ROOT / "action.yml").read_text("utf-8"))
    assert len(images) == len(re.findall(r"^FROM", DOCKERFILE, re.MULTILINE)) == 2
    assert {*images, action["inputs"]["python-version"]["default"]} <= set(listed)


def test_the_workflow_tries_all_pythons_on_three_systems_and_publishes_tags_without_a_password():
    text = (ROOT / ".github" / "workflows" / "ci.yml").read_text("utf-8")
    found = yaml.safe_load(text)
    matrix = found["jobs"]["tests"]["strategy"]["matrix"]
    assert [one.partition("-")[0] for one in matrix["os"]] == ["ubuntu", "macos", "windows"]
    listed = [one.rpartition(" :: ")[2] for one in PROJECT["classifiers"] if "Python :: 3." in one]
    assert set(listed) <= set(matrix["python"])
    publish = found["jobs"]["publish"]
    assert set(publish["needs"]) == set(found["jobs"]) - {"publish"}
    assert publish["if"] == "startsWith(github.ref, 'refs/tags/v')"
    assert publish["permissions"] == {"id-token": "write"}
    assert found["permissions"] == {"contents": "read"}
    assert "secrets" not in text
    used = [
        step["uses"] for job in found["jobs"].values() for step in job["steps"] if "uses" in step
    ]
    assert all(re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}", one) for one in used)


def test_hooks_run_what_make_runs():
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text("utf-8"))
    [repository] = hooks["repos"]
    assert repository["repo"] == "local"
    lines = {line.strip() for target in ("lint", "types") for line in recipe(target)}
    entries = {hook["entry"] for hook in repository["hooks"]}
    assert entries == {line for line in lines if "ruff" in line or "mypy" in line}
    assert not any(hook["pass_filenames"] for hook in repository["hooks"])


@pytest.mark.parametrize("form", FORMS, ids=lambda path: path.stem)
def test_issue_forms_have_what_github_asks_for(form):
    found = yaml.safe_load(form.read_text("utf-8"))
    if form.stem == "config":
        assert set(found) <= {"blank_issues_enabled", "contact_links"}
        return
    assert found["name"]
    assert found["description"]
    fields = [part for part in found["body"] if part["type"] != "markdown"]
    assert len({part["id"] for part in fields}) == len(fields) > 0
    assert all(part["attributes"]["label"] for part in fields)


def copied():
    """The files and folders that the Dockerfile copies from the repository."""
    lines = re.findall(r"^COPY (?!--from)(.+) \S+$", DOCKERFILE, re.MULTILINE)
    return [name for line in lines for name in line.split()]


def test_the_image_is_small_and_not_of_root():
    assert {f"!{name}" for name in copied()} <= {
        line.strip() for line in (ROOT / ".dockerignore").read_text("utf-8").splitlines()
    }
    last = DOCKERFILE[DOCKERFILE.rindex("FROM") :]
    assert re.search(r"^USER (?!root)\w+$", last, re.MULTILINE)
    assert 'ENTRYPOINT ["deepmf-sumo"]' in last
    assert "ARG TORCH_BACKEND=cpu\n" in DOCKERFILE
    # users of the image cannot write __pycache__: without it a start takes twice as long
    assert "ENV PYC_INVALIDATION_MODE=UNCHECKED_HASH\n" in DOCKERFILE
    assert "--compile-bytecode" in re.search(r"^ENV INSTALL=(.*)$", DOCKERFILE, re.MULTILINE)[1]


@pytest.mark.sumo
def test_what_the_image_copies_makes_the_whole_package(tmp_path):
    pytest.importorskip("hatchling", reason="hatchling, which builds the wheel, is not installed")
    source = tmp_path / "source"
    for name in copied():
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_dir():
            without = shutil.ignore_patterns("__pycache__")
            shutil.copytree(ROOT / name, source / name, ignore=without)
        else:
            shutil.copy(ROOT / name, source / name)
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*build, "--wheel-dir", tmp_path, source], check=True, timeout=200)
    (wheel,) = tmp_path.glob("*.whl")
    packed = set(zipfile.ZipFile(wheel).namelist())
    files = {path for path in (ROOT / "deepmf_sumo").rglob("*") if path.is_file()}
    named = {str(path.relative_to(ROOT)) for path in files if "__pycache__" not in path.parts}
    assert named <= packed
    assert "deepmf_sumo/starter/paper.yaml" in packed


@pytest.mark.sumo
@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no Git history")
def test_the_source_archive_has_all_that_make_and_the_tests_read(tmp_path):
    pytest.importorskip("hatchling", reason="hatchling, which builds it, is not installed")
    build = [sys.executable, "-m", "hatchling", "build", "--target", "sdist", "-d", tmp_path]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True, timeout=200)
    (archive,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(archive) as opened:
        packed = {name.partition("/")[2] for name in opened.getnames()}
    command = ["git", "-C", str(ROOT), "ls-files"]
    listed = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split("\n")
    tracked = {name for name in listed if name and (ROOT / name).exists()}
    assert {name for name in tracked - packed if not name.startswith(".ci/")} == set()


@pytest.mark.sumo
@pytest.mark.skipif(shutil.which("ldd") is None, reason="ldd, which lists libraries, is not there")
def test_the_image_has_the_libraries_that_sumo_needs():
    programs = [Path(sumo.SUMO_HOME) / "bin" / name for name in ("sumo", "netconvert", "duarouter")]
    needed = {}
    for file in [*Path(libsumo.__file__).parent.glob("_libsumo*.so"), *programs]:
        done = subprocess.run(["ldd", file], check=True, capture_output=True, text=True)
        for line in done.stdout.splitlines():
            name, _, place = line.strip().partition(" => ")
            if "site-packages" not in place and "linux-vdso" not in name:
                needed[Path(name.split()[0]).name.partition(".so")[0]] = file.name
    known = {name: package for names, package in PACKAGES.items() for name in names.split()}
    assert set(needed) - set(known) == set()
    installed = re.search(r"apt-get install [^&]*", DOCKERFILE)[0].split()
    assert {known[name] for name in needed} - {""} <= set(installed)


def docker(*arguments):
    done = subprocess.run(
        ["docker", *arguments], check=False, capture_output=True, text=True, timeout=1500
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def has_docker():
    if shutil.which("docker") is None:
        return False
    return subprocess.run(["docker", "info"], check=False, capture_output=True).returncode == 0


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_image_is_built_and_attacks(tmp_path):
    if not has_docker():
        pytest.skip("no Docker daemon answers")
    docker("build", "--tag", "deepmf-sumo-test", str(ROOT))
    assert docker("run", "--rm", "--entrypoint", "id", "deepmf-sumo-test", "-u").strip() != "0"
    run = ["run", "--rm", "--user", str(os.getuid()), "--volume", f"{tmp_path}:/work"]
    docker(*run, "deepmf-sumo-test", "init", "start")
    spec = "start/scenarios/cut_in.yaml"
    docker(*run, "deepmf-sumo-test", "run", spec, "--no-pictures", "--out", "out")
    assert ",ok," in (tmp_path / "out" / "runs.csv").read_text("utf-8")


def test_the_results_are_one_page_and_say_how_each_table_was_made():
    text = (ROOT / "docs" / "results.md").read_text("utf-8")
    prose = "\n".join(line for line in text.splitlines() if not line.startswith("|"))
    prose = re.sub(r"\]\([^)]*\)", "]", re.sub(r"`[^`]*`", "", prose))
    assert len(re.findall(r"[A-Za-z][\w'-]*", text)) < 1200
    assert len(re.findall(r"(?<![\w.])\d[\d.,]*(?!\w)", prose)) <= 60
    sections = [part for part in re.split(r"^## ", text, flags=re.MULTILINE) if "\n|" in part]
    assert len(sections) >= 6
    commands = [
        re.search(r"`(deepmf-sumo|make) \w+", part.partition("\n|")[0]) for part in sections
    ]
    assert all(commands)


def test_the_notebook_lists_its_pages():
    folder = ROOT / "studies" / "notebook"
    listed = re.findall(r"\]\(([\w-]+\.md)\)", (folder / "README.md").read_text("utf-8"))
    assert sorted([*listed, "README.md"]) == sorted(path.name for path in folder.glob("*.md"))
