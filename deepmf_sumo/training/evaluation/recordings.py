"""Recordings and weights -> figures: on the screen, in a file, on the cards."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import torch

from deepmf_sumo import readers
from deepmf_sumo.datatypes import ROLLOUT, Scene, View
from deepmf_sumo.errors import OutputError, ReaderError
from deepmf_sumo.predictors import weights
from deepmf_sumo.predictors.marginal import Marginal
from deepmf_sumo.readers.base import Refusal
from deepmf_sumo.training import cards
from deepmf_sumo.training.evaluation.conditional import ConditionalFigures, Pair
from deepmf_sumo.training.evaluation.forecasts import targets
from deepmf_sumo.training.evaluation.marginal import MarginalFigures
from deepmf_sumo.training.evaluation.measures import HORIZONS
from deepmf_sumo.training.evaluation.opponent import OpponentFigures
from deepmf_sumo.training.fit import checkpoints
from deepmf_sumo.training.networks import clusters
from deepmf_sumo.training.samples import windows

MODES: Final = (6, 16, 32)
_NAMED: Final = 20
"""Refused records that are named; the others are counted."""


@dataclass(slots=True)
class Refused:
    """Records that could not be used."""

    count: int = 0
    reasons: list[str] = field(default_factory=list)

    def add(self, file: str, record: int, reason: str) -> None:
        """One more; the first twenty are named."""
        self.count += 1
        if len(self.reasons) < _NAMED:
            known = file in reason  # readers mostly name the place themselves
            self.reasons.append(reason if known else f"{file}, record {record}: {reason}")


def evaluate(
    data: Sequence[Path],
    name: str | Path,
    report: Callable[[str], None],
    candidates: int = max(MODES),
) -> dict[str, Any]:
    """All figures as nested dictionaries: opponent, marginal, conditional.

    Targets are the labelled vehicles of each scene; where a scene has no labels, the AV and all
    vehicles that move within 50 m of it. Of a simulated attack the AV alone, and no opponent
    scores, since the attack has made its own labels. ``candidates`` is a number of modes (N1) to
    measure besides 6, 16, 32. Raises ReaderError where there is no usable scene.
    """
    predictors = weights.load(name)
    modes = tuple(sorted({*MODES, candidates}))
    fitted = clusters.read(predictors.folder) if predictors.folder else None
    opponent = OpponentFigures()
    marginal = MarginalFigures(modes, fitted)
    conditional = ConditionalFigures(modes)
    refused, scenes, labelled = Refused(), 0, 0
    for scene in _usable(data, refused):
        view = windows.view_at(scene, scene.now)
        if scene.source.dataset != ROLLOUT:
            opponent.add(predictors.opponent, scene, view)
        conditional.add(predictors.conditional, _pairs(scene, view, predictors.marginal, marginal))
        scenes, labelled = scenes + 1, labelled + len(scene.interest)
        if scenes % 20 == 0:
            report(f"{scenes} scenes")
    if not scenes:
        raise ReaderError(_nothing(data, refused))
    conditional.finish(predictors.conditional)
    return {
        "data": [path.name for path in data],
        "weights": str(name),
        "scenes": scenes,
        "attacked_scenes": scenes - opponent.scenes,
        "refused": refused.count,
        "refusals": refused.reasons,
        "labelled_objects": labelled,
        "modes": list(modes),
        "opponent": opponent.summary(),
        "marginal": marginal.summary(),
        "conditional": conditional.summary(),
    }


def _pairs(scene: Scene, view: View, network: Marginal, figures: MarginalFigures) -> list[Pair]:
    """Measure the marginal network on a scene; returns the targets that have a partner."""
    pairs = []
    for target in targets(scene, view):
        found = figures.add(network, target)
        if target.partner is not None:
            pairs.append(Pair(target=target, partner=target.partner, marginals=found))
    return pairs


def _nothing(data: Sequence[Path], refused: Refused) -> str:
    places, why = ", ".join(map(str, data)), ""
    if refused.count:
        why = f" (the first of {refused.count} refused: {refused.reasons[0]})"
    return f"There is no usable scene in {places}{why}; give recorded files or folders of such."


def run(
    data: Sequence[Path],
    *,
    name: str,
    file: Path | None,
    card: bool,
    threads: int | None,
    report: Callable[[str], None],
    candidates: int = max(MODES),
) -> dict[str, Any]:
    """Evaluate, write the figures to ``file`` and, with ``card``, into the cards of the weights.

    Raises OutputError where they cannot be written.
    """
    if threads is not None:
        torch.set_num_threads(threads)
    found = evaluate(data, name, report, candidates)
    if file is not None:
        _write(file, found)
    if card:
        folder = weights.find(name)
        try:
            cards.add_results(folder, compact(found))
        except OSError as error:
            raise OutputError(
                f"The cards in {folder} cannot be written: {error.strerror}; leave --card out."
            ) from None
    return found


def _write(file: Path, found: dict[str, Any]) -> None:
    try:
        checkpoints.write(file, (json.dumps(found, indent=1) + "\n").encode())
    except OSError as error:
        raise OutputError(f"{file} cannot be written: {error.strerror}.") from None


def _usable(data: Sequence[Path], refused: Refused) -> Iterator[Scene]:
    for each in readers.scenes(data):
        if isinstance(each, Refusal):
            refused.add(each.file, each.record, each.reason)
        elif not each.tracks.valid[each.tracks.row(each.av_id), each.now]:
            reason = f"the AV is not there at the current step {each.now}"
            refused.add(each.source.file, each.source.record, reason)
        else:
            yield each


_OPPONENT: Final = (
    "scenes", "candidates", "positives", "parked", "auroc", "average_precision",
    "top1_positive", "top3_positive", "partner_top1", "partner_top3", "scenes_with_partner", "ece",
)  # fmt: skip
_MARGINAL: Final = (
    "objects", "min_fde", "min_fde_of_horizon", "min_ade", "miss_rate", "log_likelihood", "ece",
    "overlap_free", "on_road",
)  # fmt: skip
_CONDITIONAL: Final = (
    "objects", "min_fde_marginal", "min_fde_given_true", "min_fde_given_shuffled",
    "log_likelihood_gain_true", "log_likelihood_gain_true_standard_error",
    "log_likelihood_gain_shuffled", "log_likelihood_gain_shuffled_standard_error",
    "min_ade", "miss_rate", "negative_log_likelihood", "ece", "overlap_free", "on_road",
)  # fmt: skip


def compact(found: dict[str, Any]) -> dict[str, Any]:
    """The main figures of each network, of the nested ones that `evaluate` gives."""
    marginal, conditional = found["marginal"], found["conditional"]
    return {
        "data": found["data"],
        "opponent": {key: found["opponent"][key] for key in _OPPONENT},
        "marginal": {"targets": marginal["targets"]}
        | {key: {name: marginal[key][name] for name in _MARGINAL} for key in HORIZONS},
        "conditional": {"targets": conditional["targets"]}
        | {key: {name: conditional[key][name] for name in _CONDITIONAL} for key in HORIZONS},
    }
