import struct
import time

import numpy as np
import pytest

from deepmf_sumo.datatypes import Contact
from deepmf_sumo.deepmf.policy import Settings, build
from deepmf_sumo.report.picture import draw

from tests.support.predictor_doubles import Doubles, view_of
from tests.support.rollout_doubles import case_of, contact_of, rollout_of, straight

PATHS = {
    "av": straight(0, 0, 10),
    "b": straight(-8, 3.5, 12),
    "c": straight(20, 3.5, 8),
    "$x^{": straight(30, 0, 8),
}


@pytest.fixture(scope="module")
def plan():
    view = view_of({name: (*path[10], 10.0) for name, path in PATHS.items()})
    policy = build(Settings(candidates=8, reactions=3), Doubles())
    policy.reset(view, np.random.default_rng(0))
    return policy.plan(view)


def size(path):
    return struct.unpack(">II", path.read_bytes()[16:24])


def test_same_bytes_in_time(plan, tmp_path):
    rollout = rollout_of(PATHS, contacts=[contact_of()], plans=[plan], opponent_id=plan.agent_id)
    draw(rollout, case_of(PATHS), tmp_path / "warm.png")
    begin = time.perf_counter()
    draw(rollout, case_of(PATHS), tmp_path / "again.png")
    assert time.perf_counter() - begin < 4.0  # 0.3 to 0.7 s on an idle machine
    assert (tmp_path / "warm.png").read_bytes() == (tmp_path / "again.png").read_bytes()
    assert b"Software" not in (tmp_path / "again.png").read_bytes()
    assert min(size(tmp_path / "again.png")) > 700


@pytest.mark.slow_unit
def test_the_attack_shows(plan, tmp_path):
    case = case_of(PATHS)
    pictures = set()
    for contacts in ([], [contact_of()], [contact_of("av_other", second="c")]):
        for plans in ([], [plan]):
            path = tmp_path / "x.png"
            draw(rollout_of(PATHS, contacts=contacts, plans=plans), case, path)
            pictures.add(path.read_bytes())
    assert len(pictures) == 6


def test_nobody_attacks(tmp_path):
    draw(rollout_of({"av": PATHS["av"]}, opponent_id=None), case_of(), tmp_path / "x.png")
    assert size(tmp_path / "x.png")[0] > 700


def test_far_journeys_are_cut_to_their_end(tmp_path):
    far = {"av": straight(0, 0, 300), "b": straight(-8, 3.5, 300)}
    contact: Contact = contact_of(step=90)
    draw(rollout_of(far, contacts=[contact]), case_of(), tmp_path / "x.png")
    assert size(tmp_path / "x.png")[0] > 700
