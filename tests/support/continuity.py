"""The invariant of every rollout: no road user jumps, whoever drives it and whoever takes it over.

`violations` is written from what a rollout says alone: positions, headings and speeds of two
consecutive steps, and who drove. `tests/conftest.py` asks it for every rollout that a test makes.
"""

from collections.abc import Iterator

import numpy as np

from deepmf_sumo.scene import Driver, Rollout, Tracks
from deepmf_sumo.scene.agent_ids import whole_of
from deepmf_sumo.sumo.simulation.recorder import EpisodeRecord

DT_S = 0.1
FASTER = 1.15
"""A box turns about its rear axle, so its centre may be faster than the speed of SUMO's front."""
SLACK_M = 0.35
"""Ballistic steps of SUMO, and a commanded speed that holds from the middle of a step on: up to
half of 7 m/s2 in a step, and the noise of recorded positions."""
ASIDE_M = 0.3
"""A lane change that is shown over 3 s moves 3.7 m by at most 0.13 m a step; a hand-over to SUMO
leaves 0.1 m; the rest is noise of recordings."""
SLIP = 0.4
"""Sine of the angle between course and heading of the middle of a car in its narrowest turn."""
TURN_RAD = 0.15
TURN_PER_M = 0.35
"""The curvature of SUMO's narrowest turns, and a hand-over's 0.1 rad."""
CLIMB_M, STEEP = 0.6, 0.35
"""Heights are those under SUMO's fronts; lanes that meet at a junction differ by decimetres."""
ON_FOOT_RAD = 0.5
"""Pedestrians turn on the spot, by at most half a turn in 0.6 s."""
LANE_M = 4.5
"""SUMO without its sublane model moves its own vehicles to the next lane within one step."""
TELEPORTS = {"av_teleported", "teleported", "jumped"}
"""Events by which a rollout says that SUMO moved a vehicle."""

_excused: list[str] = []


def excuse(marker) -> None:
    """Do not judge the rollouts of a test whose mark ``jumps`` says why they jump; None: judge."""
    _excused[:] = [] if marker is None else [marker.args[0]]


def use(patch) -> None:
    """Check each rollout: those of SUMO, of the log alone, and of live attacks are made here."""
    rollout = EpisodeRecord.rollout

    def checked(*given, **more):
        made = rollout(*given, **more)
        jumps = violations(made)
        assert not jumps, "\n".join(jumps)
        return made

    patch.setattr(EpisodeRecord, "rollout", checked)


def violations(rollout: Rollout) -> list[str]:
    """What jumps in a rollout, one sentence each; the recording's own steps are not judged."""
    if _excused or rollout.tracks.steps < 2:
        return []
    return [*_jumps(rollout), *_contacts_at_hand_overs(rollout)]


def _jumps(rollout: Rollout) -> Iterator[str]:
    tracks, driver = rollout.tracks, rollout.driver
    both = tracks.valid[:, 1:] & tracks.valid[:, :-1]
    both &= (driver[:, 1:] != Driver.LOG) | (driver[:, :-1] != Driver.LOG)
    both[:, : rollout.now] = False
    speed = np.hypot(*np.moveaxis(tracks.velocity_mps, -1, 0))
    fastest = np.maximum(speed[:, 1:], speed[:, :-1])
    sumos = (driver[:, 1:] == Driver.SUMO) & (driver[:, :-1] == Driver.SUMO)
    told = {(whole_of(one.agent_id), one.step) for one in rollout.events if one.kind in TELEPORTS}
    for what, value, most in _bounds(tracks, fastest, sumos):
        for row, at in zip(*np.nonzero(both & (value > most)), strict=True):
            agent, step = tracks.ids[row], int(at) + 1
            if (whole_of(agent), step) not in told:
                owners = " -> ".join(Driver(int(driver[row, one])).name for one in (at, at + 1))
                yield (
                    f"{agent} {what} {value[row, at]:.2f} in the step to {step} "
                    f"({owners}, {fastest[row, at]:.1f} m/s)"
                )


def _bounds(
    tracks: Tracks, fastest: np.ndarray, sumos: np.ndarray
) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """What is measured of each step (A, T - 1), and the most that speeds explain."""
    on_foot = np.array([kind == "pedestrian" for kind in tracks.kinds], bool)[:, None]
    moved = np.diff(tracks.position_m, axis=1)
    turn = (np.diff(tracks.heading_rad, axis=1) + np.pi) % (2 * np.pi) - np.pi
    middle = tracks.heading_rad[:, :-1] + turn / 2
    aside = np.abs(moved[..., 1] * np.cos(middle) - moved[..., 0] * np.sin(middle))
    far, way = np.hypot(*np.moveaxis(moved, -1, 0)), fastest * DT_S
    yield "moves", far, np.where(sumos, LANE_M, SLACK_M) + FASTER * way
    yield "moves sideways by", aside, np.where(sumos, LANE_M, ASIDE_M) + SLIP * way
    yield "climbs", np.abs(np.diff(tracks.z_m, axis=1)), CLIMB_M + STEEP * way
    most = np.where(on_foot, ON_FOOT_RAD, TURN_RAD)
    yield "turns by", np.abs(turn), np.where(sumos, np.pi, most) + TURN_PER_M * way


def _contacts_at_hand_overs(rollout: Rollout) -> Iterator[str]:
    changes = np.diff(rollout.driver.astype(int), axis=1) != 0
    for contact in rollout.contacts:
        for agent in (contact.first_id, contact.second_id):
            if changes[rollout.tracks.row(agent), contact.step - 1]:
                yield (
                    f"a contact {contact.kind} counts at {contact.step}, where {agent} changes its "
                    "owner"
                )
