"""``deepmf-sumo evaluate``: how good a set of weights is on recordings it was not trained on."""

import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch

from deepmf_sumo import readers
from deepmf_sumo.datatypes import DT_S, FUTURE_STEPS, AgentId, Floats, Futures, Scene, View
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.geometry import angles, frames
from deepmf_sumo.predictors import weights
from deepmf_sumo.predictors.weights import Predictors
from deepmf_sumo.readers.base import Refusal
from deepmf_sumo.training import cards, labels, windows
from deepmf_sumo.training.accuracy import (
    HORIZONS,
    DisplacementErrors,
    auroc,
    average_precision,
    mean,
)
from deepmf_sumo.training.windows import Future

MODES: Final = (6, 16, 32)
_KERNEL_M: Final = 2.0
"""Width of the fixed kernel of the end-point likelihoods, which makes networks comparable."""
_CONDITIONS: Final = ("none", "true", "shuffled")


@dataclass(slots=True)
class Measured:
    """What has been measured so far; `report` sums it up."""

    errors: dict[int, DisplacementErrors] = field(
        default_factory=lambda: {modes: DisplacementErrors() for modes in MODES}
    )
    constant: DisplacementErrors = field(default_factory=DisplacementErrors)
    likelihood: list[float] = field(default_factory=list)
    conditional: dict[str, DisplacementErrors] = field(
        default_factory=lambda: {key: DisplacementErrors() for key in _CONDITIONS}
    )
    gains: dict[str, dict[str, list[float]]] = field(
        default_factory=lambda: {
            target: {key: [] for key in _CONDITIONS} for target in ("av", "partner")
        }
    )
    scores: list[Floats] = field(default_factory=list)
    labels: list[Floats] = field(default_factory=list)
    best_is_positive: list[float] = field(default_factory=list)
    ranks: dict[str, list[int]] = field(default_factory=lambda: {"label": [], "partner": []})
    scenes: int = 0
    refused: int = 0


def evaluate(
    data: Sequence[Path], name: str | Path, report: Callable[[str], None]
) -> dict[str, Any]:
    """All figures as nested dictionaries: opponent, marginal, conditional.

    Targets are the labelled agents of each scene; where a set has no labels, the AV and all moving
    vehicles within 50 m. Raises ReaderError where there is no usable scene.
    """
    predictors = weights.load(name)
    measured = Measured()
    motion: Floats | None = None
    for scene in _usable(data, measured):
        view = windows.view_at(scene, scene.now)
        _opponent(predictors, scene, view, measured)
        pairs = list(_targets(scene, view))
        for future, partner in pairs:
            _marginal(predictors, view, future, measured)
            if partner is not None and motion is not None:
                _conditional(predictors, scene, view, future, partner, motion, measured)
            if partner is not None:
                motion = _motion(view, partner)
        measured.scenes += 1
        if measured.scenes % 20 == 0:
            report(f"{measured.scenes} scenes")
    if not measured.scenes:
        raise ReaderError(f"There is no usable scene in {', '.join(map(str, data))}.")
    return _summary(measured, data, str(name))


def run(
    data: Sequence[Path],
    *,
    name: str,
    file: Path | None,
    card: bool,
    threads: int | None,
    report: Callable[[str], None],
) -> dict[str, Any]:
    """Evaluate, write the figures to ``file`` and, with ``card``, into the cards of the weights."""
    if threads is not None:
        torch.set_num_threads(threads)
    found = evaluate(data, name, report)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        beside = file.with_name(f"{file.name}.{os.getpid()}")
        beside.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
        beside.replace(file)
    if card:
        cards.add_results(weights.find(name), found)
    return found


def _usable(data: Sequence[Path], measured: Measured) -> Iterator[Scene]:
    for each in readers.scenes(data):
        if (
            isinstance(each, Refusal)
            or not each.tracks.valid[each.tracks.row(each.av_id), each.now]
        ):
            measured.refused += 1
        else:
            yield each


def _targets(scene: Scene, view: View) -> Iterator[tuple[Future, Future | None]]:
    """Agents to predict, each with the partner whose future may be given."""
    origin = view.history.position_m[view.history.row(scene.av_id), -1]
    for future in windows.targets(scene, scene.now):
        away = view.history.position_m[view.history.row(future.agent_id), -1] - origin
        near = not scene.interest and float(np.hypot(*away)) < 50.0
        if future.agent_id in scene.interest or near:
            yield future, windows.partner_of(scene, future.agent_id, scene.now)


def _marginal(predictors: Predictors, view: View, future: Future, measured: Measured) -> None:
    row = view.history.row(future.agent_id)
    speed = float(view.history.speed_mps[row, -1])
    true = (future.position_m, future.heading_rad, future.valid, speed)
    found = predictors.marginal.predict_each(view, future.agent_id, MODES)
    for modes, forecast in zip(MODES, found, strict=True):
        measured.errors[modes].add(forecast.futures.position_m, *true)
    times = np.arange(1, FUTURE_STEPS + 1)[:, None] * DT_S
    straight = view.history.position_m[row, -1] + times * view.history.velocity_mps[row, -1]
    measured.constant.add(straight[None], *true)
    if future.valid[-1]:
        end = future.position_m[-1:]
        density = predictors.marginal.end_density(view, future.agent_id, end, _KERNEL_M)
        measured.likelihood.append(float(density[0]))


