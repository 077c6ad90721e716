"""Fixtures that all tests share."""

import multiprocessing
import os
from pathlib import Path

import pytest

from deepmf_sumo.study.sweep import workers

from tests.support import (
    continuity,
    events_told,
    forked_workers,
    road_user_invariant,
    started_programs,
    tiny_network,
    walked_ground,
)

ROOT = Path(__file__).resolve().parents[1]
RUN_COMMANDS = {"cli", "plans", "simulation"}
"""Folders in which most tests run SUMO or a whole command: all their tests are marked `sumo`."""
WOMD = ROOT.parent / "shared" / "womd"

# Before torch is loaded. Test processes share the cores: threads of torch that wait for each other
# quadruple the time of a training.
os.environ.setdefault("OMP_NUM_THREADS", "1")


@pytest.hookimpl(tryfirst=True)  # before pytest selects by `-m`
def pytest_collection_modifyitems(items) -> None:
    for item in items:
        folders = item.path.relative_to(ROOT / "tests").parts[:-1]
        if RUN_COMMANDS.intersection(folders) or started_programs.FIXTURE in item.fixturenames:
            item.add_marker(started_programs.MARK)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    started_programs.check(item)
    continuity.excuse(item.get_closest_marker("jumps"))
    try:
        return (yield)
    finally:
        started_programs.check(None)
        continuity.excuse(None)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    result = yield
    if sentence := started_programs.refusal():
        pytest.fail(sentence, pytrace=False)
    return result


@pytest.fixture(scope="session")
def starts_sumo() -> None:
    """For fixtures that start SUMO or a process: marks the tests that use them."""


@pytest.fixture(scope="session", autouse=True)
def _forked_workers():
    with pytest.MonkeyPatch.context() as patch:
        forked_workers.use(patch)
        yield


@pytest.fixture(scope="session", autouse=True)
def _road_users():
    with pytest.MonkeyPatch.context() as patch:
        road_user_invariant.use(patch)
        yield


@pytest.fixture(scope="session", autouse=True)
def _nothing_jumps():
    with pytest.MonkeyPatch.context() as patch:
        continuity.use(patch)
        walked_ground.use(patch)
        events_told.use(patch)
        yield


@pytest.fixture
def spawned_workers(monkeypatch) -> None:
    """Workers that begin as those of users do."""
    monkeypatch.setattr(workers, "multiprocessing", multiprocessing)


@pytest.fixture(scope="session")
def womd() -> Path:
    """Folder of recorded scenes, which the repository does not contain."""
    if not (WOMD / "val").is_dir():
        pytest.skip(f"no recorded scenes in {WOMD}")
    return WOMD


@pytest.fixture(scope="session")
def tiny(tmp_path_factory, starts_sumo) -> Path:
    """Folder of a tiny network."""
    folder = tmp_path_factory.mktemp("tiny")
    tiny_network.build(folder)
    return folder


@pytest.fixture(autouse=True)
def home(tmp_path_factory, monkeypatch) -> None:
    """A data folder for each test, so that none sees what another has cached."""
    monkeypatch.setenv("DEEPMF_SUMO_HOME", str(tmp_path_factory.mktemp("home")))
