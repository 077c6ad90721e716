"""A road user has the same class in every exported file."""

import re
from dataclasses import replace
from typing import get_args
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.exporters import commonroad, fcd, openscenario, osi
from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.scene.road_users import RoadUserClass

from tests.exporters.test_every_exporter import recorded
from tests.support.foreign_readers import _doubles, wire
from tests.support.rollout_doubles import rollout_of, straight

# kind, length, width: sizes of SUMO's vehicle classes, and what a person would call them
THERE = {
    "av": ("vehicle", 4.8, 2.0, "car"),
    "passenger": ("vehicle", 5.0, 1.8, "car"),
    "delivery": ("vehicle", 6.5, 2.16, "car"),
    "truck": ("vehicle", 7.1, 2.4, "truck"),
    "between": ("vehicle", 7.0, 2.2, "truck"),
    "bus": ("vehicle", 12.0, 2.5, "truck"),
    "motorcycle": ("vehicle", 2.2, 0.9, "motorcycle"),
    "microcar": ("vehicle", 2.7, 1.5, "car"),
    "bicycle": ("cyclist", 1.6, 0.65, "bicycle"),
    "walker": ("pedestrian", 0.2, 0.5, "pedestrian"),
    "tram": ("other", 22.0, 2.4, "other"),
}


def run():
    paths = {name: straight(10 * at, 4 * at, 5.0) for at, name in enumerate(THERE)}
    rollout = rollout_of(paths, opponent_id="truck")
    kinds = tuple(THERE[name][0] for name in rollout.tracks.ids)
    size = np.array([[*THERE[name][1:3], 1.5] for name in rollout.tracks.ids])
    return replace(rollout, tracks=replace(rollout.tracks, kinds=kinds, size_m=size))


def of_commonroad(folder):
    text = (folder / commonroad.FILE).read_text("utf-8")
    pairs = re.findall(r"<!--(.*?)-->\s*<dynamicObstacle.*?<type>(.*?)</type>", text, re.DOTALL)
    return {name.strip(): {"unknown": "other"}.get(kind, kind) for name, kind in pairs}


def of_openscenario(folder):
    words = {"motorbike": "motorcycle", "obstacle": "other"}
    keys = ("vehicleCategory", "pedestrianCategory", "miscObjectCategory")
    root = ET.parse(folder / openscenario.FILE / openscenario.SCENARIO).getroot()
    found = {}
    for thing in root.iter("ScenarioObject"):
        word = next(one.get(key) for one in thing for key in keys if one.get(key))
        found[thing.find(".//Property[@name='id']").get("value")] = words.get(word, word)
    return found


def of_osi(folder):
    # numbers of osi_object.proto: MovingObject.Type, and VehicleClassification.Type
    things = {1: "other", 2: "vehicle", 3: "pedestrian"}
    vehicles = {4: "car", 7: "truck", 10: "motorcycle", 11: "bicycle"}
    content = (folder / osi.FILE / osi.TRACE).read_bytes()
    first = wire(content[4 : 4 + int.from_bytes(content[:4], "little")])
    found = {}
    for user in map(wire, first[5]):
        kind = things[user[3][0]]
        if kind == "vehicle":
            kind = vehicles[wire(user[6][0])[1][0]]
        found[wire(user[10][0])[3][0].decode()] = kind
        assert _doubles(wire(user[2][0])[1][0])[1] > 0
    return found


def of_fcd(folder):
    types = ET.parse(folder / fcd.FILE / fcd.TYPES).getroot()
    words = {"passenger": "car"}
    shapes = [words.get(one.get("guiShape"), one.get("guiShape")) for one in types.iter("vType")]
    return dict(zip(THERE, shapes, strict=True))


READ = {
    "commonroad": of_commonroad, "openscenario": of_openscenario, "osi": of_osi, "fcd": of_fcd,
}  # fmt: skip
COARSE = {"openodd", "scene", "scenarionet", "womd", "ssam"}
"""Formats that know the four kinds of agents alone, or none."""


def test_every_exporter_is_in_the_comparison():
    assert set(plugins.names("exporters")) == set(READ) | COARSE
    assert {one[3] for one in THERE.values()} == set(get_args(RoadUserClass))


@pytest.mark.sumo
@pytest.mark.parametrize("name", READ)
def test_the_class_is_the_one_that_a_person_would_say(name, tmp_path):
    if name == "osi":
        pytest.importorskip("osi_utilities", reason="not installed: pip install deepmf-sumo[osi]")
    module = plugins.load("exporters", name)
    settings = module.Settings(**({"av": "obstacle"} if name == "commonroad" else {}))
    module.write(Exportable.of(run(), recorded(tmp_path)), tmp_path / module.FILE, settings)
    expected = {agent: one[3] for agent, one in THERE.items()}
    if name == "fcd":  # SUMO draws what it has no shape for as a car
        expected["tram"] = "car"
    assert READ[name](tmp_path) == expected
