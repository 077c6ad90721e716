"""What `attack` says before it attacks: where it looked, and what it found."""

import click

from deepmf_sumo.benchmark.moments import Found, Wish
from deepmf_sumo.datatypes import DT_S
from deepmf_sumo.report.table import counted
from deepmf_sumo.simulation.sumo_config import Configuration
from deepmf_sumo.texts import shown


def announce(configuration: Configuration, found: Found, wish: Wish) -> None:
    """A line on what was found, on standard error; one on standard output if it was nothing."""
    name = configuration.file.name
    if abs(configuration.step_s - DT_S) > 1e-9:
        steps = f"asks for steps of {configuration.step_s:g} s; it is run with {DT_S:g} s"
        click.echo(shown(f"{name} {steps}"), err=True)
    if not found.moments:
        click.echo(shown(f"nobody to attack in {name}: {found.reason}"))
        return
    span = f"{found.begin_s:g} to {found.until_s:g} s"
    further = "" if found.complete or wish.at_s else " (--until S looks further)"
    seen = counted(found.vehicles, "vehicle")
    click.echo(shown(f"{name}: {seen} from {span}{further}"), err=True)
    moments = counted(len(found.moments), "moment")
    chosen = f"{moments} of {found.suitable} vehicle seconds"
    if wish.prefer == "encounters":
        before = sum(one.encounter_s is not None for one in found.moments)
        chosen += f", {before} of them before an encounter"
    if len(found.moments) < wish.count:
        chosen += f", not {wish.count}: {found.reason}"
    click.echo(shown(chosen), err=True)
