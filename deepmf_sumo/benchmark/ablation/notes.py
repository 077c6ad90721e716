"""What stands above the table: without it, neither rates nor costs say anything."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from deepmf_sumo.benchmark.ablation.figures import Row
from deepmf_sumo.benchmark.ablation.plan import Plan
from deepmf_sumo.benchmark.ablation.study import Options
from deepmf_sumo.predictors.weights import NETWORKS


def notes(plan: Plan, options: Options, rows: Sequence[Row]) -> list[str]:
    """Paragraphs on data, steps, seeds, threads and denominators, then one on the variants."""
    return [_trained(rows), _measured(plan, rows[0]), _attacked(plan, options, rows), _varied(plan)]


def _trained(rows: Sequence[Row]) -> str:
    cards = rows[0].cards
    sources = ", ".join(
        f"{source['name']} ({source['scenes']} scenes, {source['refused']} refused)"
        for source in cards["marginal"]["data"]
    )
    steps = ", ".join(
        f"{network} {cards[network]['steps']} of {cards[network]['schedule']['batch']}"
        for network in NETWORKS
    )
    every = [card for row in rows for card in row.cards.values()]
    return (
        f"Trained on {sources}; steps and samples a step: {steps}; seed {_each(every, 'seed')};"
        f" device {_each([card['schedule'] for card in every], 'device')}, threads"
        f" {_each(every, 'threads')}. 'minutes' is the wall time of training the marginal and the"
        " conditional network, without features; the opponent network is the same in all rows and"
        f" took {rows[0].opponent_minutes:.1f}. One training a row: differences below the noise"
        " of seeds say nothing."
    )


def _measured(plan: Plan, base: Row) -> str:
    return (
        f"Measured at 8 s on {plan.test.name}: {base.scenes} scenes ({base.refused} refused),"
        f" {base.objects} objects; gains of {base.avs} AVs, given the other's true or a shuffled"
        " future, over the marginal network; ± standard error. 'weights' counts all three networks."
    )


def _attacked(plan: Plan, options: Options, rows: Sequence[Row]) -> str:
    cycles = sum(row.cycles for row in rows)
    planners = "; ".join(f"{name}: {_told(keys)}" for name, keys in plan.planners.items())
    return (
        f"Attacked as {plan.study.name} says, the seed of its runs too; {planners}. Hits: runs in"
        " which the opponent hit the AV first, of all that went through, and 95 % Wilson interval;"
        " rms: the opponent's acceleration along its way, mean over runs. 'cycle ms': median of all"
        f" replanning cycles ({cycles} in all), in workers of one thread each, {options.jobs} at a"
        " time in the last command; what else the machine did is in it."
    )


def _varied(plan: Plan) -> str:
    lines = [f"- base: preset {plan.preset_of(plan.all_variants[0]).name}, as the study attacks"]
    for variant in plan.variants:
        told = _told({**variant.sizes, **variant.attack})
        own = "" if plan.trained_for(variant) == variant else f" ({plan.trained_for(variant).name})"
        lines.append(f"- {variant.name}: {told}{own}")
    return "\n".join(lines)


def _told(changes: Mapping[str, Any]) -> str:
    told = ", ".join(f"{key} {json.dumps(value)}" for key, value in changes.items())
    return told or "nothing changed"


def _each(values: Sequence[Any], key: str) -> str:
    return ", ".join(sorted({str(value[key]) for value in values}))
