"""The pictures of README: what is in them, and that they are small."""

import re

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

import deepmf_sumo

from tests.docs import front_page
from tests.docs.pages import README, ROOT


def amount(picture, colour):
    """Pixels that are about of a colour."""
    wanted = np.array(to_rgb(colour)) * 255
    return int((np.abs(np.asarray(picture, float) - wanted).max(axis=-1) < 40).sum())


def test_the_pictures_of_readme_are_small_and_one_moves():
    names = re.findall(r'<img src="([^"]+)"', README.text)
    frames = {}
    for name in names:
        assert (ROOT / name).stat().st_size < 3_000_000
        with Image.open(ROOT / name) as picture:
            frames[name.rpartition("/")[2]] = picture.n_frames
    assert frames["risk_map.webp"] == 1
    assert frames["finding.webp"] > 20


def test_readme_is_a_screen_and_a_half():
    assert README.words <= 600


@pytest.mark.sumo
def test_a_step_shows_the_plan_that_drives_and_the_last_one_the_contact(tmp_path):
    results = deepmf_sumo.run([front_page.SPEC], tmp_path / "runner", pictures=False)
    [run] = results.runs
    assert run.hit
    plans, road = front_page.Plans.read(run.folder / "plans.npz"), run.road()[0]
    now, last = run.rollout.now, run.contact.step
    assert plans.at(now) == (0, 0)
    assert plans.at(plans.first[1] + 3) == (1, 4)
    near = now + 20  # both are in the picture
    begin, end = (front_page.draw_step(run, road, plans, step) for step in (near, last))
    for colour in (front_page.CANDIDATE, front_page.REACTION):
        assert amount(begin, colour) > amount(end, colour) + 100
    assert amount(end, "black") > amount(begin, "black")
    ways = [plan[0] for plan in plans.chosen]
    opponent = run.rollout.tracks.row(run.rollout.opponent_id)
    starts = [run.rollout.tracks.position_m[opponent, k] for k in plans.first]
    assert np.allclose(ways, starts, atol=1.5)  # a plan begins where the opponent drives
