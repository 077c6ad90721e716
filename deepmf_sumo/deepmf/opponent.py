"""The choice of the road user that attacks: once, before the first plan (Algorithm 1).

The opponent network scores vehicles. People (pedestrians and cyclists) are scored by what they can
reach, without weights: see `reach_scores`. The two scales agree only roughly; where several
opponents are tried, each has a first plan made, and the largest collision mass decides.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Final, Literal, Protocol

import numpy as np

from deepmf_sumo.deepmf.networks.opponent import RANGE_M, Opponent, passes_over
from deepmf_sumo.errors import RunError
from deepmf_sumo.scene import (
    DT_S,
    AgentId,
    AgentKind,
    Floats,
    Forecast,
    OpponentScores,
    View,
    agent_ids,
)
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.walkable import walkable
from deepmf_sumo.scene.road_users import PEOPLE, MotionModel, road_user

SCORED: Final = frozenset({"argmax", "sample", "partner"})
"""Values of ``opponent`` that need the scores of the opponent network."""
Attackers = Literal["vehicles", "people", "all"]
_VEHICLES: Final[tuple[AgentKind, ...]] = ("vehicle",)
ATTACK: Final[dict[Attackers, tuple[AgentKind, ...]]] = {
    "vehicles": _VEHICLES,
    "people": PEOPLE,
    "all": (*_VEHICLES, *PEOPLE),
}
"""The kinds of agents that each value of ``attackers`` has."""
_EVERY_STEPS = 4
_URGENT_S = 4.0
_MISSED_M = 5.0
_SURE_S = 0.5
_LEAST_SHARE = 1e-3


class Scorer(Protocol):
    """Scores road users around the AV as opponents: the opponent network, or `ByClass`."""

    def score(self, view: View) -> OpponentScores:
        """Logits of the candidates."""
        ...


def choose_opponent(
    view: View,
    how: str,
    predictor: Scorer | None,
    partner_id: AgentId | None,
    rng: np.random.Generator,
    attackers: Attackers = "vehicles",
) -> tuple[AgentId | None, OpponentScores | None]:
    """The opponent, None without candidates; and the scores, if it was chosen by scores.

    Args:
        view: at the current step.
        how: one of `SCORED`, ``labelled`` or the id of a vehicle.
        predictor: only `SCORED` needs it.
        partner_id: the AV's interaction partner according to the recording.
        rng: for ``sample``.
        attackers: who may be labelled or named, by `ATTACK`.

    Raises RunError if the named road user is not in the view, or no partner is labelled.
    """
    if how in SCORED:
        assert predictor is not None
        scores = _on_level(view, predictor.score(view))
        return from_scores(scores, how, rng), scores
    if how != "labelled":
        return named(view, how, ATTACK[attackers]), None
    if partner_id is None:
        raise RunError(
            "opponent is 'labelled', but the recording names no partner of the AV; use "
            "argmax, sample or partner."
        )
    return named(view, partner_id, ATTACK[attackers]), None


def _on_level(view: View, scores: OpponentScores) -> OpponentScores:
    """The scores without vehicles that pass over or under the AV's path; all if no others are left.

    Heights are not among the features of the opponent network.
    """
    tracks = view.history
    rows = [tracks.row(one) for one in (view.av_id, *scores.ids)]
    level = ~passes_over(
        view.road,
        tracks.position_m[rows, -1],
        tracks.heading_rad[rows, -1],
        tracks.speed_mps[rows, -1],
        tracks.z_m[rows, -1],
    )
    if level.all() or not level.any():
        return scores
    return OpponentScores(
        ids=tuple(scores.ids[row] for row in np.flatnonzero(level)),
        logits=scores.logits[level],
        partner_logits=scores.partner_logits[level],
    )


def from_scores(scores: OpponentScores, how: str, rng: np.random.Generator) -> AgentId | None:
    """The opponent by ``argmax``, ``sample`` (softmax of the logits) or ``partner``.

    ``partner`` takes the head that was trained on labelled interaction partners. None without
    candidates.
    """
    if not scores.ids:
        return None
    if how == "sample":
        return scores.ids[int(rng.choice(len(scores.ids), p=softmax(scores.logits)))]
    return highest(scores, how, 1)[0]


def highest(scores: OpponentScores, how: str, count: int) -> list[AgentId]:
    """At most ``count`` road users by ``argmax`` or ``partner``, highest score first."""
    logits = scores.partner_logits if how == "partner" else scores.logits
    return [scores.ids[row] for row in np.argsort(-logits, kind="stable")[:count]]


def tried(view: View, ranked: list[AgentId], count: int) -> list[AgentId]:
    """The first ``count`` of a ranking; from 2 on the first vehicle and the first person in it.

    The scales of their scores agree only roughly, and plans decide between them.
    """
    found, kinds = ranked[:count], dict(zip(view.history.ids, view.history.kinds, strict=True))
    people = [kinds[one] in PEOPLE for one in ranked]
    missing = next((at for at in range(len(found), len(ranked)) if people[at] != people[0]), None)
    if count < 2 or missing is None or len({*people[: len(found)]}) > 1:
        return found
    return [*found[:-1], ranked[missing]]


def named(view: View, agent_id: AgentId, kinds: Collection[AgentKind] = _VEHICLES) -> AgentId:
    """The opponent that the settings name. Raises RunError if it is not in view, or is the AV.

    ``kinds``: of those that may be named. A person of SUMO may be named as there, unless a vehicle
    has the name.
    """
    others = [
        other
        for other, kind in zip(view.history.ids, view.history.kinds, strict=True)
        if kind in kinds and other != view.av_id
    ]
    if agent_id not in view.history.ids and agent_ids.of_person(agent_id) in others:
        return agent_ids.of_person(agent_id)
    if agent_id not in others:
        known = ", ".join(others[:10]) + (" ..." if len(others) > 10 else "")
        what = "vehicle" if kinds == _VEHICLES else "road user"
        raise RunError(
            f"opponent '{agent_id}' is not a {what} near the AV at step {view.step}; "
            f"name one of: {known or 'there are none'}, or use argmax."
        )
    return agent_id


@dataclass(frozen=True, slots=True, eq=False)
class ByClass:
    """Scores of those who may attack: vehicles by the network, people by `reach_scores`.

    Attributes:
        network: of vehicles.
        attackers: who may attack.
        ahead: the AV's futures without an attack, (M, F, 2), at a view.
    """

    network: Opponent
    attackers: Attackers
    ahead: Callable[[View], Forecast]

    def score(self, view: View) -> OpponentScores:
        """Logits of the candidates: vehicles first, each nearest first."""
        if self.attackers == "vehicles":
            return self.network.score(view)
        people = reach_scores(view, self.ahead(view))
        if self.attackers == "people":
            return people
        vehicles = self.network.score(view)
        return OpponentScores(
            ids=(*vehicles.ids, *people.ids),
            logits=np.concatenate([vehicles.logits, people.logits]),
            partner_logits=np.concatenate([vehicles.partner_logits, people.partner_logits]),
        )


def reach_scores(view: View, av: Forecast) -> OpponentScores:
    """How soon and how surely people within 80 m can be where the AV will be, nearest first.

    For each of the AV's futures, of probability P_k: a person can be in its way in time where it
    needs less time to a position of the AV than the AV has left (`least_time_s`: as hard as its
    class accelerates, in the direction that it takes). With the first such time t_k, the largest
    time s_k that is left over, and the least distance m_k to the AV at constant velocity,

        p = sum over k of P_k (1 - exp(-s_k / 0.5 s)) (exp(-t_k / 4 s) + exp(-m_k / 5 m)) / 2

    and the logit is log(p / (1 - p)), for both heads. Nothing of it is trained: it is no calibrated
    probability, as the network's is. Who walks through a building, where a map draws one over a
    sidewalk, is none of them: it would step out of a wall.
    """
    tracks = view.history
    av_row = tracks.row(view.av_id)
    indoors = walkable(view.road).indoors(tracks.position_m[:, -1])
    away = np.hypot(*(tracks.position_m[:, -1] - tracks.position_m[av_row, -1]).T)
    rows = [
        int(row)
        for row in np.argsort(away, kind="stable")
        if tracks.kinds[row] in PEOPLE
        and row != av_row
        and away[row] <= RANGE_M
        and not indoors[row]
    ]
    share = np.array([_reaches(view, row, av) for row in rows])
    share = np.clip(share, _LEAST_SHARE, 1 - _LEAST_SHARE)
    logits = np.log(share / (1 - share))
    ids = tuple(tracks.ids[row] for row in rows)
    return OpponentScores(ids=ids, logits=logits, partner_logits=logits)


def _reaches(view: View, row: int, av: Forecast) -> float:
    """The p of `reach_scores` of the agent in a row."""
    tracks, steps = view.history, slice(0, view.steps_left, _EVERY_STEPS)
    motion = road_user(tracks.kinds[row], tracks.size_m[row]).motion
    here, velocity = tracks.position_m[row, -1], tracks.velocity_mps[row, -1]
    there = av.futures.position_m[:, steps]
    if there.shape[1] == 0:
        return 0.0
    left_s = DT_S * (1 + np.arange(there.shape[1]) * _EVERY_STEPS)
    touch_m = (tracks.size_m[view.history.row(view.av_id), 1] + tracks.size_m[row, 1]) / 2
    apart = there - here
    distance = np.maximum(np.hypot(*np.moveaxis(apart, -1, 0)) - touch_m, 0.0)
    course = np.arctan2(apart[..., 1], apart[..., 0])
    towards = (velocity * frames.unit(course)).sum(-1)
    spare_s = left_s - least_time_s(distance, towards, motion)
    in_time = spare_s >= 0.0
    soonest_s = np.where(in_time, left_s, np.inf).min(axis=1)
    missed = apart - velocity * left_s[:, None]
    missed_m = np.maximum(np.hypot(*np.moveaxis(missed, -1, 0)) - touch_m, 0.0).min(axis=1)
    sure = 1 - np.exp(-np.maximum(spare_s.max(axis=1), 0.0) / _SURE_S)
    value = (np.exp(-soonest_s / _URGENT_S) + np.exp(-missed_m / _MISSED_M)) / 2
    return float((av.probability * sure * value)[in_time.any(axis=1)].sum())


def least_time_s(distance_m: Floats, towards_mps: Floats, motion: MotionModel) -> Floats:
    """(...) least time for distances, as hard as planned motions of the class accelerate.

    ``towards_mps``: present speed towards the end; one that leads away from it is first braked.
    """
    limits, fastest = motion.planned, motion.fastest_mps
    away = np.maximum(-towards_mps, 0.0)
    distance = distance_m + away**2 / (2 * limits.brake)
    now = np.clip(towards_mps, 0.0, fastest)
    # Speeds up until the end or its fastest: v^2 = now^2 + 2 a d.
    reached = np.minimum(np.sqrt(now**2 + 2 * limits.accel * distance), fastest)
    speeding_s = (reached - now) / limits.accel
    left_m = np.maximum(distance - (reached + now) / 2 * speeding_s, 0.0)
    return np.asarray(away / limits.brake + speeding_s + left_m / np.maximum(reached, 1e-6))


def softmax(logits: Floats) -> Floats:
    """(N) probabilities of logits (N)."""
    power = np.exp(logits - np.max(logits))
    return power / power.sum()