def _conditional(
    predictors: Predictors,
    scene: Scene,
    view: View,
    future: Future,
    partner: Future,
    motion: Floats,
    measured: Measured,
) -> None:
    """The target's future given nothing, the partner's true future, and another vehicle's."""
    net, target = predictors.conditional, future.agent_id
    row = view.history.row(target)
    speed = float(view.history.speed_mps[row, -1])
    true = (future.position_m, future.heading_rad, future.valid, speed)
    group = "av" if target == scene.av_id else "partner"
    for key, given in (
        ("none", None),
        ("true", _given(partner)),
        ("shuffled", _moved(view, partner.agent_id, motion)),
    ):
        forecast = net.react(view, target, given, 6)[0]
        measured.conditional[key].add(forecast.futures.position_m, *true)
        if future.valid[-1]:
            end = future.position_m[-1:]
            density = net.end_density(view, target, given, end, _KERNEL_M)
            measured.gains[group][key].append(float(density[0]))


def _given(future: Future) -> Futures:
    return Futures(
        agent_id=future.agent_id,
        position_m=future.position_m[None],
        heading_rad=future.heading_rad[None],
    )


def _motion(view: View, future: Future) -> Floats:
    """(80, 3) a future in the frame of its own agent."""
    return windows.local_future(view, future.agent_id, future)


def _moved(view: View, agent_id: AgentId, motion: Floats) -> Futures:
    """Another scene's motion, begun at the agent's pose."""
    row = view.history.row(agent_id)
    origin, heading = view.history.position_m[row, -1], float(view.history.heading_rad[row, -1])
    return Futures(
        agent_id=agent_id,
        position_m=frames.to_scene(motion[None, :, :2], origin, heading),
        heading_rad=angles.wrap(motion[None, :, 2] + heading),
    )


def _opponent(predictors: Predictors, scene: Scene, view: View, measured: Measured) -> None:
    found = predictors.opponent.score(view)
    if not found.ids:
        return
    positive = np.array([labels.interacts(scene, agent_id) for agent_id in found.ids])
    measured.scores.append(found.logits)
    measured.labels.append(positive)
    if positive.any():
        measured.best_is_positive.append(float(positive[found.logits.argmax()]))
    partner = scene.partner_id
    if partner is None:
        return
    for key, score in (("label", found.logits), ("partner", found.partner_logits)):
        order = [found.ids[row] for row in np.argsort(-score, kind="stable")]
        measured.ranks[key].append(order.index(partner) if partner in order else len(order))


def _summary(measured: Measured, data: Sequence[Path], name: str) -> dict[str, Any]:
    return {
        "data": [path.name for path in data],
        "weights": name,
        "scenes": measured.scenes,
        "refused": measured.refused,
        "opponent": _opponent_summary(measured),
        "marginal": _marginal_summary(measured),
        "conditional": _conditional_summary(measured),
    }


def _opponent_summary(measured: Measured) -> dict[str, Any]:
    if not measured.scores:
        return {"candidates": 0}
    scores = np.concatenate(measured.scores)
    positive = np.concatenate(measured.labels).astype(bool)
    area, precision = auroc(scores, positive), average_precision(scores, positive)
    summary: dict[str, Any] = {
        "candidates": len(scores),
        "positives": int(positive.sum()),
        "auroc": area if area is None else round(area, 4),
        "average_precision": precision if precision is None else round(precision, 4),
        "top1_positive": mean(measured.best_is_positive),
    }
    for key, prefix in (("partner", "partner"), ("label", "partner_by_label_head")):
        ranks = measured.ranks[key]
        summary[f"{prefix}_top1"] = mean([float(rank < 1) for rank in ranks])
        summary[f"{prefix}_top3"] = mean([float(rank < 3) for rank in ranks])
    summary["scenes_with_partner"] = len(measured.ranks["partner"])
    return summary


def _marginal_summary(measured: Measured) -> dict[str, Any]:
    summary: dict[str, Any] = {"targets": len(measured.errors[MODES[0]].ade["8.0"])}
    for key in HORIZONS:
        summary[key] = {
            "min_fde": {str(modes): mean(measured.errors[modes].fde[key]) for modes in MODES},
            "min_ade": {str(modes): mean(measured.errors[modes].ade[key]) for modes in MODES},
            "miss_rate": {str(modes): mean(measured.errors[modes].missed[key]) for modes in MODES},
            "constant_velocity_fde": mean(measured.constant.fde[key]),
            "constant_velocity_ade": mean(measured.constant.ade[key]),
        }
    summary["end_log_likelihood"] = mean(measured.likelihood)
    return summary


def _conditional_summary(measured: Measured) -> dict[str, Any]:
    summary: dict[str, Any] = {}
    for key in _CONDITIONS:
        errors = measured.conditional[key]
        summary[key] = {
            f"min_fde6_{horizon}": mean(errors.fde[horizon]) for horizon in HORIZONS
        } | {
            "end_log_likelihood": mean(
                [value for group in measured.gains.values() for value in group[key]]
            )
        }
    for group, values in measured.gains.items():
        none = np.array(values["none"])
        for key in ("true", "shuffled"):
            gain = np.array(values[key]) - none
            summary[f"gain_{key}_{group}"] = mean(gain.tolist())
            if len(gain) > 1:
                error = float(gain.std(ddof=1) / np.sqrt(len(gain)))
                summary[f"gain_{key}_{group}_standard_error"] = round(error, 3)
    summary["targets"] = sum(len(group["none"]) for group in measured.gains.values())
    return summary
