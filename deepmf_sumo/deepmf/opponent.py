"""The choice of the vehicle that attacks: once, before the first plan (Algorithm 1)."""

from typing import Final

import numpy as np

from deepmf_sumo.deepmf.networks.opponent import Opponent, passes_over
from deepmf_sumo.errors import RunError
from deepmf_sumo.scene import AgentId, Floats, OpponentScores, View

SCORED: Final = frozenset({"argmax", "sample", "partner"})
"""Values of ``opponent`` that need the scores of the opponent network."""


def choose(
    view: View,
    how: str,
    predictor: Opponent | None,
    partner_id: AgentId | None,
    rng: np.random.Generator,
) -> tuple[AgentId | None, OpponentScores | None]:
    """The opponent, None without candidates; and the scores, if it was chosen by scores.

    Args:
        view: at the current step.
        how: one of `SCORED`, ``labelled`` or the id of a vehicle.
        predictor: the opponent network; only `SCORED` needs it.
        partner_id: the AV's interaction partner according to the recording.
        rng: for ``sample``.

    Raises RunError if the named vehicle is not in the view, or no partner is labelled.
    """
    if how in SCORED:
        assert predictor is not None
        scores = _on_level(view, predictor.score(view))
        return from_scores(scores, how, rng), scores
    if how != "labelled":
        return named(view, how), None
    if partner_id is None:
        raise RunError(
            "opponent is 'labelled', but the recording names no partner of the AV; use "
            "argmax, sample or partner."
        )
    return named(view, partner_id), None


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
    """At most ``count`` vehicles by ``argmax`` or ``partner``, highest score first."""
    logits = scores.partner_logits if how == "partner" else scores.logits
    return [scores.ids[row] for row in np.argsort(-logits, kind="stable")[:count]]


def named(view: View, agent_id: AgentId) -> AgentId:
    """The opponent that the settings name. Raises RunError if it is not in view, or is the AV."""
    others = [
        other
        for other, kind in zip(view.history.ids, view.history.kinds, strict=True)
        if kind == "vehicle" and other != view.av_id
    ]
    if agent_id not in others:
        known = ", ".join(others[:10]) + (" ..." if len(others) > 10 else "")
        raise RunError(
            f"opponent '{agent_id}' is not a vehicle near the AV at step {view.step}; "
            f"name one of: {known or 'there are none'}, or use argmax."
        )
    return agent_id


def softmax(logits: Floats) -> Floats:
    """(N) probabilities of logits (N)."""
    power = np.exp(logits - np.max(logits))
    return power / power.sum()
