"""What the AV really did in earlier tries of the same attack, in place of what was predicted.

A simulated episode tells P(AV | OV) at one point: to what the opponent drove, the AV's answer is
known. Candidates that resemble it will be answered alike. With Y_i and A_i the motions of opponent
and AV in try i, from the time of the plan on, and the candidate Y_j:

    d_ij^2 = mean over 3 s of |Y_j - Y_i|^2 + |AV now - AV now in i|^2 + (1 s)^2 (its speeds)^2
    k_ij = exp(-d_ij^2 / (2 h^2)), h = 1.5 m          w_j = max_i k_ij
    P(AV | Y_j) = (1 - w_j) P_predicted(AV | Y_j) + w_j sum_i k_ij / (sum_i k_ij) [AV = A_i]

So a candidate that was tried has the answer that it got, one that resembles it is in between, and
others keep their predictions. The AV's motions of earlier tries are also among the futures that
candidates are aimed at. A collision that did not reach the goal (`Settings.goal`) counts no more:
it has been seen, another one is wanted.
"""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from deepmf_sumo.deepmf.candidates import Candidates
from deepmf_sumo.deepmf.situation import Situation
from deepmf_sumo.scene import (
    FUTURE_STEPS,
    AgentId,
    Bools,
    Floats,
    Forecast,
    Futures,
    Heat,
    Rollout,
    View,
)
from deepmf_sumo.scene.geometry import frames

_BANDWIDTH_M: Final = 1.5
_COMPARED_STEPS: Final = 30
_AIMED_SHARE: Final = 0.5
"""Of the probability of the futures that candidates are aimed at: those of earlier tries."""
_PATIENCE: Final = 5
"""Tries of one opponent before another is tried."""
_LEAST: Final = 1e-3
"""Less resemblance counts as none: the try was at another place by now."""


@dataclass(frozen=True, slots=True, eq=False)
class _Poses:
    """Poses of a vehicle from a step on: (F, 2), (F), and its speed at the step before."""

    position_m: Floats
    heading_rad: Floats
    now_m: Floats
    now_mps: float

    @classmethod
    def of(cls, rollout: Rollout, agent_id: AgentId, step: int) -> "_Poses | None":
        """After a step; at constant velocity after the rollout; None if it is not there."""
        tracks = rollout.tracks
        if agent_id not in tracks.ids or step >= tracks.steps:
            return None
        row = tracks.row(agent_id)
        if not tracks.valid[row, step]:
            return None
        away = np.flatnonzero(~tracks.valid[row, step:])
        end = step + int(away[0]) if len(away) else tracks.steps
        steps = np.arange(step + 1, step + 1 + FUTURE_STEPS)
        known, beyond = np.minimum(steps, end - 1), np.maximum(steps - (end - 1), 0)
        heading = tracks.heading_rad[row, known]
        ahead = beyond * rollout.dt_s * tracks.speed_mps[row, end - 1]
        position = tracks.position_m[row, known] + ahead[:, None] * frames.unit(heading)
        now = tracks.position_m[row, step]
        return cls(position, heading, now, float(tracks.speed_mps[row, step]))


@dataclass(frozen=True, slots=True, eq=False)
class _Try:
    """An episode; ``wanted``: its collision counts, if the AV does the same again."""

    rollout: Rollout
    wanted: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Answers:
    """R tries at the step of a plan: motions of the AV and of the opponent."""

    av: list[_Poses]
    opponent: list[_Poses]
    wanted: Bools


@dataclass(frozen=True, slots=True, eq=False)
class Predicted:
    """Candidates of an opponent, its heat map, and the AV's reactions to each candidate."""

    own: Candidates
    heat: Heat | None
    reactions: list[Forecast]


