"""What is made smaller, and the opponent's path and the spec that come of it."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from deepmf_sumo.scene import DT_S, AgentId, Floats
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.spec import FromNetwork
from deepmf_sumo.study.moments import people_later
from deepmf_sumo.study.shrink.failure import RecordedHit

AFTER_STEPS: Final = 20
"""Simulated beyond the contact: a planner that avoids it is not to be hit a second later."""
_DIGITS, _DIGITS_RAD = 4, 5
_OF_THE_SEARCH: Final = frozenset({"profile", "opponents", "turns", "budget", "weights"})
"""Keys of a spec that say how its attack was found."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """How a reproducer differs from the run, with steps counted from the run's start.

    Attributes:
        begin: step at which it begins. last: the last step that it simulates.
        contact: step at which the opponent's path has to be the planned one again, if it begins
            later: the contact of the candidate before.
        only: road users beside the AV; None: all.
        plans: number of the opponent's plans that it follows.
        scale: share of the opponent's deviation from its undisturbed motion that is left.
        smooth: half the width, in steps, over which that deviation is averaged.
    """

    begin: int = 0
    last: int
    contact: int
    only: tuple[AgentId, ...] | None
    plans: int
    scale: float = 1.0
    smooth: int = 0


def path_of(candidate: Candidate, failure: RecordedHit, undisturbed: Floats | None) -> Floats:
    """(K, 3) poses of the opponent from the step after the candidate's begin on.

    ``undisturbed``: (N, 3) from the run's start on; None where it is not known.
    """
    poses = _continued(failure.path(candidate.plans), candidate.last + 1)
    if undisturbed is None:
        return poses[candidate.begin + 1 :]
    calm = _continued(undisturbed, len(poses))
    if candidate.scale != 1.0 or candidate.smooth:
        deviation = _averaged(_difference(poses, calm), candidate.smooth)
        poses = calm + candidate.scale * deviation
    if candidate.begin:
        poses = _joined(poses, calm, candidate.begin, candidate.contact)
    return poses[candidate.begin + 1 :]


def spec_values(candidate: Candidate, failure: RecordedHit, path: Floats) -> dict[str, Any]:
    """The spec of a candidate, as it is written; paths are absolute.

    It is the run's own but for what found the attack, so that the planner sees what it saw.
    """
    spec, values = failure.spec, failure.task.resolved()
    values = {key: value for key, value in values.items() if key not in _OF_THE_SEARCH}
    source = {key: value for key, value in values["source"].items() if value not in ([], None)}
    later = round(spec.source.start_s + candidate.begin * DT_S, 3)
    if later or isinstance(spec.source, FromNetwork):
        source["start_s"] = later
    if isinstance(spec.source, FromNetwork) and spec.source.people.given:
        source["people"] = people_later(spec.source.people, candidate.begin * DT_S)
    if candidate.only is not None:
        source["only"] = list(candidate.only)
    rounded = [
        [round(x, _DIGITS), round(y, _DIGITS), round(float(frames.wrap(heading)), _DIGITS_RAD)]
        for x, y, heading in path.tolist()
    ]
    return values | {
        "version": 3,
        "name": f"{failure.run_id[:180]} shrunk",
        "source": source,
        "duration_s": round((candidate.last - candidate.begin) * DT_S, 3),
        "adversary": {"name": "trajectory", "agent": failure.opponent, "poses": rounded},
        "expect": {"av_collision": False},
    }


def undisturbed_values(failure: RecordedHit) -> dict[str, Any]:
    """The spec of the run without an attack, in which SUMO or the log drives every vehicle."""
    spec, network = failure.spec, isinstance(failure.spec.source, FromNetwork)
    return {
        "version": 3,
        "name": "undisturbed",
        "source": failure.task.resolved()["source"],
        "duration_s": max((failure.contact + AFTER_STEPS) * DT_S, DT_S),
        "traffic": "sumo" if network else "log",
        "planner": {"name": "sumo" if network else "replay"},
        "adversary": {"name": "none"},
        "opponents": "one",
        "seed": spec.seed,
    }


def changes_of_plan(candidate: Candidate, failure: RecordedHit) -> int:
    """How often the opponent turns to a new plan between begin and contact."""
    starts = [plan.first_step for plan in failure.plans[: candidate.plans]]
    return sum(candidate.begin + 1 < first <= candidate.contact for first in starts[1:])


def _continued(poses: Floats, steps: int) -> Floats:
    """The first ``steps`` of the poses (N, 3); after them straight on at the last speed."""
    missing = np.arange(1, steps - len(poses) + 1)[:, None]
    moved = poses[-1] - poses[-2] if len(poses) > 1 else np.zeros(3)
    rest = poses[-1] + missing * np.array([moved[0], moved[1], 0.0])
    return np.concatenate([poses[:steps], rest])


def _difference(poses: Floats, others: Floats) -> Floats:
    deviation = poses - others
    deviation[:, 2] = frames.wrap(deviation[:, 2])
    return deviation


def _averaged(deviation: Floats, half: int) -> Floats:
    """Each column averaged with a bell of ``half`` steps to either side; the first row stays."""
    if not half:
        return deviation
    bell = np.hanning(2 * half + 3)[1:-1]
    padded = np.pad(deviation, [(half, half), (0, 0)], mode="edge")
    columns = [np.convolve(column, bell / bell.sum(), mode="valid") for column in padded.T]
    smooth = np.column_stack(columns)
    fade = np.minimum(np.arange(len(smooth)) / (half + 1), 1.0)[:, None]
    averaged: Floats = fade * smooth + (1.0 - fade) * deviation
    return averaged


def _joined(poses: Floats, calm: Floats, begin: int, contact: int) -> Floats:
    """The poses from ``contact`` on; before, a cubic leads to them from the undisturbed motion.

    It has the place and the speed of both at its ends, ``begin`` and ``contact``.
    """
    steps = max(contact - begin, 1)
    part = np.clip((np.arange(len(poses)) - begin) / steps, 0.0, 1.0)[:, None]
    apart = _difference(calm[begin : begin + 1], poses[begin : begin + 1])
    before, after = max(begin - 1, 0), min(begin + 1, len(poses) - 1)
    faster = (calm[begin] - calm[before]) - (poses[after] - poses[begin])
    faster[2] = 0.0
    fades = 1.0 - 3.0 * part**2 + 2.0 * part**3
    slope = part - 2.0 * part**2 + part**3
    joined: Floats = poses + fades * apart + slope * steps * faster
    return joined
