"""What `attack` and `run` say of the moments that they choose."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import click

from deepmf_sumo.texts import shown

if TYPE_CHECKING:
    from deepmf_sumo.results.result import Result
    from deepmf_sumo.study.moments import FoundMoments, MomentRequest
    from deepmf_sumo.sumo.simulation.sumo_config import Configuration


def announce_moments(request: MomentRequest, found: FoundMoments) -> None:
    """A line on what was found, on standard error; one on standard output if it was nothing."""
    from deepmf_sumo.report.table import counted
    from deepmf_sumo.scene import DT_S

    configuration, wish = request.configuration, request.wish
    name = configuration.file.name
    if abs(configuration.step_s - DT_S) > 1e-9:
        steps = f"asks for steps of {configuration.step_s:g} s; it is run with {DT_S:g} s"
        click.echo(shown(f"{name} {steps}"), err=True)
    if not found.moments:
        click.echo(shown(f"no vehicle to attack in {name}: {found.reason}"))
        for line in found.notes:
            click.echo(shown(line), err=True)
        return
    span = f"{found.begin_s:.12g} to {found.until_s:.12g} s"
    limit = "the limit of vehicle steps is reached; " * (request.survey.until_s is None)
    further = "" if found.complete or wish.at_s or wish.again else f" ({limit}{wish.later})"
    seen = counted(found.vehicles, "vehicle")
    click.echo(shown(f"{name}: {seen} from {span}{further}{_attacked_from(found)}"), err=True)
    chosen = counted(len(found.moments), "moment")
    if wish.pool:
        chosen = _drawn(wish.count, len(found.moments))
    if wish.prefer != "spread":
        before = sum(one.encounter_s is not None for one in found.moments)
        chosen += f", {before} of them before an encounter"
    chosen += f"; chosen from {found.suitable} vehicle seconds"
    if len(found.moments) < wish.count:
        chosen += f"; not {wish.count}, because {found.reason}"
    for line in (chosen, *found.notes, *_of_the_network(configuration)):
        click.echo(shown(line), err=True)


def _drawn(count: int, pool: int) -> str:
    """How many moments are spread, and how many are drawn by what those find."""
    from deepmf_sumo.report.table import counted
    from deepmf_sumo.study.moments.promising import spread

    first, attacked = spread(pool, count), min(count, pool)
    return (
        f"{counted(attacked, 'moment')} of {pool}: {first} spread, {attacked - first} drawn where"
        f" conflicts come near; of all {pool}"
    )


def no_conflict(
    results: Sequence[Result], looked: Sequence[tuple[MomentRequest, FoundMoments]]
) -> str:
    """That no attack came to a conflict, and what may find one; empty where one did."""
    from deepmf_sumo.report.table import counted
    from deepmf_sumo.results import statistics
    from deepmf_sumo.results.quantities import metric
    from deepmf_sumo.results.result import attacked
    from deepmf_sumo.results.risk.table import CONFLICT_S

    done = [one for one in results if one["status"] == "ok" and attacked(one)]
    least = [metric(one, "ttc_min") for one in done]
    near = any(one is not None and one <= CONFLICT_S for one in least)
    if not done or near or any(one["outcome"].startswith("av_") for one in done):
        return ""
    most = statistics.rate([[0.0]] * len(done)).high
    advice = [*_busiest(looked), f"more attacks (--moments {4 * len(done)})"]
    advice += ["more traffic (-- --scale 2)"]
    return (
        f"no conflict in {counted(len(done), 'attack')}: no contact of the AV, and no time to"
        f" collision of {CONFLICT_S:g} s or less. Up to {100 * most:.0f} % of other moments"
        f" may have one. What may find it: {', '.join(advice)}"
    )


def _busiest(looked: Sequence[tuple[MomentRequest, FoundMoments]]) -> Iterator[str]:
    """The edge where most vehicles can be attacked, of one network that is attacked as a whole."""
    from deepmf_sumo.report.table import counted

    if len(looked) != 1 or looked[0][0].wish.where:
        return
    flows = [flow for flow in looked[0][1].flows if flow.near and not flow.following]
    if flows:
        most = max(flows, key=lambda flow: (flow.near, flow.edge))
        vehicles = counted(most.near, "vehicle")
        yield f"the edge where most have others near them (--edge {most.edge}: {vehicles})"


def _of_the_network(configuration: Configuration) -> Iterator[str]:
    """What is wrong with a network so that attacks on it say little."""
    from deepmf_sumo.report.table import counted
    from deepmf_sumo.roadcheck.screening import overlaps
    from deepmf_sumo.sumo.network.sumo_net import read_once

    if count := len(list(overlaps(read_once(configuration.net)))):
        where = counted(count, "pair") + " of edges"
        yield (
            f"{configuration.net.name}: lanes of opposite directions lie on each other at {where}."
            " Contacts there may come from the network; `deepmf-sumo screen` lists them"
        )


def _attacked_from(found: FoundMoments) -> str:
    if found.from_s is None:
        return ""
    return f"; attacked from {found.from_s:.12g} s on" + (
        f", {found.from_why}" * bool(found.from_why)
    )
