"""``deepmf-sumo attach``: join a running SUMO and attack a vehicle in it."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from deepmf_sumo.cli._parameters import FiniteRange
from deepmf_sumo.errors import exit_code

if TYPE_CHECKING:
    from deepmf_sumo.live.session import Session

Watch = Callable[[Sequence["Session"]], None]
Tell = Callable[[dict[str, Any]], None]


@click.command(name="attach", short_help="Attack a vehicle in a SUMO that already runs.")
@click.option(
    "--port", "-p", "number", required=True, type=click.IntRange(1, 65535),
    help="Connect to this port, SUMO's --remote-port.",
)  # fmt: skip
@click.option("--host", default="localhost", show_default=True, help="Connect to this machine.")
@click.option(
    "--av", "avs", metavar="ID", required=True, multiple=True,
    help="Attack this vehicle; may be repeated.",
)  # fmt: skip
@click.option(
    "--order", type=int, default=2, show_default=True, help="Register at SUMO under this number."
)
@click.option(
    "--wait", "wait_s", metavar="S", type=FiniteRange(min=0), default=10.0, show_default=True,
    help="Wait this time for SUMO to listen on the port.",
)  # fmt: skip
@click.option(
    "--trigger", "triggers", metavar="WHEN", multiple=True,
    help="Attack at time=S, edge=ID or ttc=S; may be repeated.  [default: whenever a vehicle can]",
)  # fmt: skip
@click.option(
    "--duration", "duration_s", metavar="S", type=FiniteRange(min=3), default=15.0,
    show_default=True, help="End an attack after this time.",
)  # fmt: skip
@click.option(
    "--pause", "pause_s", metavar="S", type=FiniteRange(min=0), default=5.0, show_default=True,
    help="Wait this time after an attack.",
)  # fmt: skip
@click.option("--attacks", metavar="N", type=click.IntRange(min=1), help="Stop after N attacks.")
@click.option(
    "--until", "until_s", metavar="S", type=FiniteRange(min=0),
    help="Leave at this time of the simulation.",
)  # fmt: skip
@click.option(
    "--patience", "patience_s", metavar="S", type=FiniteRange(min=0), default=600.0,
    show_default=True, help="Wait this time of the simulation for the AV to appear.",
)  # fmt: skip
@click.option(
    "--set", "sets", metavar="KEY=VALUE", multiple=True,
    help="Set profile, adversary.KEY, weights or seed; may be repeated.",
)  # fmt: skip
@click.option(
    "--net", type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Read the network from this file.  [default: the one that SUMO names]",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("live"), show_default=True,
    help="Write the results into this folder.",
)  # fmt: skip
@click.option("--overwrite", is_flag=True, help="Delete the results that the folder has.")
@click.option(
    "--http", type=click.IntRange(0, 65535), metavar="PORT",
    help="Show what happens on this port of this machine, with a switch for new attacks.",
)  # fmt: skip
@click.pass_context
def command(
    ctx: click.Context, /, out: Path, overwrite: bool, http: int | None, **given: Any
) -> None:
    """Join a running sumo or sumo-gui, and attack a vehicle that another client drives.

    Start SUMO with --remote-port P --num-clients 2; the other client calls setOrder(1). Both step
    together. Ends when the vehicle leaves, at --until, after --attacks, or at Ctrl-C, and hands its
    opponent back to SUMO; a second Ctrl-C stops immediately, which ends SUMO. Several vehicles are
    attacked at the same time, each for itself.
    """
    from deepmf_sumo import live
    from deepmf_sumo.cli._leaving import leaving
    from deepmf_sumo.cli._screen import show_session, tell_jump, tell_switch
    from deepmf_sumo.live.connection import Port
    from deepmf_sumo.live.lockstep import Stay

    port, wish, stay = (
        {field.name: given[field.name] for field in fields(kind)}
        for kind in (Port, live.Wish, Stay)
    )
    with (
        leaving() as stopped,
        watched(http, given["avs"]) as (watch, tell),
        closing(live.prepare(live.Wish(**wish), out, overwrite=overwrite)) as prepared,
    ):
        prepared.record.switched = tell_switch
        prepared.record.jumped = tell_jump
        done = live.attach(
            Port(**port), prepared, Stay(**stay), stopped=stopped, tell=tell, watch=watch
        )
    show_session(done, given["avs"], out)
    ctx.exit(exit_code("interrupted") if done.end == "stopped" else 0)


@contextmanager
def watched(http: int | None, avs: Sequence[str]) -> Iterator[tuple[Watch, Tell]]:
    """What is called with the sessions, and with each attack; ``http``: a port that shows both."""
    from deepmf_sumo import live
    from deepmf_sumo.cli._screen import tell_attack

    if http is None:
        yield lambda _: None, tell_attack
        return
    with live.StatusServer(http, avs) as status:
        click.echo(f"status on http://localhost:{status.port}/", err=True)

        def tell(row: dict[str, Any]) -> None:
            status.hits[row["av"]] += row["contact"] is not None
            tell_attack(row)

        yield status.watch, tell
