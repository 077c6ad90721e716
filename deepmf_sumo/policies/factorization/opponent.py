"""Which vehicle attacks: chosen once, before the first plan (Algorithm 1)."""

import numpy as np

from deepmf_sumo.datatypes import AgentId, Floats, OpponentScores, View
from deepmf_sumo.errors import RunError


def from_scores(scores: OpponentScores, how: str, rng: np.random.Generator) -> AgentId | None:
    """The opponent by ``argmax``, ``sample`` (softmax of the logits) or ``partner``.

    ``partner`` takes the head that was trained on labelled interacting partners. None where there
    is no candidate.
    """
    if not scores.ids:
        return None
    if how == "sample":
        return scores.ids[int(rng.choice(len(scores.ids), p=softmax(scores.logits)))]
    logits = scores.partner_logits if how == "partner" else scores.logits
    return scores.ids[int(np.argmax(logits))]


def named(view: View, agent_id: AgentId) -> AgentId:
    """The opponent that the settings name. Raises RunError if it is not there, or is the AV."""
    others = [
        other
        for other, kind in zip(view.history.ids, view.history.kinds, strict=True)
        if kind == "vehicle" and other != view.av_id
    ]
    if agent_id not in others:
        known = ", ".join(others[:10]) + (" ..." if len(others) > 10 else "")
        raise RunError(
            f"opponent '{agent_id}' is no vehicle beside the AV at step {view.step}; "
            f"name one of: {known or 'none is there'}, or use argmax."
        )
    return agent_id


def softmax(logits: Floats) -> Floats:
    """(N) probabilities of logits (N)."""
    power = np.exp(logits - np.max(logits))
    share: Floats = power / power.sum()
    return share
