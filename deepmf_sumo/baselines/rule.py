"""A rule: a cubic Bezier curve from the opponent into the AV's unattacked path, timed to meet it.

Source: the rule-based variant of CAT (Zhang et al., CoRL 2023): control points OV(0), OV(n/3),
AV(2n/3), AV(n) with n three quarters of the AV's steps; after the meeting the opponent stays with
the AV. It ignores the road, limits and likelihood: an upper bound of the collision rate and a lower
bound of naturalness. Adapted: headings follow the motion; optionally the curve is driven within
limits, with the earliest meeting that then hits.

Budget: two simulations, one unattacked and the attack; with more, every further round aims at the
AV's rollout of the round before, until it is hit.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
from pydantic import Field

from deepmf_sumo.attacks._episodes import AgentMotion, Scouted, plan_of
from deepmf_sumo.baselines import _open_loop as open_loop
from deepmf_sumo.baselines._open_loop import Aimed, AimedRounds, AimedSettings
from deepmf_sumo.deepmf.tracking import Start, track
from deepmf_sumo.scene import DT_S, Floats, Ints

FORESIGHT = "the un-attacked motion of the AV, where it aims, and of the opponent"

_FIRST_S, _EVERY_S = 1.5, 0.5  # meetings that are tried within limits


class Settings(AimedSettings):
    """Shape and timing of the curve.

    Attributes:
        meeting_share: time at which the opponent meets the AV, as a share of the remaining time;
            null tries every half second from 1.5 s on.
        within_limits: drive the curve within the limits; else without limits.
    """

    meeting_share: float | None = Field(default=0.75, ge=0.1, le=1.0)
    within_limits: bool = False


def _aim(settings: Settings, scouted: Scouted, answers: Sequence[AgentMotion]) -> Aimed:
    """The curve into the AV's last rollout."""
    view, av = scouted.view, answers[-1]
    start = Start.of(view, scouted.opponent_id)
    meetings = _meetings(settings.meeting_share, len(av.valid))
    own_m = open_loop.continued(scouted.reference, start)
    av_m = open_loop.continued(av, Start.of(view, view.av_id))
    curves = np.stack(
        [open_loop.curve_into(start.position_m, own_m, av_m, int(steps)) for steps in meetings]
    )
    if not settings.within_limits:
        heading = np.stack([open_loop.headings(curve, start) for curve in curves])
        row = _best(open_loop.gaps(scouted, av, curves, heading))
        plan = open_loop.plan_along(view, scouted.opponent_id, curves[row])
    else:
        tracked = track(curves, start, settings.limits.rows(len(curves)))
        row = _best(open_loop.gaps(scouted, av, tracked.position_m, tracked.heading_rad))
        plan = plan_of(view, scouted.opponent_id, tracked, row)
    return Aimed(plan=plan, parameters={"meeting_s": float(meetings[row] * DT_S)})


def _meetings(share: float | None, steps: int) -> Ints:
    """Steps at which the curves meet the AV."""
    if share is not None:
        return np.array([min(max(round(share * steps), 3), steps)])
    first, every = round(_FIRST_S / DT_S), round(_EVERY_S / DT_S)
    return np.arange(min(first, steps), steps + 1, every)


def _best(gap_m: Floats) -> int:
    """The row (M, K) that touches the AV first, else the one that comes closest."""
    hit = gap_m <= 0
    if not hit.any():
        return int(gap_m.min(axis=1).argmin())
    first = np.where(hit.any(axis=1), hit.argmax(axis=1), gap_m.shape[1])
    return int(first.argmin())


def build(settings: Settings, weights: str) -> AimedRounds:
    """The adversary; ``weights``: of the network that chooses the opponent."""
    return AimedRounds(settings, weights, partial(_aim, settings))
