"""The weights in the package: small, free, trained on nothing but SUMO traffic, and honest."""

from pathlib import Path

import pytest

import deepmf_sumo
from deepmf_sumo.deepmf.networks import weights
from deepmf_sumo.training import cards

PACKAGED = Path(deepmf_sumo.__file__).parent / "weights"


def test_the_package_holds_open_alone_and_at_most_20_mb():
    assert [folder.name for folder in PACKAGED.iterdir() if folder.is_dir()] == ["open"]
    assert sum(file.stat().st_size for file in PACKAGED.rglob("*") if file.is_file()) < 20e6


@pytest.mark.parametrize("network", weights.listed(PACKAGED / "open"))
def test_each_card_says_how_it_was_made_and_what_it_must_not_be_taken_for(network):
    card = weights.read_card(PACKAGED / "open", network)
    assert "Apache-2.0" in card["licence"]
    assert card["limits"] == cards.LIMITS[network]
    assert "deepmf-sumo train" in card["command"]
    assert "womd" not in f"{card['data']} {card['command']}".lower()
    assert card["hours"] > 0
    page = (PACKAGED / "open" / "card.md").read_text(encoding="utf-8")
    assert f"## {network}\n" in page
    assert card["limits"] in page
