"""``deepmf-sumo attack``: .sumocfgs -> result folder, without a spec."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from deepmf_sumo.cli._parameters import FiniteRange
from deepmf_sumo.cli._sweep import Sweep, end_of_runs, map_risk, options
from deepmf_sumo.errors import UsageError

if TYPE_CHECKING:
    from deepmf_sumo import moments

_AFTER: Final = "after --"


class _WithSumoOptions(click.Command):
    """A command line of which all after ``--`` is SUMO's: click itself drops the mark."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse what stands before the mark, and keep the rest."""
        end = args.index("--") if "--" in args else len(args)
        ctx.meta[_AFTER] = tuple(args[end + 1 :])
        return super().parse_args(ctx, args[:end])

    def collect_usage_pieces(self, ctx: click.Context) -> list[str]:
        """As in the line that shows how the command is used."""
        return [*super().collect_usage_pieces(ctx), "[-- SUMO OPTIONS]"]


@click.command(name="attack", cls=_WithSumoOptions)
@click.argument(
    "configs", metavar="CONFIG...", nargs=-1, required=True,
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
)  # fmt: skip
@click.option(
    "--moments", "-n", "count", type=click.IntRange(1, 100_000),
    help="How many attacks of each CONFIG.  [default: 10, or one for each --at]",
)  # fmt: skip
@click.option("--av", metavar="ID", help="Attack this vehicle.")
@click.option("--av-type", metavar="TYPE", help="Attack vehicles of this type.")
@click.option(
    "--at", "at_s", metavar="S", multiple=True, type=FiniteRange(min=0),
    help="Attack at this time of the simulation; may be repeated.",
)  # fmt: skip
@click.option(
    "--moments-of", "again", metavar="OUT", type=click.Path(path_type=Path),
    help="The same vehicles at the same times as in that result folder, to compare with it.",
)  # fmt: skip
@click.option(
    "--prefer", type=click.Choice(["spread", "encounters"]), default="spread", show_default=True,
    help="At each place moments at any time, or first those before another vehicle crosses the AV's"
    " way at a junction.",
)  # fmt: skip
@click.option(
    "--until", "until_s", metavar="S", type=FiniteRange(min=1),
    help="Look for moments so far.  [default: the end, or a million steps of vehicles]",
)  # fmt: skip
@click.option(
    "--duration", "duration_s", metavar="S", type=float, help="Of an attack.  [default: 8]"
)
@click.option(
    "--opponents", type=click.Choice(["one", "in_turn"]),
    help="One, or one after another until the time is over.  [default: one up to 15 s]",
)  # fmt: skip
@click.option("--planner", metavar="NAME", help="Drives the AV.  [default: idm]")
@click.option("--set", "sets", metavar="KEY=VALUE", multiple=True, help="A key of a spec.")
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    help="Of all choices and of SUMO.  [default: the configuration's]",
)
@click.option(
    "--risk/--no-risk", "mapped", default=True, show_default=True,
    help="Write the risk map at the end, as `deepmf-sumo risk` does.",
)  # fmt: skip
@options(out="results", pictures=True)
@click.pass_context
def command(
    ctx: click.Context,
    /,
    configs: tuple[Path, ...],
    until_s: float | None,
    sets: tuple[str, ...],
    again: Path | None,
    mapped: bool,
    sweep: Sweep,
    **wanted: Any,
) -> None:
    """Attack vehicles of CONFIG, a .sumocfg, at moments spread over its roads and its time.

    One simulation without an attack shows who is where when; each moment chosen is then a run of
    its own: SUMO's traffic up to the moment, the planner and the attack from there on. Writes a
    result folder as `run` does, moments.csv and a risk map. Where nobody can be attacked it says
    why, and ends with 0. Of several CONFIGs each is attacked alike, all in one result folder.
    """
    from deepmf_sumo import moments
    from deepmf_sumo.cli._screen import progress

    batch = sweep.begin()
    if again is not None:
        _refuse_others(configs, **wanted)
        wanted["again"] = moments.read(again)
    common = {key: wanted.pop(key) for key in _KEYS}
    asked = moments.prepare(
        configs, _keys(**common), sets, sumo_options=ctx.meta[_AFTER], until_s=until_s, **wanted
    )
    chosen = [(one.spec, _found(one, sweep.timeout)) for one in asked]
    with progress() as report:
        results = moments.attack(chosen, batch, report)
    code = end_of_runs(sweep, results)
    if mapped and any(one["status"] == "ok" and one["opponent"] for one in results):
        map_risk(sweep.out)
    ctx.exit(code)


def _found(asked: "moments.Request", timeout_s: float) -> Any:
    """The moments of a configuration; says how they were found."""
    from deepmf_sumo.cli._screen import announce_moments
    from deepmf_sumo.moments import find

    found = find(asked.scouting, asked.wish, timeout_s)
    announce_moments(asked.configuration, found, asked.wish)
    return found.moments


_KEYS = ("duration_s", "opponents", "planner", "seed")
"""Options that are keys of the spec."""


def _refuse_others(configs: tuple[Path, ...], **wanted: Any) -> None:
    """Raise UsageError where more is wanted than the moments of another attack."""
    if len(configs) > 1:
        raise UsageError(
            f"--moments-of goes with one configuration, and {len(configs)} are given: vehicles are"
            " those of one traffic."
        )
    names = {"count": "--moments", "av": "--av", "av_type": "--av-type", "at_s": "--at"}
    for key, option in names.items():
        if wanted[key]:
            raise UsageError(f"{option} cannot be given with --moments-of: leave one of them out.")
    if wanted["prefer"] != "spread":
        raise UsageError(
            "--prefer encounters cannot be given with --moments-of: leave one of them out."
        )


def _keys(planner: str | None, **given: Any) -> dict[str, Any]:
    """Keys of the spec that are given."""
    keys = {key: value for key, value in given.items() if value is not None}
    return keys if planner is None else {**keys, "planner": {"name": planner}}
