"""Futures of an opponent among the lanes, and where the AV is meanwhile."""

from dataclasses import dataclass

import numpy as np

from deepmf_sumo.datatypes import DT_S, Bools, Floats, Forecast, Futures, View
from deepmf_sumo.geometry import boxes
from deepmf_sumo.geometry.ground import clear
from deepmf_sumo.policies.factorization.collision import Levels, footprint
from deepmf_sumo.policies.factorization.lawful.road_ahead import EVERY_STEPS, Ways
from deepmf_sumo.policies.factorization.tracking import Start

PACE_S = DT_S * EVERY_STEPS
_REACH_M = 20.0  # lanes are looked for so far beyond what is driven
_LIKELY = 0.1  # the AV's futures that are at least so likely have to be left alone


@dataclass(frozen=True, slots=True, kw_only=True)
class Driven:
    """N futures of an opponent at S times, every 0.2 s, up to the end of the case.

    Attributes:
        position_m: (N, S, 2). heading_rad, speed_mps: (N, S). size_m: (2) length, width.
        start: its pose now. ways: the lanes that it drives on.
        av_position_m: (K, R, 2), av_heading_rad: (K, R), R >= S: what the AV does if nobody
            attacks. av_size_m: (2).
        z_m, av_z_m: (N, S), (K, R) heights; z_now_m: the opponent's now. Zeros on one level.
    """

    position_m: Floats
    heading_rad: Floats
    speed_mps: Floats
    size_m: Floats
    start: Start
    ways: Ways
    av_position_m: Floats
    av_heading_rad: Floats
    av_size_m: Floats
    z_m: Floats
    av_z_m: Floats
    z_now_m: float

    @classmethod
    def of(cls, view: View, futures: Futures, speed_mps: Floats, alone: Forecast) -> "Driven":
        """Of futures with their speeds (N, F), and the AV's futures if nobody attacks."""
        start = Start.of(view, futures.agent_id)
        left = max(view.steps_left, EVERY_STEPS)  # in the last step of a case one time is looked at
        steps = slice(EVERY_STEPS - 1, min(left, speed_mps.shape[1]), EVERY_STEPS)
        position, heading = futures.position_m[:, steps], futures.heading_rad[:, steps]
        along = np.hypot(*np.moveaxis(position - start.position_m, -1, 0))
        reach_m = float(along.max(initial=0.0)) + _REACH_M
        now = start.position_m, start.heading_rad
        likely = alone.probability >= min(_LIKELY, float(alone.probability.max()))
        every = slice(EVERY_STEPS - 1, None, EVERY_STEPS)
        av_m, levels = alone.futures.position_m[likely], Levels.of(view, futures.agent_id)
        z_m, av_z_m, z_now_m = np.zeros(heading.shape), np.zeros(av_m[:, every].shape[:2]), 0.0
        if levels is not None:
            z_m = levels.opponent_z_m(futures.position_m)[:, steps]
            av_z_m, z_now_m = levels.av_z_m(av_m)[:, every], float(levels.opponent[2])
        return cls(
            position_m=position,
            heading_rad=heading,
            speed_mps=speed_mps[:, steps],
            size_m=footprint(view, futures.agent_id),
            start=start,
            ways=Ways.of(view.road, now, (position, heading), reach_m, z_now_m),
            av_position_m=av_m[:, every],
            av_heading_rad=alone.futures.heading_rad[likely, every],
            av_size_m=footprint(view, view.av_id),
            z_m=z_m,
            av_z_m=av_z_m,
            z_now_m=z_now_m,
        )

    def meets(self, later_s: float) -> Bools:
        """(N, S, K) the AV is ``later_s`` later where the opponent is; negative: was before."""
        times = np.arange(self.position_m.shape[1]) + round(later_s / PACE_S)
        row = np.clip(times, 0, self.av_position_m.shape[1] - 1)
        hit = boxes.overlap(
            self.position_m[:, :, None],
            self.heading_rad[:, :, None],
            self.size_m,
            np.swapaxes(self.av_position_m[:, row], 0, 1)[None],
            self.av_heading_rad[:, row].T[None],
            self.av_size_m,
        )
        hit &= ~clear(self.z_m[:, :, None], self.av_z_m[:, row].T[None])
        meeting: Bools = hit & (times == row)[None, :, None]
        return meeting

    def av_comes(self, within_s: float) -> Bools:
        """(N, S, K) the AV is there at the same time, or at most ``within_s`` later."""
        later = np.append(np.arange(0.0, within_s, 2 * PACE_S), within_s)
        comes: Bools = np.any([self.meets(float(one)) for one in later], axis=0)
        return comes
