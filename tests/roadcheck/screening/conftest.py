"""Networks of `sumo_nets` with one thing changed."""

from pathlib import Path

import pytest

from deepmf_sumo.roadcheck.screening import GUIDELINES, screen

NETS = Path(__file__).resolve().parents[3] / "sumo_nets"


@pytest.fixture
def changed(tmp_path):
    """Screen a network after replacements of text, each of which must change something."""

    def screened(name, *replacements, book="rilsa"):
        text = (NETS / name / f"{name}.net.xml").read_text("utf-8")
        for old, new in replacements:
            assert old in text, old
            text = text.replace(old, new)
        file = tmp_path / f"{name}.net.xml"
        file.write_text(text, "utf-8")
        return screen(file, GUIDELINES[book])

    return screened
