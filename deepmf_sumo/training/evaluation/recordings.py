"""Recordings and weights -> the table of figures, in a file and on the cards.

`PeopleFigures` measures the predictor of people, and what the conditional network makes of a
person's future. Targets are all pedestrians and cyclists in view at the current step of a
recording, whether they move or not. The groups ``moving`` leave out those that are slower than
0.5 m/s now.
"""

import json
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch

from deepmf_sumo.deepmf.networks import weights
from deepmf_sumo.deepmf.networks.decode import KNOT_STEPS, KNOTS_S
from deepmf_sumo.deepmf.networks.people import People, PeoplePrediction
from deepmf_sumo.deepmf.networks.predict import Conditional
from deepmf_sumo.deepmf.networks.weights import Network, Predictors
from deepmf_sumo.errors import OutputError, ReaderError
from deepmf_sumo.scene import ROLLOUT, Floats, Scene, View, readers
from deepmf_sumo.scene.geometry.slow import WAITING_MPS
from deepmf_sumo.scene.readers.base import Refusal
from deepmf_sumo.training import cards
from deepmf_sumo.training.evaluation.conditional import (
    MARGINAL,
    SHUFFLED,
    TRUE,
    ConditionalFigures,
    PredictedPair,
)
from deepmf_sumo.training.evaluation.forecasts import FEW, RECORDED, ForecastTarget, targets
from deepmf_sumo.training.evaluation.marginal import MarginalFigures, Marginals, constant_velocity
from deepmf_sumo.training.evaluation.measures import (
    HORIZONS,
    STEPS,
    Measured,
    final_errors,
    path_errors,
)
from deepmf_sumo.training.evaluation.opponent import (
    ATTACKABLE,
    LABEL_HEAD,
    PARTNER_HEAD,
    OpponentFigures,
)
from deepmf_sumo.training.evaluation.table import (
    NETWORK,
    OF_MODES,
    Evaluation,
    Figure,
    Figures,
    Key,
    ObjectValues,
)
from deepmf_sumo.training.fit import checkpoints
from deepmf_sumo.training.networks import clusters
from deepmf_sumo.training.networks.clusters import Clusters
from deepmf_sumo.training.samples import windows
from deepmf_sumo.training.samples.windows import Future


class PeopleFigures:
    """Measures the predictor of people, by class, and the AV's reaction to them."""

    def __init__(self) -> None:
        self.samples = ObjectValues("people")
        self.counts: Counter[str] = Counter()
        self.reactions = ConditionalFigures((FEW,))

    def add(self, people: People, scene: Scene, view: View) -> None:
        """Add the people of one scene; simulated attacks give none, their people are the log's."""
        if scene.source.dataset == ROLLOUT:
            return
        for future in windows.people(scene, scene.now):
            self._add(people.predict(view, future.agent_id), _target(scene, view, future))

    def _add(self, prediction: PeoplePrediction, target: ForecastTarget) -> None:
        future, kind = target.future, target.view.history.kinds[target.row]
        moving = target.speed_mps > WAITING_MPS
        groups = (kind, f"moving {kind}") if moving else (kind,)
        self.counts.update(groups)
        ways = {
            NETWORK: prediction.modes(FEW).futures.position_m,
            CONSTANT_VELOCITY: constant_velocity(target),
        }
        for condition, modes_m in ways.items():
            errors = final_errors(modes_m, future, "min_fde")
            errors |= path_errors(modes_m, future, target.speed_mps)
            self.samples.add(errors, len(modes_m), condition, groups)
        for seconds, step in STEPS.items():
            modes_m = prediction.modes(FEW, chosen_at=step).futures.position_m
            errors = final_errors(modes_m, future, "min_fde_of_horizon", (seconds,))
            self.samples.add(errors, FEW, groups=groups)
        self.samples.add(densities(prediction, future), groups=groups)

    def add_reaction(
        self, conditional: Conditional, scene: Scene, view: View, alone: Marginals | None
    ) -> None:
        """The AV's future given that of the person who comes closest to it.

        ``alone``: the marginal network's prediction of the AV; None where the AV is no target.
        """
        if alone is None or scene.source.dataset == ROLLOUT:
            return
        person = windows.nearest_person(scene, scene.av_id, scene.now, NEAR_M)
        if person is None:
            return
        av = _target(scene, view, windows.future_of(scene, scene.av_id, scene.now))
        kind = view.history.kinds[view.history.row(person.agent_id)]
        pair = PredictedPair(
            target=replace(av, role="av"), partner=person, marginals=alone, group=f"given {kind}"
        )
        self.reactions.add(conditional, [pair])
        straight = final_errors(constant_velocity(av), av.future, "min_fde")
        self.reactions.samples.add(straight, 1, CONSTANT_VELOCITY, (f"given {kind}",))
        self.counts[f"given {kind}"] += 1

    def figures(self, conditional: Conditional) -> Figures:
        """All figures."""
        self.reactions.finish(conditional)
        counts: Figures = {
            Key("people", "targets", group=group): Figure(count)
            for group, count in self.counts.items()
        }
        reactions = {
            key: figure
            for key, figure in self.reactions.figures().items()
            if key.group.startswith("given ")
        }
        return counts | self.samples.figures() | reactions


