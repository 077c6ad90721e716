"""Laying out the starter files."""

from pathlib import Path

import pytest
import yaml

from deepmf_sumo.cli import init as starter
from deepmf_sumo.errors import OutputError, UsageError


def test_lays_out_specs_whose_networks_exist(tmp_path):
    written = starter.lay_out(tmp_path / "new" / "folder")
    specs = [path for path in written if path.suffix == ".yaml"]
    assert len(specs) >= 10
    for path in specs:
        network = yaml.safe_load(path.read_text())["source"]["network"]
        assert (path.parent / network).resolve() in {file.resolve() for file in written}
    assert not [path for path in written if "__pycache__" in path.parts]
    assert {path.name for path in written if path.suffix == ".py"} == {"build.py"}
    assert sorted(p.name for p in (tmp_path / "new" / "folder").iterdir()) == list(starter.FOLDERS)


def test_copies_bytes(tmp_path):
    starter.lay_out(tmp_path)
    for file in starter.starter_files():
        assert (tmp_path / file).read_bytes() == (starter.starter_home() / file).read_bytes()


def test_an_existing_file_stops_it_before_anything_is_written(tmp_path):
    mine = tmp_path / "scenarios" / "cut_in.yaml"
    mine.parent.mkdir()
    mine.write_text("mine")
    with pytest.raises(UsageError, match=r"cut_in\.yaml exists already"):
        starter.lay_out(tmp_path)
    assert mine.read_text() == "mine"
    assert [path.name for path in tmp_path.rglob("*")] == ["scenarios", "cut_in.yaml"]


def test_other_files_in_the_folder_are_left_alone(tmp_path):
    mine = tmp_path / "scenarios" / "mine.yaml"
    mine.parent.mkdir()
    mine.write_text("mine")
    starter.lay_out(tmp_path)
    assert mine.read_text() == "mine"


def test_a_failure_half_way_leaves_nothing(tmp_path, monkeypatch):
    real, calls = Path.replace, []

    def full_disk(source, target):
        calls.append(target)
        if len(calls) == 5:
            raise OSError(28, "No space left on device")
        return real(source, target)

    monkeypatch.setattr(Path, "replace", full_disk)
    with pytest.raises(OutputError, match="No space left"):
        starter.lay_out(tmp_path)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_a_file_in_the_place_of_the_folder_is_an_output_error(tmp_path):
    target = tmp_path / "file"
    target.write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        starter.lay_out(target)


def test_an_installation_without_starter_files_says_so(tmp_path, monkeypatch):
    module = tmp_path / "deepmf_sumo" / "__init__.py"
    module.parent.mkdir()
    module.write_text("")
    monkeypatch.setattr(starter.deepmf_sumo, "__file__", str(module))
    with pytest.raises(UsageError, match="install deepmf-sumo again"):
        starter.starter_home()
    for folder in starter.FOLDERS:
        (module.parent / "starter" / folder).mkdir(parents=True)
    assert starter.starter_home() == Path(module.parent / "starter").resolve()
