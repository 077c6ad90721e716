"""Reference drivers: when they perceive a risk, and how hard they brake then.

``cc``: the competent and careful human driver of UN Regulation 157 (annex 4, appendix 3).
``fsm``: the fuzzy safety model of the same regulation (Mattas et al., Accident Analysis and
Prevention 174, 2022), written from its formulas. ``rss``: braking as Responsibility-Sensitive
Safety asks for (Shalev-Shwartz et al. 2017), with the parameters usual beside the other two.

The regulation's models are for lane keeping: a leader that brakes, a car that cuts in. Here every
opponent that enters the AV's corridor counts as one that cuts in, and one that is in it as a
leader, whatever its direction: one that crosses is a leader that stands, one that comes towards the
AV has a negative speed, and its stopping distance adds to the AV's. Nobody brakes for what is
behind, and nobody knows a right of way.
"""

from typing import Final, Protocol

import numpy as np

from deepmf_sumo.avoidance.approach import Sight
from deepmf_sumo.datatypes import Bools, Floats

JERK_MPS3: Final = 12.65
DELAY_S: Final = 0.75
_G_MPS2: Final = 9.81


class Driver(Protocol):
    """A model of a driver."""

    def respond(self, sight: Sight, since_s: Floats) -> tuple[Bools, Floats]:
        """(N) whether there is a risk now, and (N) the deceleration until the next step.

        Args:
            sight: what is seen at this step.
            since_s: (N) time since a risk was first perceived; 0 where none was yet.
        """
        ...


class CompetentCareful:
    """Perceives a car that is out of its wandering zone, with at most 2 s to the collision.

    The zone is 0.375 m; 0.4 s at 1.8 m/s sideways pass until the risk is evaluated. Then 0.75 s
    with the foot off the accelerator (0.4 m/s2), then full braking of 0.774 g, which is kept.
    """

    SIDEWAYS_M = 0.375 + 0.72
    HORIZON_S = 2.0
    RELEASE_MPS2 = 0.4
    HARDEST_MPS2 = 0.774 * _G_MPS2

    def respond(self, sight: Sight, since_s: Floats) -> tuple[Bools, Floats]:
        """Release, then the ramp, whatever comes."""
        noticed = (sight.sideways_m >= self.SIDEWAYS_M) | (sight.clearance_m <= 0)
        middle_s = since_s + sight.dt_s / 2
        ramp = np.minimum(JERK_MPS3 * (middle_s - DELAY_S), self.HARDEST_MPS2)
        return noticed & (sight.meets_s <= self.HORIZON_S), np.maximum(ramp, self.RELEASE_MPS2)


class FuzzySafety:
    """Brakes by how unsafe the gap is, before it becomes critical.

    The proactive measure (PFS) asks whether the AV could stop behind a leader that brakes with all
    its might, the critical one (CFS) whether the two collide as they drive now. The answer follows
    the measures after the reaction time of 0.75 s, under the limit of jerk.
    """

    COMFORTABLE_MPS2 = 4.0
    HARDEST_MPS2 = 6.0
    LEADER_MPS2 = 7.0
    MARGIN_M = 2.0

    def respond(self, sight: Sight, since_s: Floats) -> tuple[Bools, Floats]:
        """What the measures ask for now."""
        # in the middle of the step, for which the answer holds: at its start it would be late
        closing = sight.speed_mps - sight.along_mps
        gap = np.maximum(sight.gap_m - closing * sight.dt_s / 2, 0.0)
        critical = critical_safety(gap, sight.speed_mps, sight.along_mps, -sight.braking_mps2)
        proactive = proactive_safety(gap, sight.speed_mps, sight.along_mps)
        more = self.HARDEST_MPS2 - self.COMFORTABLE_MPS2
        severe, mild = self.COMFORTABLE_MPS2 + more * critical, self.COMFORTABLE_MPS2 * proactive
        wanted = np.where(in_the_way(sight), np.where(critical > 0, severe, mild), 0.0)
        change = JERK_MPS3 * sight.dt_s
        ramped = np.clip(wanted, sight.braking_mps2 - change, sight.braking_mps2 + change)
        return wanted > 0, np.where(since_s >= DELAY_S, ramped, 0.0)


