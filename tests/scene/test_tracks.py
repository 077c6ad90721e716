"""Tracks refuse wrong shapes, are read-only, and select rows and windows."""

import numpy as np
import pytest

from deepmf_sumo.scene import Signals, SignalState, Tracks


def tracks(agents=3, steps=5):
    return Tracks(
        ids=tuple(f"v{row}" for row in range(agents)),
        kinds=("vehicle",) * agents,
        size_m=np.full((agents, 3), 2.0),
        position_m=np.arange(agents * steps * 2.0).reshape(agents, steps, 2),
        z_m=np.zeros((agents, steps)),
        heading_rad=np.zeros((agents, steps)),
        velocity_mps=np.full((agents, steps, 2), [3.0, 4.0]),
        valid=np.ones((agents, steps), bool),
    )


def test_a_wrong_shape_is_refused():
    with pytest.raises(ValueError, match="z_m"):
        Tracks(
            ids=("a",),
            kinds=("vehicle",),
            size_m=np.zeros((1, 3)),
            position_m=np.zeros((1, 5, 2)),
            z_m=np.zeros((1, 4)),
            heading_rad=np.zeros((1, 5)),
            velocity_mps=np.zeros((1, 5, 2)),
            valid=np.zeros((1, 5), bool),
        )


def test_arrays_cannot_be_written():
    with pytest.raises(ValueError, match="read-only"):
        tracks().position_m[0, 0, 0] = 1


def test_window_and_select():
    part = tracks().window(1, 3).select([2, 0])
    assert part.ids == ("v2", "v0")
    assert part.steps == 2
    assert part.position_m[1, 0].tolist() == [2, 3]


def test_speed_is_the_length_of_the_velocity():
    assert tracks().speed_mps == pytest.approx(np.full((3, 5), 5.0))


def test_a_row_that_is_not_there_is_a_key_error():
    with pytest.raises(KeyError, match="v9"):
        tracks().row("v9")


def test_signals_hold_the_last_state_seen():
    signals = Signals(
        lane_ids=("a", "b"),
        state=np.array([[4, 0, 6], [0, 0, 1]]),
        seen=np.array([[True, False, True], [False, False, True]]),
        stop_m=np.zeros((2, 2)),
    )
    assert signals.at(1) == {"a": SignalState.STOP}
    assert signals.at(2) == {"a": SignalState.GO, "b": SignalState.ARROW_STOP}
