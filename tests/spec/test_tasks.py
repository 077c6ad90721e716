import dataclasses
from pathlib import Path, PureWindowsPath
from types import SimpleNamespace

import pytest

from deepmf_sumo import spec
from deepmf_sumo.errors import SpecError
from deepmf_sumo.scene import readers
from deepmf_sumo.spec import tasks

from tests.support import tiny_network

pytestmark = pytest.mark.sumo


@pytest.mark.parametrize(
    ("name", "slug"), [("Cut-in on  A_1", "cut-in-on-a-1"), ("dcf8d2b708", "dcf8d2b708")]
)
def test_slug(name, slug):
    assert tasks.slug(name) == slug


@pytest.mark.parametrize(
    "name", ["con", "NUL", "aux.txt", "com1", r"a\b", r"C:\x", "trailing. ", "ä", "a:b", "-"]
)
def test_folders_of_runs_can_lie_on_windows(name):
    run = tasks.run_id_of(SimpleNamespace(name=name, seed=1), name)
    for folder in (run, f".{run}.partial"):  # as `episode.working_folder`
        path = PureWindowsPath(folder)
        assert path.parts == (folder,)
        assert not path.is_reserved()
        assert folder == folder.lower()  # Run and run are one folder there
        assert not folder.endswith((" ", "."))
    assert tasks.is_run_id(run)


def test_slugs_of_lossy_names_differ():
    names = ["ü", "é", "a/b", "a+b", "../..", "a" * 70, "a" * 71]
    slugs = [tasks.slug(name) for name in names]
    assert len(set(slugs)) == len(names)
    assert all(Path(slug).name == slug and len(slug) < 80 and slug[0] != "." for slug in slugs)


@pytest.fixture
def recording(tiny, monkeypatch):
    (tiny / "val").mkdir(exist_ok=True)
    found = [
        readers.RecordRef(file=tiny / "val" / "one", name=name, record=number)
        for number, name in enumerate(["a1", "b2", "c3"])
    ]
    monkeypatch.setattr(readers, "records", lambda path, cache: iter(found))

    def load(scenes: str):
        source = f"{{recording: val, scenes: {scenes}}}"
        return spec.load(tiny_network.spec(tiny, "rec", source=source))

    return load


@pytest.mark.parametrize(
    ("scenes", "expected"),
    [
        ("[a1, b2, c3]", ["a1", "b2", "c3"]),
        ("[c3, a1]", ["c3", "a1"]),
        ("{first: 2}", ["a1", "b2"]),
    ],
)
def test_scenes_of_a_recording(recording, tmp_path, scenes, expected):
    planned = tasks.plan([recording(scenes)], tmp_path)
    assert [task.scene for task in planned] == expected
    assert [task.run_id for task in planned] == [f"rec--{scene}--0" for scene in expected]
    assert planned[0].resolved()["source"]["scenes"] == [expected[0]]
    assert [task.record.name for task in planned] == expected


@pytest.mark.parametrize("scenes", ["all", "[a1, c3]", "{first: 4}"])
def test_a_scene_that_is_there_twice_is_not_lost(recording, tmp_path, monkeypatch, scenes):
    files = zip(("one", "one", "one", "two"), ("a1", "b2", "c3", "c3"), strict=True)
    found = [
        readers.RecordRef(file=tmp_path / file, name=name, record=number)
        for number, (file, name) in enumerate(files)
    ]
    monkeypatch.setattr(readers, "records", lambda path, cache: iter(found))
    with pytest.raises(SpecError, match=r"two scenes 'c3', in .*/one and in .*/two, so that one"):
        tasks.plan([recording(scenes)], tmp_path)
    assert len(tasks.plan([recording("[b2]")], tmp_path)) == 1


def test_no_scene_vanishes(recording, tmp_path, monkeypatch):
    found = [readers.RecordRef(file=tmp_path, name=f"s{n}", record=n) for n in range(5)]
    monkeypatch.setattr(readers, "records", lambda path, cache: iter(found))
    assert len(tasks.plan([recording("all")], tmp_path)) == len(found)


def test_unknown_scene(recording, tmp_path):
    with pytest.raises(SpecError, match=r"no scene 'b22'\. Did you mean 'b2'"):
        tasks.plan([recording("[b22]")], tmp_path)


def test_specs_of_one_name_on_a_network_are_called_after_their_moments(tiny, tmp_path):
    path = tiny_network.spec(tiny, "hits")
    early, late = (spec.load(path, [f"source.start_s={start}"]) for start in (1.5, 3))
    names = [task.run_id for task in tasks.plan([early, late], tmp_path)]
    assert names == ["hits--av-1-5s--0", "hits--av-3s--0"]
    assert [task.run_id for task in tasks.plan([early], tmp_path)] == ["hits--tiny--0"]
    with pytest.raises(SpecError, match="Two runs are called 'hits--av-3s--0'"):
        tasks.plan([early, late, late], tmp_path)


@pytest.mark.parametrize("begin_s", [100_000, 1_700_000_000])
def test_moments_of_days_and_of_calendars_keep_their_digits(tiny, tmp_path, begin_s):
    path = tiny_network.spec(tiny, "late")
    times = (begin_s + 10, begin_s + 10.5, begin_s + 11)
    specs = [spec.load(path, [f"source.start_s={start!r}"]) for start in times]
    found = tasks.plan(specs, tmp_path)
    assert [task.scene for task in found] == [f"av-{start}s" for start in times]
    assert len({tuple(task.entropy()) for task in found}) == len(times)


def test_filter(recording, tmp_path):
    assert [task.scene for task in tasks.plan([recording("all")], tmp_path, "B2")] == ["b2"]


def test_randomness_and_key_depend_on_the_run_alone(recording, tmp_path):
    first, second = tasks.plan([recording("[a1, b2]")], tmp_path)
    again = tasks.plan([recording("[b2, a1]")], tmp_path)[1]
    assert first.entropy() == again.entropy() != second.entropy()
    assert first.key != second.key
    other = dataclasses.replace(first, spec=first.spec.model_copy(update={"seed": 1}))
    assert other.key != first.key