class ResponsibilitySensitive:
    """Brakes with 6 m/s2 from 0.75 s after the gap became too short, as long as it is."""

    ACCEL_MPS2 = 3.0
    BRAKING_MPS2 = 6.0
    LEADER_MPS2 = 7.0
    LATERAL_MPS2 = 1.0
    LATERAL_MARGIN_M = 0.3

    def respond(self, sight: Sight, since_s: Floats) -> tuple[Bools, Floats]:
        """All or nothing. Aside, RSS holds for those that drive along; others are in the way."""
        beside = sight.ahead & (sight.clearance_m < lateral_distance(sight.aside_mps))
        near = sight.gap_m < safe_distance(sight.speed_mps, sight.along_mps)
        danger = near & np.where(sight.parallel, beside, in_the_way(sight))
        return danger, np.where(danger & (since_s >= DELAY_S), self.BRAKING_MPS2, 0.0)


MODELS: Final[dict[str, Driver]] = {
    "cc": CompetentCareful(),
    "fsm": FuzzySafety(),
    "rss": ResponsibilitySensitive(),
}
"""The reference drivers by name."""


def in_the_way(sight: Sight) -> Bools:
    """(N) whether the opponent is in the corridor before the AV has passed, and when it comes.

    The fuzzy model's test of a cut-in: the lateral headway is at most the longitudinal gross one
    (over the gap and both lengths) and 0.1 s.
    """
    passing = np.maximum(sight.gap_m, 0.0) + sight.lengths_m
    gross_s = passing / np.maximum(sight.speed_mps, 1e-3) + 0.1
    still_there = np.isinf(sight.leaves_s) | (sight.leaves_s > sight.reach_s)
    conflict: Bools = sight.ahead & (sight.enters_s <= gross_s) & still_there
    return conflict


def proactive_safety(gap_m: Floats, speed_mps: Floats, leader_mps: Floats) -> Floats:
    """PFS of the fuzzy safety model: 0 safe, 1 unsafe, linear between the two distances."""
    model = FuzzySafety
    leader_stops = leader_mps * np.abs(leader_mps) / (2 * model.LEADER_MPS2)
    reacting = speed_mps * DELAY_S
    safe = reacting + speed_mps**2 / (2 * model.COMFORTABLE_MPS2) - leader_stops + model.MARGIN_M
    unsafe = reacting + speed_mps**2 / (2 * model.HARDEST_MPS2) - leader_stops
    share: Floats = (safe - (gap_m - model.MARGIN_M)) / (safe - unsafe)
    return np.clip(share, 0.0, 1.0)


def critical_safety(
    gap_m: Floats, speed_mps: Floats, leader_mps: Floats, accel_mps2: Floats
) -> Floats:
    """CFS of the fuzzy safety model: 0 safe, 1 unsafe; ``accel_mps2`` is the AV's, signed."""
    model = FuzzySafety
    accel = np.maximum(accel_mps2, -model.COMFORTABLE_MPS2)
    closing = speed_mps - leader_mps
    after = closing + accel * DELAY_S
    travel = (closing + after) / 2 * DELAY_S
    safe = travel + after**2 / (2 * model.COMFORTABLE_MPS2)
    unsafe = travel + after**2 / (2 * model.HARDEST_MPS2)
    share = np.clip((safe - gap_m) / np.maximum(safe - unsafe, 1e-9), 0.0, 1.0)
    soon = gap_m < closing**2 / (2 * np.maximum(np.abs(accel), 1e-9))
    return np.where(closing <= 0, 0.0, np.where(after < 0, soon, share))


def safe_distance(speed_mps: Floats, leader_mps: Floats) -> Floats:
    """RSS's longitudinal safe distance, behind a leader or (negative speed) towards an oncomer."""
    own = _response(speed_mps)
    ahead = own - leader_mps**2 / (2 * ResponsibilitySensitive.LEADER_MPS2)
    towards = own + _response(np.abs(leader_mps))
    return np.maximum(np.where(leader_mps < 0, towards, ahead), 0.0)


def lateral_distance(aside_mps: Floats) -> Floats:
    """RSS's lateral safe distance from a vehicle that moves towards the AV's path with this speed.

    Both may accelerate towards each other for 0.75 s before they correct it.
    """
    model = ResponsibilitySensitive
    gained, twice = model.LATERAL_MPS2 * DELAY_S, 2 * model.LATERAL_MPS2
    own = gained / 2 * DELAY_S + gained**2 / twice
    after = aside_mps + gained
    other = (aside_mps + after) / 2 * DELAY_S + np.maximum(after, 0.0) ** 2 / twice
    return model.LATERAL_MARGIN_M + np.maximum(own + other, 0.0)


def _response(speed_mps: Floats) -> Floats:
    """Way until a vehicle stands that accelerates during the response time and then brakes."""
    model = ResponsibilitySensitive
    after = speed_mps + model.ACCEL_MPS2 * DELAY_S
    way: Floats = (speed_mps + after) / 2 * DELAY_S + after**2 / (2 * model.BRAKING_MPS2)
    return way
