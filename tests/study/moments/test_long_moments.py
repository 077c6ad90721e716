"""Moments of attacks that last minutes: who stays."""

from dataclasses import replace

import numpy as np
from test_moments import TURNS, traffic

from deepmf_sumo.study.moments.choice import choose
from deepmf_sumo.study.moments.moment import WantedMoments


def early_leavers():
    """Of each pair the second leaves at 20 s of a minute."""
    seen = traffic()
    kept = (seen.vehicle % 2 == 0) | (seen.time_s <= 20)
    names = ("time_s", "vehicle", "edge", "following", "position_m", "to_end_m", "speed_mps")
    cut = {name: getattr(seen, name)[kept] for name in (*names, "parked")}
    return replace(seen, **cut)


def test_in_a_long_attack_the_av_stays_half_as_long_as_anybody_does():
    found = choose(early_leavers(), TURNS, WantedMoments(count=40, duration_s=50.0))
    stays = [60.0 if int(one.av[1:]) % 2 == 0 else 20.0 for one in found.moments]
    assert min(end - one.start_s for end, one in zip(stays, found.moments, strict=True)) >= 24.5
    short = choose(early_leavers(), TURNS, WantedMoments(count=40, duration_s=15.0))
    assert {int(one.av[1:]) % 2 for one in short.moments} == {0, 1}


def test_a_late_time_that_is_asked_for_keeps_its_vehicles():
    found = choose(traffic(), TURNS, WantedMoments(count=4, duration_s=50.0, at_s=(5.0, 55.0)))
    assert {one.start_s for one in found.moments} == {5.0, 55.0}
    assert np.all([one.around == 1 for one in found.moments])
