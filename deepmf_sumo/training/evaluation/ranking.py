"""How well scores rank candidates: by label, and by the place of one named candidate."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from deepmf_sumo.datatypes import Bools, Floats, Ints
from deepmf_sumo.training.evaluation.estimates import mean


def auroc(scores: Floats, labels: Bools) -> float | None:
    """Area under the ROC curve; ties count half. None without both kinds."""
    positive, negative = int(labels.sum()), int((~labels).sum())
    if not positive or not negative:
        return None
    _, inverse, counts = np.unique(scores, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(counts) - (counts - 1) / 2)[inverse]
    return float((ranks[labels].sum() - positive * (positive + 1) / 2) / (positive * negative))


def average_precision(scores: Floats, labels: Bools) -> float | None:
    """Area under the precision-recall curve (step-wise). None without positives.

    Candidates of one score stand together: precision is taken after the last of them, so that their
    order does not matter.
    """
    if not labels.any():
        return None
    order = np.argsort(-scores, kind="stable")
    hits, ordered = labels[order], scores[order]
    last = np.searchsorted(-ordered, -ordered, side="right")  # count of those that score no less
    precision = np.cumsum(hits)[last - 1] / last
    return float(precision[hits].mean())


@dataclass(slots=True)
class Ranking:
    """Scenes' candidates, ranked by one score. -inf is for what the score does not rank.

    Attributes:
        best_positive: place of the first positive of each scene, 0 first; infinite where none is
            ranked.
        places: of the labelled partner in each scene that names one, likewise.
    """

    scores: list[Floats] = field(default_factory=list)
    labels: list[Bools] = field(default_factory=list)
    best_positive: list[float] = field(default_factory=list)
    places: list[float] = field(default_factory=list)

    def add(self, scores: Floats, positive: Bools) -> None:
        """Candidates of one scene: scores (A) and labels (A)."""
        if len(scores):
            self.scores.append(scores)
            self.labels.append(positive)
            order = _in_order(scores)
            found = np.flatnonzero((positive & (scores > -np.inf))[order])
            self.best_positive.append(float(found[0]) if len(found) else np.inf)

    def add_partner(self, scores: Floats, partner: int | None) -> None:
        """The labelled partner's row among scores (A); None where it is no candidate."""
        if partner is None or scores[partner] == -np.inf:
            self.places.append(np.inf)
        else:
            self.places.append(float(_in_order(scores).tolist().index(partner)))

    def by_label(self) -> dict[str, Any]:
        """AUROC, average precision, and in how many scenes a positive is first, or among three."""
        area = precision = None
        if self.scores:
            scores, labels = np.concatenate(self.scores), np.concatenate(self.labels)
            area, precision = auroc(scores, labels), average_precision(scores, labels)
        found = {
            "auroc": None if area is None else round(area, 4),
            "average_precision": None if precision is None else round(precision, 4),
        }
        return found | _among_first("top{}_positive", self.best_positive)

    def by_partner(self, prefix: str = "partner") -> dict[str, Any]:
        """In how many scenes the labelled partner is the first, and among the first three."""
        return _among_first(prefix + "_top{}", self.places)


def _in_order(scores: Floats) -> Ints:
    """Rows from the highest score down; who comes first among equals stays first."""
    return np.argsort(-scores, kind="stable")


def _among_first(name: str, places: Sequence[float]) -> dict[str, Any]:
    """Share and number of scenes whose place is the first, and among the first three."""
    found: dict[str, Any] = {}
    for count in (1, 3):
        hits = [place < count for place in places]
        found[name.format(count)] = mean(hits)
        found[f"{name.format(count)}_scenes"] = sum(hits)
    return found
