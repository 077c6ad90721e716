"""Fixtures that all tests share."""

from pathlib import Path

import pytest

from tests.support import tiny_network

ROOT = Path(__file__).resolve().parents[1]
WOMD = ROOT.parent / "shared" / "womd"


@pytest.fixture(scope="session")
def womd() -> Path:
    """Folder of recorded scenes, which the repository does not contain."""
    if not (WOMD / "val").is_dir():
        pytest.skip(f"no recorded scenes in {WOMD}")
    return WOMD


@pytest.fixture(scope="session")
def tiny(tmp_path_factory) -> Path:
    """Folder of a tiny network."""
    folder = tmp_path_factory.mktemp("tiny")
    tiny_network.build(folder)
    return folder


@pytest.fixture(autouse=True)
def home(tmp_path_factory, monkeypatch) -> None:
    """A data folder for each test, so that none sees what another has cached."""
    monkeypatch.setenv("DEEPMF_SUMO_HOME", str(tmp_path_factory.mktemp("home")))