@dataclass(slots=True, eq=False)
class Experience:
    """The tries of one attack so far.

    Attributes:
        one_opponent: only the first opponent can attack.
        several: more tries may follow from the same moment.
        last: the last try.
        given_up: opponents that others come before.
        predicted: of opponents at a step, before their first plan; no try changes it until one is
            of that opponent.
    """

    one_opponent: bool = False
    several: bool = False

    last: Rollout | None = None
    _tries: list[_Try] = field(default_factory=list)
    given_up: set[AgentId] = field(default_factory=set)
    predicted: dict[tuple[int, AgentId], Predicted] = field(default_factory=dict)

    def add(self, rollout: Rollout, *, wanted: bool) -> bool:
        """Remember a try; False if nothing new can be tried any more.

        An opponent that drove as in an earlier try, or that has tried `_PATIENCE` times, is given
        up: others come first. If it drives the same again after that, or is the only one, nothing
        new can be tried.
        """
        opponent = rollout.opponent_id
        if opponent is None:
            return False
        own = [one.rollout for one in self._tries if one.rollout.opponent_id == opponent]
        repeated, known = any(_same(one, rollout) for one in own), opponent in self.given_up
        if repeated or len(own) + 1 >= _PATIENCE:
            self.given_up.add(opponent)
        self._tries.append(_Try(rollout, wanted))
        self.last = rollout
        return not (repeated and (known or self.one_opponent))

    def aimed_at(self, view: View, opponent_id: AgentId, predicted: Forecast) -> Forecast:
        """Futures of the AV to aim at: the predicted ones and those of tries with the opponent."""
        answers = self._answers(view, opponent_id)
        if not answers.av:
            return predicted
        near = np.exp(-_apart(view, answers) / (2 * _BANDWIDTH_M**2))
        if near.max() < _LEAST:
            return predicted
        share = _AIMED_SHARE * near.max()
        return _joined(predicted, answers, share * near / near.sum())[0]

    def informed(
        self, situation: Situation, own: Candidates, predicted: list[Forecast]
    ) -> tuple[list[Forecast], Bools | None]:
        """The AV's reactions to N1 candidates with those of tries, and (N1, N2) which may count.

        As predicted, and None, if no try resembles the present.
        """
        answers = self._answers(situation.view, situation.opponent_id)
        if not answers.av:
            return predicted, None
        moved = np.stack([one.position_m[:_COMPARED_STEPS] for one in answers.opponent])
        each = own.forecast.futures.position_m[:, None, :_COMPARED_STEPS] - moved
        square = (each**2).sum(-1).mean(-1) + _apart(situation.view, answers)
        near = np.exp(-square / (2 * _BANDWIDTH_M**2))
        if near.max() < _LEAST:
            return predicted, None
        weight = near * (near.max(axis=1) / np.maximum(near.sum(axis=1), 1e-12))[:, None]
        both = zip(predicted, weight, strict=True)
        known, counts = zip(*(_joined(one, answers, row) for one, row in both), strict=True)
        return list(known), np.stack(counts)

    def _answers(self, view: View, opponent_id: AgentId) -> _Answers:
        found: list[tuple[_Poses, _Poses, bool]] = []
        for one in self._tries:
            if one.rollout.opponent_id == opponent_id:
                av = _Poses.of(one.rollout, view.av_id, view.step)
                opponent = _Poses.of(one.rollout, opponent_id, view.step)
                if av is not None and opponent is not None:
                    found.append((av, opponent, one.wanted))
        return _Answers(
            [av for av, _, _ in found],
            [opponent for _, opponent, _ in found],
            np.array([wanted for *_, wanted in found], bool),
        )


def _same(a: Rollout, b: Rollout) -> bool:
    """Whether the opponent of both drove the same."""
    if a.tracks.steps != b.tracks.steps:
        return False
    rows = (one.tracks.row(str(one.opponent_id)) for one in (a, b))
    mine, theirs = (one.tracks.position_m[row] for one, row in zip((a, b), rows, strict=True))
    return bool(np.allclose(mine, theirs, atol=0.01))


def _apart(view: View, answers: _Answers) -> Floats:
    """(R) square distance of the AV's present state from that in each try, m2."""
    row = view.history.row(view.av_id)
    now, speed = view.history.position_m[row, -1], view.history.speed_mps[row, -1]
    return np.array(
        [((one.now_m - now) ** 2).sum() + (one.now_mps - speed) ** 2 for one in answers.av]
    )


def _joined(predicted: Forecast, answers: _Answers, weight: Floats) -> tuple[Forecast, Bools]:
    """The predicted futures with those of tries, of weights (R); and which of them may count."""
    futures = predicted.futures
    position = np.stack([one.position_m for one in answers.av])
    heading = np.stack([one.heading_rad for one in answers.av])
    probability = np.concatenate([predicted.probability * (1 - weight.sum()), weight])
    order = np.argsort(-probability, kind="stable")
    counts = np.concatenate([np.ones(len(predicted.probability), bool), answers.wanted])
    joined = Futures(
        agent_id=futures.agent_id,
        position_m=np.concatenate([futures.position_m, position])[order],
        heading_rad=np.concatenate([futures.heading_rad, heading])[order],
    )
    return replace(predicted, futures=joined, probability=probability[order]), counts[order]
