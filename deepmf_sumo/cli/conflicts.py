"""``deepmf-sumo conflicts``: the conflicts of a configuration's traffic, without attacks."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from deepmf_sumo.cli._parameters import AFTER, RESULTS, FiniteRange, WithSumoOptions, format_option
from deepmf_sumo.errors import OutputError

if TYPE_CHECKING:
    from deepmf_sumo.judge.metrics.traffic_conflicts import ConflictLimits
    from deepmf_sumo.roadcheck.conflict_places import PlaceConflicts
    from deepmf_sumo.roadcheck.conflicts import Observation
    from deepmf_sumo.roadcheck.motion_survey import Survey

LIST, PLACES, ABOUT = "conflicts.csv", "places.csv", "conflicts.json"
_TOP: Final = 10


@click.command(
    "conflicts", cls=WithSumoOptions, short_help="List the conflicts of a .sumocfg's own traffic."
)
@click.argument(
    "config", metavar="CONFIG", type=click.Path(exists=True, dir_okay=False, path_type=Path)
)
@click.option(
    "--out", metavar="FOLDER", type=click.Path(file_okay=False, path_type=Path),
    default=Path("conflicts"), show_default=True, help="Write the tables into this folder.",
)  # fmt: skip
@click.option(
    "--from", "from_s", metavar="S", type=FiniteRange(min=0),
    help="Look from this time on.  [default: the configuration's begin]",
)  # fmt: skip
@click.option(
    "--until", "until_s", metavar="S", type=FiniteRange(min=0),
    help="Look up to this time.  [default: the end, or ten million vehicle steps]",
)  # fmt: skip
@click.option(
    "--seed", type=click.IntRange(0, 2**32 - 1), help="Seed SUMO.  [default: the configuration's]"
)
@click.option(
    "--set", "sets", metavar="KEY=VALUE", multiple=True,
    help="Set ttc_s or pet_s, the limits of a conflict in s.  [default: ttc_s=1.5, pet_s=5]",
)  # fmt: skip
@click.option(
    "--beside", "results", metavar="OUT", type=RESULTS,
    help="Show the attacks of this result folder at the same places.",
)  # fmt: skip
@click.option("--trj", is_flag=True, help="Also write the traffic as trajectories for FHWA's SSAM.")
@click.option("--overwrite", is_flag=True, help="Replace the tables that the folder has.")
@format_option
@click.pass_context
def command(
    ctx: click.Context,
    /,
    config: Path,
    out: Path,
    results: Path | None,
    trj: bool,
    overwrite: bool,
    form: str,
    sets: tuple[str, ...],
    **given: Any,
) -> None:
    """List the conflicts of the traffic of CONFIG, a .sumocfg, as it is: nothing is attacked.

    A conflict is, as in FHWA's SSAM, a time to collision and a post-encroachment time within the
    limits. All pairs of vehicles, bicycles and persons are compared, every 0.1 s, by their boxes.
    Writes conflicts.csv, places.csv and conflicts.json, and shows the places with most conflicts;
    with --beside also what attacks found there. --format prints the conflicts instead. --trj also
    writes traffic.trj, which SSAM opens.
    """
    from deepmf_sumo import files
    from deepmf_sumo.cli import _screen as screen
    from deepmf_sumo.cli._keys import ConflictKeys, taken
    from deepmf_sumo.judge.metrics.traffic_conflicts import ConflictLimits
    from deepmf_sumo.results.risk import places
    from deepmf_sumo.roadcheck import conflict_places as conflicts
    from deepmf_sumo.roadcheck import conflicts as recording
    from deepmf_sumo.roadcheck.motion_survey import Survey
    from deepmf_sumo.sumo.network.sumo_road import road_once
    from deepmf_sumo.sumo.simulation.sumo_config import read_configuration

    keys, _ = taken(sets, ConflictKeys)
    named = (recording.TRAJECTORIES, recording.ROAD_USERS) if trj else ()
    _refuse(out, (LIST, PLACES, ABOUT, *named), overwrite)
    files.check_writable(out)
    options = ctx.meta[AFTER]
    configuration = read_configuration(config, options)
    seed = configuration.seed if given["seed"] is None else given["seed"]
    every = places.read(configuration.net)
    attacked = conflicts.beside(results, every) if results else None
    wanted = Survey(
        config=config, sumo_options=options, seed=seed, from_s=given["from_s"],
        until_s=given["until_s"],
    )  # fmt: skip
    limits = ConflictLimits(**dict(keys))
    if overwrite and not trj:
        for name in (recording.TRAJECTORIES, recording.ROAD_USERS):
            with files.writing(out):
                (out / name).unlink(missing_ok=True)  # of another traffic
    seen = recording.observe(wanted, limits, out if trj else None)
    rows = conflicts.listed(seen, every, road_once(configuration.net))
    sites = conflicts.by_place(seen, rows, every, attacked)
    _write(out, rows, sites, _about(wanted, limits, seen), beside=attacked is not None)
    if form == "table":
        _show(config.stem, seen, rows, sites, ", ".join((f"{out}/{LIST}", PLACES, ABOUT, *named)))
    else:
        screen.emit(form, rows, conflicts.LISTED)


def _refuse(out: Path, names: Sequence[str], overwrite: bool) -> None:
    there = [name for name in names if (out / name).exists()]
    if there and not overwrite:
        raise OutputError(
            f"{out / there[0]} is there already: give --overwrite to replace it, or another --out."
        )


def _about(wanted: "Survey", limits: "ConflictLimits", seen: "Observation") -> dict[str, Any]:
    """What ``conflicts.json`` says."""
    return {
        "config": wanted.config.name,
        "sumo_options": list(wanted.sumo_options),
        "seed": wanted.seed,
        "ttc_s": limits.ttc_s,
        "pet_s": limits.pet_s,
        "begin_s": seen.begin_s,
        "until_s": seen.until_s,
        "complete": seen.complete,
        "road_users": seen.users,
        "road_user_steps": seen.user_steps,
        "conflicts": len(seen.conflicts),
        "left_out": dict(seen.left_out),
        "sumo_warnings": list(seen.warnings),
    }


def _write(
    out: Path,
    rows: Sequence[dict[str, Any]],
    sites: "Sequence[PlaceConflicts]",
    about: dict[str, Any],
    *,
    beside: bool,
) -> None:
    from deepmf_sumo import files, tables
    from deepmf_sumo.roadcheck.conflict_places import LISTED, place_columns

    with files.writing(out):
        out.mkdir(parents=True, exist_ok=True)
        files.write(out / LIST, tables.to_csv(rows, LISTED))
        named = place_columns(beside=beside)
        files.write(out / PLACES, tables.to_csv([one.columns() for one in sites], named))
        files.write_json(out / ABOUT, about)


_HEADINGS: Final = ("place",)
_NUMBERS: Final = (
    "conflicts", "rear end", "lane change", "crossing", "per hour", "per 1000",
    "TTC", "PET",
)  # fmt: skip
_BESIDE: Final = ("attacks", "hits", "risk of a hit", "criticality")


def _show(
    name: str,
    seen: "Observation",
    rows: Sequence[dict[str, Any]],
    sites: "Sequence[PlaceConflicts]",
    written: str,
) -> None:
    """Counts, the places with most conflicts, and where the tables are."""
    from deepmf_sumo.cli import _screen as screen
    from deepmf_sumo.report.table import counted
    from deepmf_sumo.roadcheck.conflict_places import counts

    console = screen.wide()
    types = ", ".join(f"{count} {kind}" for kind, count in counts(rows).items())
    cut = "" if seen.complete else " (the traffic goes on)"
    time = f"from {seen.begin_s:.12g} to {seen.until_s:.12g} s{cut}"
    users = counted(seen.users, "road user")
    lines = [f"{name}: {users} {time}: {counted(len(rows), 'conflict')} ({types})"]
    contacts = sum(row["contact"] for row in rows)
    if contacts:
        lines.append(f"in {counted(contacts, 'conflict')} the boxes overlapped: SUMO lets them")
    lines += [
        f"not counted: {counted(count, 'encounter')} {why}" for why, count in seen.left_out.items()
    ]
    for line in (*lines, *seen.warnings):
        console.print(screen.escape(line), soft_wrap=True)
    if sites:
        beside = _BESIDE if sites[0].beside is not None else ()
        shown = [(_cells(one), _beside_cells(one) if beside else ()) for one in sites[:_TOP]]
        grid = screen.plain_grid(_HEADINGS, (*_NUMBERS, *beside))
        for cells, more in shown:
            grid.add_row(*map(screen.escape, (*cells, *more)))
        console.print(grid)
        if len(sites) > _TOP:
            console.print(f"and {len(sites) - _TOP} more in {PLACES}")
    console.print(screen.escape(written), soft_wrap=True)


def _cells(one: "PlaceConflicts") -> tuple[str, ...]:
    return (
        one.title if one.kind == "movement" else f"{one.kind} {one.title}",
        str(one.conflicts),
        *map(str, one.types.values()),
        f"{one.per_hour:.1f}",
        "-" if one.per_1000 is None else f"{one.per_1000:.1f}",
        "-" if one.ttc_s is None else f"{one.ttc_s:.1f} s",
        "-" if one.pet_s is None else f"{one.pet_s:.1f} s",
    )


def _beside_cells(one: "PlaceConflicts") -> tuple[str, ...]:
    values = one.columns()
    risk, low, high = (values[f"risk_hit{end}"] for end in ("", "_lo", "_hi"))
    critical = values["criticality"]
    return (
        str(values["attacks"]),
        str(values["hits"]),
        "-" if risk is None else f"{100 * risk:.0f} % ({100 * low:.0f} to {100 * high:.0f} %)",
        "-" if critical is None else f"{critical:.2f}",
    )
