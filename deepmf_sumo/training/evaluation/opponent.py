"""The opponent network, and rules without a network, against pseudo-labels and labelled partners.

Candidates are all vehicles within 80 m of the AV at the current step. The same figures are given
for those that an attack may choose (``attackable``), which are not parked.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final, SupportsInt

import numpy as np

from deepmf_sumo.deepmf.networks.opponent import RANGE_M, Opponent
from deepmf_sumo.scene import Bools, Floats, Ints, Scene, View
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.slow import WAITING_MPS
from deepmf_sumo.training.evaluation.measures import error_if_right, expected_error, mean
from deepmf_sumo.training.evaluation.table import ALL, Figure, Figures, Key
from deepmf_sumo.training.samples.opponent import interacting

_TIMES_S = np.arange(0.0, 8.01, 0.1)
_STILL_M = 0.5
_BESIDE, _AHEAD = 2.0, 0.2
"""Cost of a metre to the side of the AV's heading, and of a metre along it."""
LABEL_HEAD, PARTNER_HEAD = "label_head", "partner_head"
"""Conditions of figures of the network's two heads."""
ATTACKABLE: Final = "attackable"
_COUNTS: Final = (
    *((name, ALL) for name in ("scenes", "scenes_with_positive", "scenes_with_partner", "parked")),
    *((f"{name}_parked", ALL) for name in ("positives", "partners")),
    ("partners_left_out", ALL),
    *((name, group) for name in ("candidates", "positives") for group in (ALL, ATTACKABLE)),
)
"""Quantities that are counted, each of a group of candidates."""


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

    Precision is taken after the last candidate with the same score, so that the order of equal
    scores does not matter.
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
    """Candidates of all scenes, ranked by one score. Candidates without a score have -inf.

    Attributes:
        best_positive: rank of the first positive of each scene, from 0; infinite if no positive has
            a score.
        places: the same of the labelled partner, in each scene that names one.
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
        """The labelled partner's row among scores (A); None if it is not a candidate."""
        if partner is None or scores[partner] == -np.inf:
            self.places.append(np.inf)
        else:
            self.places.append(float(_in_order(scores).tolist().index(partner)))

    def by_label(self) -> dict[str, Figure]:
        """AUROC, average precision, and in how many scenes a positive is first, or among three."""
        area = precision = None
        if self.scores:
            scores, labels = np.concatenate(self.scores), np.concatenate(self.labels)
            area, precision = auroc(scores, labels), average_precision(scores, labels)
        return {
            "auroc": Figure(None if area is None else round(area, 4)),
            "average_precision": Figure(None if precision is None else round(precision, 4)),
            **_among_first("top{}_positive", self.best_positive),
        }

    def by_partner(self) -> dict[str, Figure]:
        """In how many scenes the labelled partner is the first, and among the first three."""
        return _among_first("partner_top{}", self.places)


def _in_order(scores: Floats) -> Ints:
    """Rows by falling score; equal scores keep their order."""
    return np.argsort(-scores, kind="stable")


def _among_first(name: str, places: Sequence[float]) -> dict[str, Figure]:
    """Share and number of scenes in which it is the first, and among the first three."""
    found: dict[str, Figure] = {}
    for count in (1, 3):
        hits = [place < count for place in places]
        found[name.format(count)] = Figure(mean(hits), None, len(hits))
        found[f"{name.format(count)}_scenes"] = Figure(sum(hits))
    return found


def corridor(view: View, rows: Ints) -> Floats:
    """(A) nearness to the AV, where distance from its line ahead counts ten times as much."""
    place = _local(view, rows)
    return np.asarray(-(_BESIDE * np.abs(place[:, 1]) + _AHEAD * np.abs(place[:, 0])), float)


def nearest(view: View, rows: Ints) -> Floats:
    """(A) nearness now."""
    distance: Floats = np.hypot(*_local(view, rows).T)
    return -distance


def nearest_moving(view: View, rows: Ints) -> Floats:
    """(A) nearness of vehicles that move now or moved in the last second; -inf for others."""
    tracks = view.history
    first = tracks.valid[rows].argmax(1)
    moved = np.hypot(*(tracks.position_m[rows, -1] - tracks.position_m[rows, first]).T)
    moving = (tracks.speed_mps[rows, -1] > WAITING_MPS) | (moved > _STILL_M)
    return np.where(moving, nearest(view, rows), -np.inf)


def constant_velocity(view: View, rows: Ints) -> Floats:
    """(A) nearness at the closest approach within 8 s if both vehicles keep their velocity."""
    tracks, av = view.history, view.history.row(view.av_id)
    apart = tracks.position_m[rows, -1] - tracks.position_m[av, -1]
    relative = tracks.velocity_mps[rows, -1] - tracks.velocity_mps[av, -1]
    way = apart[:, None] + _TIMES_S[:, None] * relative[:, None]
    return np.asarray(-np.linalg.norm(way, axis=-1).min(1), float)


RULES: Final[dict[str, Callable[[View, Ints], Floats]]] = {
    "corridor": corridor,
    "nearest": nearest,
    "nearest_moving": nearest_moving,
    "constant_velocity": constant_velocity,
}


