"""A vehicle that bends is several boxes, and one road user wherever road users are counted."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from deepmf_sumo.exporters import openodd, ssam
from deepmf_sumo.exporters.base import Exportable
from deepmf_sumo.report.page.replay import replay
from deepmf_sumo.results.risk import driving
from deepmf_sumo.scene import RoadMap, agent_ids
from deepmf_sumo.study.shrink import failure

from tests.support.rollout_doubles import case_of, contact_of, rollout_of, straight

TRAM = ("tram", *(agent_ids.of_part("tram", number) for number in range(2, 6)))


def beside_a_tram(away_m=8.0):
    """AV and opponent, and one tram of five boxes so far to the left."""
    paths = {"av": straight(0, 0, 5), "b": straight(-15, 3.5, 5)}
    paths |= {name: straight(20 - 6 * at, away_m, 5) for at, name in enumerate(TRAM)}
    found = rollout_of(paths, [contact_of(step=90)])
    return replace(found, tracks=replace(found.tracks, kinds=("vehicle",) * 2 + ("other",) * 5))


@pytest.fixture
def rollout():
    return beside_a_tram()


def test_it_is_one_of_those_near_the_av(rollout):
    assert driving._near(rollout.tracks, 0, 10, RoadMap(lanes={})) == 2
    there = np.arange(rollout.tracks.agents) > 0
    step = openodd._Step(rollout, RoadMap(lanes={}), 0, 10, there)
    assert step.near("vehicle", "other") == 2


def test_shrinking_leaves_it_out_as_a_whole(rollout):
    assert failure._others(rollout, rollout.contacts[0]) == ("tram",)


def test_the_page_says_how_many_are_too_far_away_to_be_shown():
    assert replay(beside_a_tram(900.0), np.zeros(2))["hidden"] == 1
    assert replay(beside_a_tram(), np.zeros(2))["hidden"] == 0


def test_ssam_is_told_which_boxes_are_one(rollout, tmp_path):
    ssam.write(Exportable.of(rollout, case_of()), tmp_path / "ssam", ssam.Settings())
    rows = list(csv.DictReader((tmp_path / "ssam" / ssam.VEHICLES).read_text().splitlines()))
    assert [row["part_of"] for row in rows] == ["", "", "", *["tram"] * 4]