def _target(scene: Scene, view: View, future: Future) -> ForecastTarget:
    row = view.history.row(future.agent_id)
    return ForecastTarget(
        scene=scene,
        view=view,
        future=future,
        partner=None,
        row=row,
        speed_mps=float(view.history.speed_mps[row, -1]),
        role="partner",
    )


def densities(prediction: PeoplePrediction, future: Future) -> dict[Measured, float]:
    """At each known knot: negative log density, and whether the outcome is inside the mass.

    It is inside a share of the mass if its density is larger than that of the rest of 1000 places
    drawn from the prediction, with a fixed seed.
    """
    knots_m: Floats = future.position_m[list(KNOT_STEPS)]
    log = prediction.knot_log_density(knots_m[None])[0]
    rng = np.random.default_rng(zlib.crc32(future.agent_id.encode()))
    drawn = prediction.knot_log_density(prediction.drawn(_DRAWN, rng))
    found: dict[Measured, float] = {}
    for knot, seconds in enumerate(KNOTS_S):
        if future.valid[KNOT_STEPS[knot]]:
            found["negative_log_density", seconds] = -float(log[knot])
            for share in INSIDE:
                least = np.quantile(drawn[:, knot], 1 - share)
                found[f"inside_{100 * share:g}", seconds] = float(log[knot] >= least)
    return found


MODES: Final = (6, 16, 32)
_NAMED: Final = 20
"""Refused records that are named; the others are counted."""
CONSTANT_VELOCITY: Final = "constant_velocity"
INSIDE: Final = (0.5, 0.9)
"""Shares of the mass: as many outcomes should be inside the densest region that has it."""
_DRAWN: Final = 1000
NEAR_M: Final = 15.0
"""A person whose way comes this close to the AV's, with 2 m a second between, may be given."""


@dataclass(slots=True)
class RefusedRecords:
    """Records that could not be used."""

    count: int = 0
    reasons: list[str] = field(default_factory=list)

    def add(self, file: str, record: int, reason: str) -> None:
        """Count a record; the first twenty reasons are kept."""
        self.count += 1
        if len(self.reasons) < _NAMED:
            known = file in reason  # most reasons of readers name the file
            self.reasons.append(reason if known else f"{file}, record {record}: {reason}")


def evaluate(
    data: Sequence[Path],
    name: str | Path,
    report: Callable[[str], None],
    candidates: int = max(MODES),
) -> Evaluation:
    """Measure all three networks, and the predictor of people.

    Targets are the labelled vehicles of each scene; in a scene without labels, the AV and all
    vehicles that move within 50 m of it. In a simulated attack the only target is the AV, and no
    opponent scores are measured, since the attack has made its own labels. ``candidates`` is a
    number of modes (N1) to measure besides 6, 16, 32. Raises ReaderError if no scene is usable.
    """
    predictors = weights.load(name)
    modes = tuple(sorted({*MODES, candidates}))
    fitted = clusters.read(predictors.folder) if predictors.folder else None
    measured = _Measured(predictors, modes, fitted)
    refused = RefusedRecords()
    for scene in _usable(data, refused):
        measured.add(scene)
        if measured.scenes % 20 == 0:
            report(f"{measured.scenes} scenes")
    if not measured.scenes:
        raise ReaderError(_nothing(data, refused))
    return Evaluation(
        data=[path.name for path in data],
        weights=str(name),
        scenes=measured.scenes,
        attacked_scenes=measured.attacked,
        refused=refused.count,
        refusals=refused.reasons,
        labelled_objects=measured.labelled,
        modes=modes,
        clusters=f"fitted on {fitted.samples} trajectories"
        if fitted
        else "not fitted: there is no file beside the weights",
        figures=measured.figures(),
    )


class _Measured:
    """The three networks on the scenes added so far."""

    def __init__(
        self, predictors: Predictors, modes: Sequence[int], fitted: Clusters | None
    ) -> None:
        self.predictors = predictors
        self.opponent = OpponentFigures()
        self.marginal = MarginalFigures(modes, fitted)
        self.conditional = ConditionalFigures(modes)
        self.people = PeopleFigures()
        self.scenes = self.attacked = self.labelled = 0

    def add(self, scene: Scene) -> None:
        view = windows.view_at(scene, scene.now)
        attacked = scene.source.dataset == ROLLOUT
        if not attacked:
            self.opponent.add(self.predictors.opponent, scene, view)
        self.people.add(self.predictors.people, scene, view)
        pairs, alone = [], None
        for target in targets(scene, view):
            found = self.marginal.add(self.predictors.marginal, target)
            alone = found if target.role == "av" else alone
            if target.partner is not None:
                pairs.append(PredictedPair(target=target, partner=target.partner, marginals=found))
        self.conditional.add(self.predictors.conditional, pairs)
        self.people.add_reaction(self.predictors.conditional, scene, view, alone)
        self.scenes += 1
        self.attacked += attacked
        self.labelled += len(scene.interest)

    def figures(self) -> Figures:
        self.conditional.finish(self.predictors.conditional)
        return (
            self.opponent.figures()
            | self.marginal.figures()
            | self.conditional.figures()
            | self.people.figures(self.predictors.conditional)
        )


