"""Fixtures that all tests share."""

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
WOMD = ROOT.parent / "shared" / "womd"


@pytest.fixture(scope="session")
def womd() -> Path:
    """Folder of recorded scenes, which the repository does not contain."""
    if not (WOMD / "val").is_dir():
        pytest.skip(f"no recorded scenes in {WOMD}")
    return WOMD
