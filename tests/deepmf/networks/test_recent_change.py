"""Acceleration and yaw rate over the last half second: one number, whoever asks."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from deepmf_sumo.baselines import _art_history as art
from deepmf_sumo.baselines.priors import graph
from deepmf_sumo.deepmf.networks import encode, opponent
from deepmf_sumo.deepmf.networks.encode import OwnMotion
from deepmf_sumo.training.evaluation import marginal

from tests.support.predictor_doubles import view_of

ALWAYS = [1] * 11
CASES = {
    # steps at which `b` was seen; speed at each; acceleration by hand
    "without a gap": (ALWAYS, np.arange(11) * 0.3 + 9, 3.0),
    "unseen for half a second": ([1] * 5 + [0] * 5 + [1], [20, 18, 16, 14, 12, *[0] * 5, 12], 0.0),
    "seen again since 0.2 s": ([1] * 3 + [0] * 5 + [1] * 3, [5, 5, 5, *[0] * 5, 8, 8.2, 8.4], 2.0),
    "seen now alone": ([0] * 10 + [1], [0] * 10 + [7], 0.0),
}


def seen(valid, speed):
    """The AV, and `b`, which turns by 0.1 rad a second."""
    view = view_of({"av": (0.0, 0.0, 0.0, 10.0), "b": (-20.0, 3.5, 0.0, 12.0)})
    tracks = view.history
    row, valid = tracks.row("b"), np.array(valid, bool)
    mask, velocity, heading = tracks.valid.copy(), tracks.velocity_mps.copy(), tracks.heading_rad.copy()  # fmt: skip  # noqa: E501
    mask[row], velocity[row, :, 0], heading[row] = valid, speed, 0.01 * np.arange(-10, 1) * valid
    return replace(
        view, history=replace(tracks, valid=mask, velocity_mps=velocity, heading_rad=heading)
    )


@pytest.mark.parametrize("case", CASES)
def test_every_network_reads_the_same_acceleration(case):
    valid, speed, accel = CASES[case]
    view = seen(valid, np.array(speed, float))
    row = view.history.row("b")
    both = np.array([view.history.row("av"), row])
    yaw = 0.0 if case in {"seen now alone", "unseen for half a second"} else 0.1
    of_opponents = opponent.motion_of(view, both)
    own = encode.own_motion(view, row, planner=False)
    target = SimpleNamespace(view=view, row=row)
    back = int(np.flatnonzero(np.array(valid[5:]))[0]) + 5
    found = {
        "candidates and reactions": own[[OwnMotion.ACCEL, OwnMotion.YAW_RATE]],
        "opponents": (of_opponents.accel_mps2[1], of_opponents.yaw_rps[1]),
        "motion priors": graph._motions(view.history, both, view.dt_s)[1, 1:],
        "baseline of the evaluation": (accel, marginal._yaw_rate(target)),
    }
    for name, values in found.items():
        assert values == pytest.approx((accel, yaw), abs=1e-9), name
    assert art.half_second_ago(view.history.valid[[row]])[0] == back