def _local(view: View, rows: Ints) -> Floats:
    """(A, 2) positions now, ahead and to the left of the AV."""
    tracks, av = view.history, view.history.row(view.av_id)
    return frames.to_local(
        tracks.position_m[rows, -1], tracks.position_m[av, -1], float(tracks.heading_rad[av, -1])
    )


@dataclass(slots=True)
class OpponentFigures:
    """Measures the opponent network.

    Attributes:
        rankings: by group of candidates, and head or rule.
        counts: of scenes, candidates and partners, by quantity and group.
    """

    rankings: dict[tuple[str, str], Ranking] = field(
        default_factory=lambda: {
            (group, name): Ranking()
            for group in (ALL, ATTACKABLE)
            for name in (LABEL_HEAD, PARTNER_HEAD, *RULES)
        }
    )
    counts: Counter[tuple[str, str]] = field(
        default_factory=lambda: Counter(dict.fromkeys(_COUNTS, 0))
    )
    temperature: float = 1.0
    offset: float = 0.0

    def add(self, opponent: Opponent, scene: Scene, view: View) -> None:
        """Add one scene."""
        rows = vehicles_near(view)
        ids = [view.history.ids[row] for row in rows]
        positive = interacting(scene.tracks, scene.road, scene.av_id, ids)
        found = opponent.score(view, everyone=True)
        place = {agent_id: column for column, agent_id in enumerate(found.ids)}
        column = np.array([place.get(agent_id, -1) for agent_id in ids], np.int64)
        known = column >= 0
        attackable = np.isin(ids, opponent.score(view).ids)
        scores = {name: rule(view, rows) for name, rule in RULES.items()}
        heads = {LABEL_HEAD: found.logits, PARTNER_HEAD: found.partner_logits}
        for name, logits in heads.items():
            scores[name] = np.full(len(rows), -np.inf)
            scores[name][known] = logits[column[known]]
        for name, values in scores.items():
            self.rankings[ALL, name].add(values, positive)
            self.rankings[ATTACKABLE, name].add(values[attackable], positive[attackable])
        self._add_partner(scene, ids, scores, attackable)
        self.temperature, self.offset = opponent.temperature, opponent.offset
        self._count("scenes")
        self._count("scenes_with_positive", positive.any())
        self._count("parked", (~attackable).sum())
        self._count("positives_parked", (positive & ~attackable).sum())
        for group, chosen in ((ALL, slice(None)), (ATTACKABLE, attackable)):
            self._count("candidates", len(positive[chosen]), group)
            self._count("positives", positive[chosen].sum(), group)

    def _count(self, quantity: str, more: SupportsInt = 1, group: str = ALL) -> None:
        self.counts[quantity, group] += int(more)

    def _add_partner(
        self, scene: Scene, ids: list[str], scores: dict[str, Floats], attackable: Bools
    ) -> None:
        partner = scene.partner_id
        if partner is None:
            return
        row = ids.index(partner) if partner in ids else None
        among = None if row is None or not attackable[row] else int(attackable[:row].sum())
        self._count("scenes_with_partner")
        self._count("partners_left_out", row is None)
        self._count("partners_parked", row is not None and among is None)
        for name, values in scores.items():
            self.rankings[ALL, name].add_partner(values, row)
            self.rankings[ATTACKABLE, name].add_partner(values[attackable], among)

    def figures(self) -> Figures:
        """All figures of the two heads and of the rules."""
        found = {
            Key("opponent", quantity, group=group): Figure(count)
            for (quantity, group), count in self.counts.items()
        }
        for (group, name), ranking in self.rankings.items():
            for quantity, figure in (ranking.by_label() | ranking.by_partner()).items():
                found[Key("opponent", quantity, condition=name, group=group)] = figure
        for quantity, value in self._calibration().items():
            key = Key("opponent", quantity, condition=LABEL_HEAD, group=ATTACKABLE)
            found[key] = Figure(value)
        return found

    def _calibration(self) -> dict[str, float | None]:
        """ECE of the first head's sigmoid over attackable candidates, calibrated and as trained.

        And the mean and the 95 % quantile of the ECE of as many correct scores.
        """
        ranked = self.rankings[ATTACKABLE, LABEL_HEAD]
        logits = np.concatenate([np.zeros(0), *ranked.scores])
        happened = np.concatenate([np.zeros(0, bool), *ranked.labels])
        trained = (logits - self.offset) * self.temperature
        least = error_if_right(_sigmoid(logits)) or (None, None)
        return {
            "ece": expected_error(_sigmoid(logits), happened),
            "ece_if_right": least[0],
            "ece_if_right_95": least[1],
            "ece_uncalibrated": expected_error(_sigmoid(trained), happened),
            "mean_score": mean(_sigmoid(logits).tolist()),
        }


def vehicles_near(view: View) -> Ints:
    """Rows of the vehicles within 80 m of the AV, without it."""
    tracks, av = view.history, view.history.row(view.av_id)
    vehicle = np.array([kind == "vehicle" for kind in tracks.kinds], bool)
    vehicle[av] = False
    away = np.hypot(*(tracks.position_m[:, -1] - tracks.position_m[av, -1]).T)
    return np.flatnonzero(vehicle & (away <= RANGE_M))


def _sigmoid(logits: Floats) -> Floats:
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(logits, -60.0, 60.0))), float)
