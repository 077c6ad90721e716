"""The opponent network against the pseudo-labels and the labelled partner.

Candidates are all vehicles at the step within 80 m of the AV. The same among those that an attack
may choose, which are not parked, stands beside it.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from deepmf_sumo.datatypes import Bools, Floats, Ints, Scene, View
from deepmf_sumo.predictors.opponent import RANGE_M, Opponent
from deepmf_sumo.training import labels
from deepmf_sumo.training.evaluation.calibration import error_if_right, expected_error
from deepmf_sumo.training.evaluation.estimates import mean
from deepmf_sumo.training.evaluation.opponent_rules import RULES
from deepmf_sumo.training.evaluation.ranking import Ranking

_HEADS = ("label_head", "partner_head")


@dataclass(slots=True)
class OpponentFigures:
    """What has been measured of the opponent network.

    Attributes:
        all, attackable: rankings by heads and rules, of all candidates and of the attackable ones.
        partners_left_out: labelled partners that are no vehicles, or farther than 80 m.
    """

    all: dict[str, Ranking] = field(
        default_factory=lambda: {name: Ranking() for name in (*_HEADS, *RULES)}
    )
    attackable: dict[str, Ranking] = field(
        default_factory=lambda: {name: Ranking() for name in (*_HEADS, *RULES)}
    )
    logits: list[Floats] = field(default_factory=list)
    positives: list[Bools] = field(default_factory=list)
    temperature: float = 1.0
    offset: float = 0.0
    scenes: int = 0
    with_positive: int = 0
    parked: int = 0
    positives_parked: int = 0
    partners_parked: int = 0
    partners_left_out: int = 0

    def add(self, opponent: Opponent, scene: Scene, view: View) -> None:
        """One scene."""
        rows = vehicles_near(view)
        ids = [view.history.ids[row] for row in rows]
        positive = labels.interacting(scene.tracks, scene.av_id, ids)
        found = opponent.score(view, everyone=True)
        place = {agent_id: column for column, agent_id in enumerate(found.ids)}
        column = np.array([place.get(agent_id, -1) for agent_id in ids], np.int64)
        known = column >= 0
        attackable = np.isin(ids, opponent.score(view).ids)
        scores = {name: rule(view, rows) for name, rule in RULES.items()}
        for name, logits in zip(_HEADS, (found.logits, found.partner_logits), strict=True):
            scores[name] = np.full(len(rows), -np.inf)
            scores[name][known] = logits[column[known]]
        for name, values in scores.items():
            self.all[name].add(values, positive)
            self.attackable[name].add(values[attackable], positive[attackable])
        self._add_partner(scene, ids, scores, attackable)
        self.logits.append(scores["label_head"][attackable])
        self.positives.append(positive[attackable])
        self.temperature, self.offset = opponent.temperature, opponent.offset
        self.scenes += 1
        self.with_positive += bool(positive.any())
        self.parked += int((~attackable).sum())
        self.positives_parked += int((positive & ~attackable).sum())

    def _add_partner(
        self, scene: Scene, ids: list[str], scores: dict[str, Floats], attackable: Bools
    ) -> None:
        partner = scene.partner_id
        if partner is None:
            return
        row = ids.index(partner) if partner in ids else None
        self.partners_left_out += row is None
        self.partners_parked += row is not None and not attackable[row]
        among = None if row is None or not attackable[row] else int(attackable[:row].sum())
        for name, values in scores.items():
            self.all[name].add_partner(values, row)
            self.attackable[name].add_partner(values[attackable], among)

    def summary(self) -> dict[str, Any]:
        """Nested figures; at the top those of the network among all candidates."""
        known = self.all["label_head"]
        count = sum(len(each) for each in known.scores)
        positives = int(sum(each.sum() for each in known.labels))
        return {
            "scenes": self.scenes,
            "candidates": count,
            "positives": positives,
            "scenes_with_positive": self.with_positive,
            "scenes_with_partner": len(known.places),
            "parked": self.parked,
            "positives_parked": self.positives_parked,
            "partners_parked": self.partners_parked,
            "partners_left_out": self.partners_left_out,
            **_network(self.all),
            **self._calibration(),
            "baselines": _rules(self.all),
            "attackable": {
                "candidates": count - self.parked,
                "positives": positives - self.positives_parked,
                **_network(self.attackable),
                "baselines": _rules(self.attackable),
            },
        }

    def _calibration(self) -> dict[str, Any]:
        """ECE of the first head's sigmoid over attackable candidates, calibrated and as trained.

        And the mean and the 95 % quantile of the ECE that so many right scores would show.
        """
        logits = np.concatenate(self.logits) if self.logits else np.zeros(0)
        happened = np.concatenate(self.positives) if self.positives else np.zeros(0, bool)
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


def _network(rankings: dict[str, Ranking]) -> dict[str, Any]:
    return {
        **rankings["label_head"].by_label(),
        **rankings["partner_head"].by_partner(),
        **rankings["label_head"].by_partner("partner_by_label_head"),
    }


def _rules(rankings: dict[str, Ranking]) -> dict[str, Any]:
    return {name: {**rankings[name].by_label(), **rankings[name].by_partner()} for name in RULES}


def _sigmoid(logits: Floats) -> Floats:
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(logits, -60.0, 60.0))), float)
