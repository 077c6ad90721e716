"""``deepmf-sumo attach``: join a running SUMO and attack a vehicle in it."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from deepmf_sumo.cli._parameters import FiniteRange, Place
from deepmf_sumo.errors import exit_code

if TYPE_CHECKING:
    from deepmf_sumo.live.session import Session

Watch = Callable[[Sequence["Session"]], None]
Tell = Callable[[dict[str, Any]], None]


@click.command(name="attach", short_help="Attack a vehicle in a SUMO that already runs.")
@click.option(
    "--port", "-p", "place", metavar="[HOST:]PORT", required=True, type=Place(),
    help="Connect to this port, SUMO's --remote-port.",
)  # fmt: skip
@click.option(
    "--av", "avs", metavar="ID", required=True, multiple=True,
    help="Attack this vehicle; may be repeated.",
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
    "--until", "until_s", metavar="S", type=FiniteRange(min=0),
    help="Leave at this time of the simulation.",
)  # fmt: skip
@click.option(
    "--set", "sets", metavar="KEY=VALUE", multiple=True,
    help="Set profile, adversary.KEY, weights, seed or live.KEY, e.g. live.pause_s=0; may be"
    " repeated.",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("live"), show_default=True,
    help="Write the results into this folder.",
)  # fmt: skip
@click.option("--overwrite", is_flag=True, help="Delete the results that the folder has.")
@click.pass_context
def command(
    ctx: click.Context,
    /,
    place: tuple[str, int],
    out: Path,
    overwrite: bool,
    sets: tuple[str, ...],
    until_s: float | None,
    **given: Any,
) -> None:
    """Join a running sumo or sumo-gui, and attack a vehicle that another client drives.

    Start SUMO with --remote-port P --num-clients 2; the other client calls setOrder(1). Both step
    together. Ends when the vehicle leaves, at --until, after live.attacks, or at Ctrl-C, and hands
    its opponent back to SUMO; a second Ctrl-C stops immediately, which ends SUMO. Several vehicles
    are attacked at the same time, independently of each other.
    """
    from deepmf_sumo import live
    from deepmf_sumo.cli._keys import LIVE, AttachKeys, taken
    from deepmf_sumo.cli._leaving import leaving
    from deepmf_sumo.cli._screen import show_session, tell_jump, tell_switch
    from deepmf_sumo.live.connection import Port
    from deepmf_sumo.live.lockstep import Stay

    keys, rest = taken(sets, AttachKeys, LIVE)
    host, number = place
    port = Port(number=number, host=host, order=keys.order, wait_s=keys.wait_s)
    stay = Stay(until_s=until_s, attacks=keys.attacks, patience_s=keys.patience_s)
    wish = live.AttackRequest(sets=tuple(rest), pause_s=keys.pause_s, net=keys.net, **given)
    with (
        leaving() as stopped,
        watched(keys.http, wish.avs) as (watch, tell),
        closing(live.prepare(wish, out, overwrite=overwrite)) as prepared,
    ):
        prepared.record.switched = tell_switch
        prepared.record.jumped = tell_jump
        done = live.attach(port, prepared, stay, stopped=stopped, tell=tell, watch=watch)
    show_session(done, wish.avs, out)
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