def _nothing(data: Sequence[Path], refused: RefusedRecords) -> str:
    places, why = ", ".join(map(str, data)), ""
    if refused.count:
        why = f" (the first of {refused.count} refused: {refused.reasons[0]})"
    return f"There is no usable scene in {places}{why}; give recorded files, or folders of them."


def run(
    data: Sequence[Path],
    *,
    name: str,
    file: Path | None,
    card: bool,
    threads: int | None,
    report: Callable[[str], None],
    candidates: int = max(MODES),
) -> Evaluation:
    """Evaluate, write the table to ``file`` and, with ``card``, figures to the weights' cards.

    Raises OutputError if they cannot be written.
    """
    if threads is not None:
        torch.set_num_threads(threads)
    found = evaluate(data, name, report, candidates)
    if file is not None:
        try:
            checkpoints.write(file, (json.dumps(found.record(), indent=1) + "\n").encode())
        except OSError as error:
            raise OutputError(f"{file} cannot be written: {error.strerror}.") from None
    if card:
        folder = weights.find(name)
        try:
            cards.add_results(folder, summary(found))
        except OSError as error:
            raise OutputError(
                f"The cards in {folder} cannot be written: {error.strerror}; leave --card out."
            ) from None
    return found


def _usable(data: Sequence[Path], refused: RefusedRecords) -> Iterator[Scene]:
    for each in readers.scenes(data):
        if isinstance(each, Refusal):
            refused.add(each.file, each.record, each.reason)
        elif not each.tracks.valid[each.tracks.row(each.av_id), each.now]:
            reason = f"the AV is missing at the current step {each.now}"
            refused.add(each.source.file, each.source.record, reason)
        else:
            yield each


_ON_CARDS: Final[dict[Network, dict[str, tuple[str, str]]]] = {
    "marginal": {
        **{f"min_fde{of}": (f"min_fde{of}", NETWORK) for of in ("", "_of_horizon")},
        **{name: (name, NETWORK) for name in ("min_ade", "miss_rate", "log_likelihood")},
        **{name: (name, NETWORK) for name in ("ece", *OF_MODES)},
    },
    "conditional": {
        **{f"min_fde_{given}": ("min_fde", given) for given in (MARGINAL, TRUE, SHUFFLED)},
        "log_likelihood_gain_true": ("log_likelihood_gain", TRUE),
        "log_likelihood_gain_shuffled": ("log_likelihood_gain", SHUFFLED),
        **{name: (name, TRUE) for name in ("min_ade", "miss_rate", "negative_log_likelihood")},
        **{name: (name, TRUE) for name in ("ece", *OF_MODES)},
    },
}
"""Key on the card -> quantity and condition, for each horizon."""


def summary(found: Evaluation) -> dict[str, Any]:
    """The main figures of each network, for its card."""
    opponent = partial(found.of, "opponent")
    head = partial(opponent, condition=LABEL_HEAD)
    counts = ("scenes", "candidates", "positives", "parked", "scenes_with_partner")
    ranks = ("auroc", "average_precision", "top1_positive", "top3_positive")
    partners = ("partner_top1", "partner_top3")
    return {
        "data": found.data,
        "opponent": {
            **{name: opponent(name).value for name in counts},
            **{name: head(name).value for name in ranks},
            **{name: opponent(name, condition=PARTNER_HEAD).value for name in partners},
            "ece": head("ece", group=ATTACKABLE).value,
        },
        **{
            network: {"targets": found.of(network, "targets").value}
            | {str(seconds): _on_card(found, network, seconds) for seconds in HORIZONS}
            for network in _ON_CARDS
        },
    }


def _on_card(found: Evaluation, network: Network, seconds: float) -> dict[str, Any]:
    """Figures at a horizon, by number of modes where they depend on it."""
    first, *_ = _ON_CARDS[network].values()
    card: dict[str, Any] = {"objects": found.of(network, first[0], seconds, FEW, first[1]).objects}
    for name, (quantity, condition) in _ON_CARDS[network].items():
        by_modes = {
            modes: figures.get(seconds, Figure())
            for modes, figures in found.pivot(network, quantity, condition).items()
        }
        card[name] = {str(modes): figure.value for modes, figure in by_modes.items()} or None
        if None in by_modes:
            card[name] = by_modes[None].value
        if quantity == "log_likelihood_gain":
            card[f"{name}_standard_error"] = by_modes.get(None, Figure()).standard_error
        if quantity in OF_MODES and card[name]:
            card[name][RECORDED] = found.of(network, quantity, seconds, None, RECORDED).value
    return card
