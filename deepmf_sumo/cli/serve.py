"""``deepmf-sumo serve``: a port that looks like SUMO's, with attacks behind it."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from deepmf_sumo.cli import attach
from deepmf_sumo.cli._parameters import AFTER, WithSumoOptions
from deepmf_sumo.errors import SimulationError, exit_code

if TYPE_CHECKING:
    from deepmf_sumo.cli._leaving import Leaving
    from deepmf_sumo.live import SumoServer
    from deepmf_sumo.live.attacker import Attached, Prepared
    from deepmf_sumo.live.lockstep import Stay

_OTHERS: Final = {"place"}
"""Options of `attach` on where SUMO is."""
_SUMO_ENDS_S: Final = 5.0
"""For SUMO to end after it closed its connections."""


@click.command(
    name="serve",
    cls=WithSumoOptions,
    short_help="Run SUMO behind a port that attacks the client's vehicle.",
    params=[one for one in attach.command.params if one.name not in _OTHERS],
)
@click.argument(
    "config", metavar="[CONFIG]", required=False,
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
)  # fmt: skip
@click.option(
    "--port", "--remote-port", "-p", type=click.IntRange(0, 65535), default=8813,
    show_default=True, help="Listen on this port of this machine; 0 takes a free one.",
)  # fmt: skip
@click.option("--gui", is_flag=True, help="Start sumo-gui.")
@click.pass_context
def command(
    ctx: click.Context,
    /,
    config: Path | None,
    port: int,
    gui: bool,
    out: Path,
    overwrite: bool,
    sets: tuple[str, ...],
    until_s: float | None,
    **given: Any,
) -> None:
    """Start SUMO with CONFIG, a .sumocfg, behind a port that any TraCI client takes for SUMO's.

    The client connects, steps and drives its vehicle as with SUMO alone; it needs neither setOrder
    nor another number of clients. Attacks happen in its steps. After load, SUMO starts anew, and
    attacks go on there. Ends when the client has left; the results are as attach writes them. A
    script may also start it, with traci.start, in place of SUMO, and without CONFIG if SUMO's
    options name the network. SUMO steps by at most 0.1 s: it makes several steps in a longer one of
    the client.
    """
    from deepmf_sumo import live
    from deepmf_sumo.cli._keys import LIVE, LiveKeys, taken
    from deepmf_sumo.cli._leaving import leaving
    from deepmf_sumo.live.lockstep import Stay
    from deepmf_sumo.live.record import SUMO_FILES

    keys, rest = taken(sets, LiveKeys, LIVE)
    port, options = _port_and_options(port, ctx.meta[AFTER], ctx)
    if config is None and not options:
        raise click.UsageError("Missing CONFIG, or SUMO's options with a network behind --.")
    if config is not None:
        _check(config, options)
    wish = live.AttackRequest(sets=tuple(rest), pause_s=keys.pause_s, **given)
    with (
        closing(live.prepare(wish, out, overwrite=overwrite)) as prepared,
        leaving() as stopped,
        attach.watched(keys.http, wish.avs) as (watch, tell),
        prepared.record.written_by_sumo() as written,
        live.SumoServer(config, port, written, options, gui=gui) as server,
    ):
        prepared.record.client_step_s = server.client_step_s
        whole = Stay(until_s=until_s, attacks=keys.attacks, patience_s=float("inf"))
        sessions = partial(_simulations, server, prepared, whole, stopped, tell, watch)
        _served(server, prepared, stopped, sessions, partial(_show, wish.avs, out))
        code = exit_code("interrupted" if stopped() else "failed" if server.unused else "fine")
        for one in server.complaints:
            click.echo(f"deepmf-sumo: {one}", err=True)
        if not stopped():  # a signal to the whole group has ended SUMO, too
            server.check()
    if (out / SUMO_FILES).is_dir():
        click.echo(f"what SUMO itself wrote is in {out / SUMO_FILES}")
    ctx.exit(code if server.joined else exit_code("interrupted"))


def _check(config: Path, options: Sequence[str]) -> None:
    """Raise what is wrong with a configuration before a client comes, unless options replace it."""
    from deepmf_sumo.sumo.simulation.sumo_config import read_configuration

    named = {one.partition("=")[0] for one in options}
    if not {"-n", "--net-file"} & named:
        read_configuration(config, simulated="--mesosim" not in named)


def _tell_steps(server: "SumoServer") -> None:
    """Say where SUMO's steps are not those that were asked for."""
    if server.client_step_s is not None:
        click.echo(
            f"SUMO steps by 0.1 s in place of {server.client_step_s:g} s; a step of the client is"
            f" {server.client_step_s:g} s. Compare with SUMO at --step-length 0.1.",
            err=True,
        )


def _served(
    server: "SumoServer",
    prepared: "Prepared",
    stopped: "Leaving",
    sessions: "Callable[[], Iterator[Attached]]",
    show: "Callable[[Attached], None]",
) -> None:
    """Wait for the client and attack in all simulations that it loads; show how the last went."""
    from deepmf_sumo.cli._screen import tell_jump, tell_switch

    click.echo(f"listening on port {server.port}: traci.connect({server.port})", err=True)
    _tell_steps(server)
    prepared.record.switched = tell_switch
    prepared.record.jumped = tell_jump
    server.await_client(stopped)
    if not stopped():
        server.check()
    done = None
    try:
        for done in sessions():  # noqa: B007 - the last is shown
            pass
    finally:
        if done is not None:
            show(done)


def _show(avs: Sequence[str], out: Path, done: "Attached") -> None:
    from deepmf_sumo.cli._screen import show_session

    show_session(done, avs, out)


def _simulations(
    server: "SumoServer",
    prepared: "Prepared",
    stay: "Stay",
    stopped: "Leaving",
    tell: attach.Tell,
    watch: attach.Watch,
) -> "Iterator[Attached]":
    """What happened so far, after each simulation that the client has loaded."""
    from deepmf_sumo import live
    from deepmf_sumo.live.connection import Port

    more, undriven = server.joined, 0
    while more:
        try:
            done = live.attach(
                Port(number=server.inner), prepared, stay.after(len(prepared.record.rows)),
                stopped=stopped, tell=tell, watch=watch, client=server,
            )  # fmt: skip
        except SimulationError:
            if stopped():
                return
            server.check(_SUMO_ENDS_S)  # what SUMO ended with says more
            raise
        undriven += done.undriven
        yield replace(done, undriven=undriven)
        end = done.end
        # after Ctrl-C the script may go on without attacks
        server.stay(lambda: stopped() and (end != "stopped" or stopped.terminated))  # noqa: B023
        more = not stopped() and server.load()
        if more:
            click.echo("the client has loaded another simulation", err=True)
            prepared.record.client_step_s = server.client_step_s
            _tell_steps(server)


def _port_and_options(port: int, after: Sequence[str], ctx: click.Context) -> tuple[int, list[str]]:
    """SUMO's options without the port that ``traci.start`` writes behind all others."""
    options = list(after)
    if "--remote-port" in options[:-1]:
        at = options.index("--remote-port")
        port = click.IntRange(0, 65535)(options[at + 1], ctx=ctx)
        del options[at : at + 2]
    return port, options
