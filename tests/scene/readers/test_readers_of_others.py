"""A reader of another package: what is public is enough, and the package does the rest."""

import ast
import inspect
import os
import signal
import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepmf_sumo import files, plugins
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.scene import Polygon, Source, readers
from deepmf_sumo.scene.readers import Refusal
from deepmf_sumo.scene.readers.base import RecordRef
from deepmf_sumo.scene.readers.raw import RawScene, RawTracks, lane_links
from deepmf_sumo.scene.readers.raw.one_file import head
from deepmf_sumo.scene.readers.raw.road import RoadBuilder, SignalsBuilder

from tests.support import recordings_by_hand as by_hand

pytestmark = pytest.mark.sumo


class Straight:
    """Lines ``name,speed``: scenes of an AV on a straight road of two lanes, several in a file."""

    def recordings(self, root):
        if head(root, 9) != b"straight\n":
            return
        for number, line in enumerate(self._lines(root)):
            yield RecordRef(file=root, name=line.partition(",")[0], record=number)

    def load(self, ref):
        name, _, speed = self._lines(ref.file)[ref.record].partition(",")
        if speed == "crash":
            os.kill(os.getpid(), signal.SIGKILL)
        if speed == "lost":
            raise ReaderError(f"{ref.file} record {ref.record}: the speed is lost.")
        x = float(speed) * 0.1 * np.arange(91)
        road = RoadBuilder()
        for lane, y in (("right", 0.0), ("left", 3.5)):
            points = np.arange(0.0, 200.0, 1.0)
            road.lane(lane, "street", np.column_stack([points, y + 0 * points, 0 * points]))
        road.lanes = lane_links.linked(list(road.lanes.values()))
        return RawScene(
            name=name,
            source=Source(dataset="straight", file=str(ref.file), record=ref.record, sha256=""),
            now=10,
            timestamps_s=np.zeros(0),
            tracks=RawTracks(
                ids=["av"],
                kinds=["vehicle"],
                size_m=np.full((1, 91, 3), [4.8, 1.9, 1.5]),
                position_m=np.stack([x, 0 * x, 0 * x], axis=-1)[None],
                heading_rad=np.zeros((1, 91)),
                velocity_mps=np.full((1, 91, 2), [float(speed), 0.0]),
                valid=np.ones((1, 91), bool),
            ),
            road=road.built(),
            signals=SignalsBuilder([], 0).built(),
            av_id="av",
        )

    @staticmethod
    def _lines(root):
        return files.content(root, 2**20).decode().split()[1:]


class Boxed(Straight):
    """The same in a folder of its own: ``box/scenes`` beside notes."""

    def roots(self, folder):
        return [folder] if (folder / "scenes").is_file() else None

    def recordings(self, root):
        return super().recordings(root / "scenes")


@pytest.fixture
def data(tmp_path, monkeypatch):
    load, names = plugins.load, plugins.names("readers")
    others = {"straight": Straight, "boxed": Boxed}
    monkeypatch.setattr(plugins, "names", lambda kind: sorted([*names, *others]))
    monkeypatch.setattr(plugins, "load", lambda kind, name: others.get(name) or load(kind, name))
    (tmp_path / "a.straight").write_text("straight\none,10\ntwo,lost\nthree,nan\nfour,5\n")
    by_hand.shard(tmp_path / "b.tfrecord", by_hand.scenario(name="x"))
    box = tmp_path / "box"
    box.mkdir()
    (box / "scenes").write_text("straight\nfive,7\n")
    (box / "notes").write_text("no recording")
    return tmp_path


def test_it_is_found_listed_read_and_checked_as_any(data):
    assert readers.ids(data, data / ".cache") == ["one", "two", "three", "four", "x", "five"]
    one, two, three, four, x, five = readers.scenes([data])
    assert [scene.name for scene in (one, four, x, five)] == ["one", "four", "x", "five"]
    assert one.road.lanes["right"].left[0].lane_id == "left"
    assert "the speed is lost" in two.reason
    assert "the AV (av) has no valid state" in three.reason  # of the checks, with the place
    assert three.reason.startswith(f"{data / 'a.straight'} record 2: ")
    assert (two.dataset, two.name) == ("straight", "two")
    for _ in range(2):
        assert readers.scene(data, "four", data / ".cache").source.record == 3
    assert readers.scene(data, "five").tracks.velocity_mps[0, 0].tolist() == [7.0, 0.0]


def test_a_crash_of_it_costs_the_rest_of_its_file(data):
    (data / "a.straight").write_text("straight\none,10\ntwo,crash\nfour,5\n")
    found = list(readers.scenes([data]))
    assert [isinstance(one, Refusal) for one in found] == [False, True, False, False]
    assert "reading it ended the process (SIGKILL)" in found[1].reason
    assert readers.read(list(readers.records(data / "a.straight"))[2]).name == "four"


@pytest.mark.parametrize("beside", ["buildings", "footways", "water"])
def test_what_it_says_of_areas_beside_the_road_is_kept(data, beside):
    raw = Straight().load(next(Straight().recordings(data / "a.straight")))
    area = Polygon(id="a", kind="building", points_m=np.eye(3, 2), z_m=np.zeros(3))
    lost = replace(area, id="lost", points_m=np.full((3, 2), np.nan))
    scene = readers.repair(replace(raw, road=replace(raw.road, **{beside: (area, lost)})))
    assert [one.id for one in getattr(scene.road, beside)] == ["a"]
    assert any("out of range, were dropped: lost" in one for one in scene.repairs)


def test_it_needs_nothing_private():
    used = ast.walk(ast.parse(textwrap.dedent(inspect.getsource(Straight))))
    names = {one.attr for one in used if isinstance(one, ast.Attribute)} - {"_lines"}
    lines = Path(__file__).read_text().splitlines()
    imported = [line for line in lines if line.startswith("from deepmf_sumo")]
    assert not [name for name in names if name.startswith("_")]
    assert not [line for line in imported if "._" in line or "import _" in line]
