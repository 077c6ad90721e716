"""``deepmf-sumo try``: changes to a network -> what they buy, by attacks with and without them."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from deepmf_sumo.cli import attack
from deepmf_sumo.cli._parameters import AFTER, WithSumoOptions
from deepmf_sumo.cli._sweep import sweep_keys
from deepmf_sumo.errors import EXIT_CODES, UsageError, worst

if TYPE_CHECKING:
    from deepmf_sumo.roadcheck.countermeasures.building import Built

_OTHERS: Final = {"configs", "of", "file", "shard", "formats", "tries"} | {
    "av", "at_s", "from_s", "until_s",
}  # fmt: skip
"""Options of `attack` that say nothing about two networks, or that few need here: see ``--set``."""
_MOMENTS: Final = "source.moments."
_PLACES: Final = tuple(f"{_MOMENTS}{key}" for key in ("junctions", "edges", "polygon"))
SIDES: Final = ("before", "after")


@click.command(
    name="try",
    cls=WithSumoOptions,
    short_help="Change a network, and attack it before and after.",
    params=[one for one in attack.command.params if one.name not in _OTHERS],
)
@click.argument(
    "config", metavar="CONFIG", type=click.Path(exists=True, dir_okay=False, path_type=Path)
)
@click.option(
    "--change", "file", metavar="FILE", required=True,
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Make the changes of this YAML file.",
)  # fmt: skip
@click.option(
    "--everywhere", is_flag=True,
    help="Attack anywhere. Without it, --junction and --edge, attacks are at what is"
    " changed.",
)  # fmt: skip
@click.pass_context
def command(
    ctx: click.Context,
    /,
    config: Path,
    file: Path,
    everywhere: bool,
    count: int | None,
    sets: tuple[str, ...],
    **wanted: Any,
) -> None:
    """Change the network of CONFIG, a .sumocfg, and compare attacks with and without the changes.

    Half of the --moments are chosen in the traffic before the changes and half after them,
    and all are attacked on both sides: the same vehicle at the same time. This avoids favouring
    either design. Writes OUT/before and OUT/after with results, the changed network, and
    OUT/patch, which netconvert and netedit take. --set sets what attack sets.
    """
    from deepmf_sumo.roadcheck.countermeasures import building, document

    out: Path = wanted.pop("out")
    sweep_keys(sets, "figures", "risk", "thresholds", "baseline")
    if count == 1:
        raise UsageError("--moments 1: it takes two, one for each side.")
    changes = document.load(file)
    _check(out, wanted)
    built = building.build(config, changes, out, ctx.meta[AFTER])
    for line in built.done:
        click.echo(line)
    placed = wanted["junctions"] or wanted["edges"] or any(one.startswith(_PLACES) for one in sets)
    if not (everywhere or placed):
        wanted |= {"junctions": built.junctions, "edges": built.edges}
    timed = any(
        one.startswith(f"{_MOMENTS}at_s") for one in sets
    )  # without --moments: once for each
    number = count or (0 if timed else 10)
    asked = _Asked(ctx.meta[AFTER], built, out, number, sets, wanted)
    code = 0
    for side, of in _order():
        code = worst(code, asked.attack(side, of))
        if code == EXIT_CODES["interrupted"]:  # --resume goes on; nothing is compared by halves
            ctx.exit(code)
    _compare(out)
    ctx.exit(code)


def _order() -> Iterator[tuple[str, str]]:
    """Which side is attacked at moments of which: first at its own."""
    for of in SIDES:
        yield of, of
    for of in SIDES:
        yield next(side for side in SIDES if side != of), of


def _check(out: Path, wanted: dict[str, Any]) -> None:
    """Raises UsageError for results that are there, unless they are wanted."""
    there = any((out / side / f"at-{of}").exists() for side in SIDES for of in SIDES)
    if there and not (wanted["resume"] or wanted["overwrite"]):
        raise UsageError(
            f"{out} has results of an earlier try: name another folder with --out, or give --resume"
            " to go on or --overwrite to delete them."
        )


@dataclass(frozen=True, slots=True)
class _Asked:
    """The attacks on both sides; ``values`` are those of the options of `attack`."""

    sumo_options: tuple[str, ...]
    built: "Built"
    out: Path
    count: int
    sets: tuple[str, ...]
    values: dict[str, Any]

    def attack(self, side: str, of: str) -> int:
        """Attack a side at moments chosen in a side; returns the exit code."""
        half = (self.count + 1) // 2 if of == SIDES[0] else self.count // 2
        given: dict[str, Any] = dict.fromkeys(_OTHERS - {"configs", "file"}) | {"at_s": ()}
        given |= self.values | {
            "out": self.out / side / f"at-{of}",
            "formats": (),
            "count": half or None,
        }
        sets = [*self.sets, "sweep.risk=false"]
        if side != of:
            given |= {"count": None, "of": self.out / of / f"at-{of}", "junctions": (), "edges": ()}
            sets = [one for one in sets if not one.startswith(_MOMENTS)]
        config = self.built.before if side == "before" else self.built.after
        click.echo(f"{side} the changes, at moments chosen {of} them")
        return attack.attack_configs(self.sumo_options, (config,), sets, **given)


def _compare(out: Path) -> None:
    from deepmf_sumo.cli import _risk_screen
    from deepmf_sumo.report.risk import two_sides as files
    from deepmf_sumo.results.risk import two_sides

    before, after = (out / side for side in SIDES)
    changed = {path.name for path in after.iterdir() if path.is_file()}
    compared = two_sides.compare(before, after, changed_on_purpose=changed)
    names = str(before), str(after)
    _risk_screen.show_comparison(compared, names)
    files.write(out / "compared", compared, names)
    click.echo(f"{out}/compared/{files.TEXT}")
