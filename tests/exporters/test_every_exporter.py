"""The exam that every exporter found must pass."""

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.errors import OutputError
from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.scene import SumoNet

from tests.support.rollout_doubles import case_of, contact_of, in_traffic, rollout_of, straight

STARTS_A_PROGRAM = {"openscenario"}
NEEDS = {"openodd": "openodd", "osi": "osi_utilities"}
ABOUT_THE_AV = {"openodd", "scene"}
"""No words for others: the former is of the AV alone, the latter has their ids."""


def marks(name):
    lacks = name in NEEDS and find_spec(NEEDS[name]) is None
    reason = f"{NEEDS.get(name)} is not installed: pip install deepmf-sumo[{name}]"
    skipped = [pytest.mark.skip(reason=reason)] * lacks
    return [*skipped, *[pytest.mark.sumo] * (name in STARTS_A_PROGRAM)]


NAMES = [pytest.param(name, marks=marks(name)) for name in plugins.names("exporters")]
NET = Path(__file__).resolve().parents[2] / "sumo_nets" / "four_way" / "four_way.net.xml"


def attacked():
    """A contact with the opponent; an agent that is there for a while, with an id to escape."""
    paths = {"av": straight(0, 0, 10, steps=41), "b": straight(30, 3, 5, steps=41)}
    rollout = rollout_of({**paths, 'a "<&>,\n': straight(0, -9, 0, steps=41)}, [contact_of()])
    valid = rollout.tracks.valid.copy()
    valid[2, :20] = False
    return replace(rollout, tracks=replace(rollout.tracks, valid=valid))


def unattacked():
    return rollout_of({"av": straight(0, 0, 10)}, opponent_id=None)


def raised():
    rollout = attacked()
    heights = np.full(rollout.tracks.z_m.shape, 8.0)
    return replace(rollout, tracks=replace(rollout.tracks, z_m=heights))


def recorded(folder):
    net = folder / "net.net.xml"
    net.write_bytes(NET.read_bytes())
    return replace(case_of(), net=SumoNet(file=net))


def traffic(folder):
    net = recorded(folder).net.file
    return replace(in_traffic(case_of()), net_file=net)


def contents(path: Path) -> dict[str, bytes]:
    """Bytes of a file, or of all files of a folder, by relative path."""
    files = [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())
    return {str(file.relative_to(path)): file.read_bytes() for file in files}


def write(name, rollout, case, path):
    """Write a rollout in a format with the settings that hold where none are given."""
    plugins.load("exporters", name).write(
        Exportable.of(rollout, case), path, plugins.settings("exporters", name, {})
    )


@pytest.mark.parametrize("name", NAMES)
def test_it_says_what_it_writes(name):
    exporter = plugins.load("exporters", name)
    assert exporter.FILE.rstrip("/") == Path(exporter.FILE).name
    assert exporter.__doc__
    assert exporter.write.__doc__


@pytest.mark.parametrize("case_in", [recorded, traffic])
@pytest.mark.parametrize("rollout_of_kind", [attacked, unattacked, raised])
@pytest.mark.parametrize("name", NAMES)
def test_it_writes_every_kind_of_rollout_and_case(name, rollout_of_kind, case_in, tmp_path):
    exporter, path = plugins.load("exporters", name), tmp_path / "out"
    path.mkdir()
    path /= exporter.FILE.rstrip("/")
    write(name, rollout_of_kind(), case_in(tmp_path), path)
    assert path.is_dir() == exporter.FILE.endswith("/")
    assert any(contents(path).values())
    assert list(path.parent.iterdir()) == [path]  # nothing is left beside it


@pytest.mark.parametrize("name", NAMES)
def test_writing_again_replaces_it_and_gives_the_same_bytes(name, tmp_path):
    path, case = tmp_path / "out", recorded(tmp_path)
    write(name, attacked(), case, path)
    before = contents(path)
    write(name, unattacked(), case, path)
    assert contents(path) != before
    write(name, attacked(), case, path)
    assert contents(path) == before


@pytest.mark.parametrize("name", [one for one in NAMES if not {*one.values} & ABOUT_THE_AV])
def test_it_says_who_was_made_and_says_it_of_nobody_else(name, tmp_path):
    exporter, case = plugins.load("exporters", name), recorded(tmp_path)
    settings, rollout, found = plugins.settings("exporters", name, {}), attacked(), []
    for number, made in enumerate([(), ("b",), rollout.tracks.ids[1:]]):
        path = tmp_path / str(number)
        run = replace(Exportable.of(rollout, case), made=made)
        exporter.write(run, path, settings)
        found.append(b"".join(contents(path).values()))
    assert len({*found}) == 3  # nothing else differs
    assert b"made" in found[1]


@pytest.mark.parametrize("name", NAMES)
def test_a_path_that_cannot_be_written_is_an_error_that_names_it(name, tmp_path):
    case = recorded(tmp_path)
    path = tmp_path / "file" / "out"
    path.parent.write_text("not a folder")
    with pytest.raises(OutputError, match=r"file/out cannot be written: "):
        write(name, attacked(), case, path)
