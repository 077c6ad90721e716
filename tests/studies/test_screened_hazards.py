"""`screen` on forty places with four planted flaws, and on flaws planted in `sumo_nets`."""

import importlib.util
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from deepmf_sumo.roadcheck.screening import GUIDELINES, screen

ROOT = Path(__file__).resolve().parents[2]


def _script(name):
    spec = importlib.util.spec_from_file_location(
        f"screened_{name}", ROOT / "studies" / "hazards" / f"{name}.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


BUILD, FLAWS = _script("build"), _script("flaws")


@pytest.fixture(scope="module")
def net(tmp_path_factory, starts_sumo):
    return BUILD.build(tmp_path_factory.mktemp("hazards")).with_name("hazards.net.xml")


@pytest.fixture(scope="module")
def sound(tmp_path_factory, starts_sumo):
    return BUILD.build(tmp_path_factory.mktemp("sound"), ()).with_name("hazards.net.xml")


def named(file, book="rilsa"):
    """Rules by place."""
    found = {}
    for one in screen(file, GUIDELINES[book]).findings:
        found.setdefault(re.match(r"[a-z]+\d", one.worst.junction)[0], set()).add(one.worst.rule)
    return found


def test_all_four_flaws_and_at_most_two_sound_places_are_named(net):
    found = named(net)
    assert found["merge3"] == {"merge"}
    assert found["signal6"] == {"yellow", "intergreen"}
    assert found["left1"] == {"permissive_left"}
    assert found["stop8"] == {"no_priority"}
    assert len(found.keys() - set(BUILD.FLAWED)) <= 2


def test_without_flaws_only_the_limits_at_two_signals_are_named(sound):
    assert set(map(str, named(sound).values())) <= {"{'signal_speed'}"}
    assert not set(named(sound)) & set(BUILD.FLAWED)


def test_by_ite_three_flaws_are_errors(net):
    """The left turn meets one lane below 45 mph, which ITE's rule allows."""
    screened = screen(net, GUIDELINES["ite"])
    errors = {one.worst.junction for one in screened.findings if one.severity == "error"}
    assert {"merge3_nose", "signal6_mid", "stop8_mid"} <= errors
    assert "left1" not in named(net, "ite")


@pytest.mark.parametrize(
    ("name", "flaw", "rule"),
    [
        ("four_way", "no_yellow", "yellow"),
        ("four_way", "permissive_left", "permissive_left"),
        ("rural", "no_priority", "no_priority"),
        ("roundabout", "no_priority", "no_priority"),
        ("rural", "fast_approach", "speed_step"),
        ("four_way", "fast_approach", "signal_speed"),
    ],
)
def test_flaws_of_other_networks_are_named(name, flaw, rule, tmp_path):
    file = ROOT / "sumo_nets" / name / f"{name}.net.xml"
    tree = ET.parse(file)
    network = FLAWS.Network(tree.getroot())
    kind = FLAWS.FLAWS[flaw]
    junction, pair = next(
        (one, pair) for one in network.junctions for pair in kind.where(network, one)
    )
    kind.plant(network, junction, pair)
    tree.write(tmp_path / "flawed.net.xml")

    def cases(which):
        found = screen(which, GUIDELINES["rilsa"]).findings
        return sum(
            one.cases
            for one in found
            if (one.worst.rule, one.worst.junction) == (rule, junction.name)
        )

    assert cases(tmp_path / "flawed.net.xml") > cases(file)
