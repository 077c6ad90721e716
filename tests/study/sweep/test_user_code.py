"""Which files of a user's code count, against what Python itself loads from outside its own."""

import json
import subprocess
import sys

import pytest

from deepmf_sumo.study.sweep import inputs

PLANNER = """
import json, math, numpy
from pathlib import Path
import importlib
from helpers import gain
from .inner import limits
KIND = "computed"
chosen = importlib.import_module(f"{KIND}_module")
TABLE = json.loads(Path(__file__).with_name("table.json").read_text())
def act():
    import late
    open("trace.log", "w")
    return late.x, (Path(__file__).parent / "data" / "net.onnx").read_bytes()
class Mine: pass
"""
FILES = {
    "helpers/__init__.py": "",
    "helpers/gain.py": "from helpers import deeper\n",
    "helpers/deeper.py": "CRUISE = 12\n",
    "helpers/unused.py": "x = 1\n",
    "computed_module.py": "x = 1\n",
    "late.py": "from latest import y as x\n",
    "latest.py": "y = 1\n",
    "neighbour.py": "x = 1\n",
}
PACKAGE = {
    "__init__.py": "",
    "planner.py": PLANNER,
    "inner/__init__.py": "",
    "inner/limits.py": "LEAST = 1\n",
    "table.json": "{}",
    "data/net.onnx": "1",
    "unused.py": "x = 1\n",
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for name, text in FILES.items():
        write(tmp_path / name, text)
    write(tmp_path / "trace.log", "of an earlier run")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:  # other tests have modules of these names elsewhere
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def write(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def names(folder, paths):
    return {str(path.relative_to(folder)) for path in paths}


def packaged(folder, package):
    for name, text in PACKAGE.items():
        write(folder / package / name, text.replace("from .inner", f"from {package}.inner"))


def loaded(folder, module):
    """What another Python loads for the module and its call, from the folder."""
    code = (
        f"import json, sys, {module} as m\nm.act()\n"
        "print(json.dumps([getattr(x, '__file__', None) for x in sys.modules.values()]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, check=True, capture_output=True, text=True
    )
    files = [file for file in json.loads(done.stdout) if file and str(folder) in file]
    return {file.removeprefix(f"{folder}/") for file in files}


@pytest.mark.sumo
def test_all_that_python_loads_counts_and_no_neighbour(folder):
    packaged(folder, "one")
    __import__("one.planner")
    found = inputs.of_module("one.planner")
    told = names(folder, found)
    assert told == {
        "one", "helpers/__init__.py", "helpers/gain.py", "helpers/deeper.py",
        "computed_module.py", "late.py", "latest.py",
    }  # fmt: skip
    there = {name for name in loaded(folder, "one.planner") if not name.startswith("one/")}
    assert there <= told


def test_without_being_imported_all_but_computed_names_are_found(folder):
    packaged(folder, "two")
    told = names(folder, inputs.of_module("two.planner"))
    assert {"two", "helpers/deeper.py", "late.py", "latest.py"} <= told
    assert "two.planner" not in sys.modules


@pytest.mark.parametrize(
    ("file", "counts"),
    [
        ("three/planner.py", True),
        ("three/unused.py", True),  # of the planner's own package
        ("three/inner/limits.py", True),
        ("three/table.json", True),
        ("three/data/net.onnx", True),
        ("helpers/deeper.py", True),
        ("latest.py", True),
        ("helpers/unused.py", False),
        ("neighbour.py", False),
        ("trace.log", False),
    ],
)
def test_content_counts(folder, file, counts):
    packaged(folder, "three")

    def digests():
        return [inputs.digest(path) for path in inputs.of_module("three.planner")]

    before = digests()
    assert all(before)
    write(folder / file, "another = 2\n")
    assert (digests() != before) == counts


def test_a_module_in_a_folder_that_is_no_package_is_alone_with_what_it_names(folder):
    write(folder / "tools/mine.py", 'import json\nfrom pathlib import Path\nFILE = "data/t.csv"\n')
    write(folder / "tools/data/t.csv", "1")
    write(folder / "tools/other.py", "")
    told = names(folder, inputs.of_module("tools.mine"))
    assert told == {"tools/mine.py", "tools/data/t.csv"}


def test_a_program_counts_with_what_it_imports_from_beside_itself(folder):
    write(folder / "prog/main.py", 'import os, near\nfrom pkg import part\nopen("model.bin", "rb")')
    for name in ("near.py", "pkg/__init__.py", "pkg/part.py", "model.bin", "unused.py"):
        write(folder / "prog" / name, "")
    told = names(folder / "prog", inputs.of_program(folder / "prog/main.py"))
    assert told == {"main.py", "near.py", "pkg/__init__.py", "pkg/part.py", "model.bin"}
    assert inputs.of_program(folder / "no.py") == []
    assert inputs.of_module("no_such_module") == []


def test_installed_packages_do_not_count_but_an_installed_planner_does():
    assert inputs.of_module("numpy.linalg")[0].name == "numpy"
    assert len(inputs.of_module("pydantic.main")) == 1
