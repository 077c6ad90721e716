"""``deepmf-sumo doctor``: whether all that a run needs is there and fits together."""

from functools import partial
from typing import Final

import click

_MARKS: Final = {"ok": ("ok", "green"), "warning": ("warn", "yellow"), "broken": ("BAD", "red")}


@click.command(name="doctor")
@click.option(
    "--weights", metavar="NAME", multiple=True, default=("open",), show_default=True,
    help="Look at these weights.",
)  # fmt: skip
@click.pass_context
def command(ctx: click.Context, weights: tuple[str, ...]) -> None:
    """Look at Python, SUMO, libraries, machine, weights and cache: a line each.

    \b
    Exit codes: 0 runs will work (a warning is about what not everybody needs); 1 they will not.
    """
    from concurrent.futures import ThreadPoolExecutor

    import deepmf_sumo
    from deepmf_sumo.cli.health import machine, packages
    from deepmf_sumo.cli.health.finding import Check, look

    click.echo(f"deepmf-sumo {deepmf_sumo.__version__}")
    checks: dict[str, Check] = {
        "Python": packages.python,
        "SUMO packages": packages.sumo_versions,
        "libsumo": packages.libsumo,
        "netconvert": packages.netconvert,
        "sumo-gui": packages.sumo_gui,
        "SUMO_HOME": packages.sumo_home,
        "torch": packages.torch,
        "libraries": packages.libraries,
        "cores": machine.cores,
        "memory": machine.memory,
        **{f"weights {name}": partial(machine.weights, name) for name in weights},
        "cache": machine.cache,
    }
    states = []
    with ThreadPoolExecutor(max_workers=4) as pool:  # most of them wait for a process
        for found in pool.map(look, checks, checks.values()):
            states.append(found.state)
            mark, colour = _MARKS[found.state]
            text = " ".join(found.text.split())
            click.echo(f"{click.style(f'{mark:4}', fg=colour)} {found.name:14} {text}")
    ctx.exit(int("broken" in states))
