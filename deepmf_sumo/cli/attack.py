"""``deepmf-sumo attack``: SUMO configurations -> result folder, without a spec."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from deepmf_sumo.cli._parameters import AFTER, FiniteRange, WithSumoOptions
from deepmf_sumo.cli._sweep import Sweep, map_risk, options, set_option, show_runs, sweep_keys
from deepmf_sumo.errors import UsageError
from deepmf_sumo.texts import shown

if TYPE_CHECKING:
    from deepmf_sumo.spec.document import Document
    from deepmf_sumo.study.moments import FoundMoments, MomentRequest


@click.command(
    name="attack",
    cls=WithSumoOptions,
    short_help="Attack vehicles of a .sumocfg at moments that are chosen.",
)
@click.argument(
    "configs", metavar="CONFIG...", nargs=-1, required=True,
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
)  # fmt: skip
@click.option(
    "--moments", "-n", "count", type=click.IntRange(1, 100_000),
    help="Make this number of attacks in each CONFIG.  [default: 10, or once for each --at]",
)  # fmt: skip
@click.option("--av", metavar="ID", help="Attack this vehicle.")
@click.option(
    "--junction", "junctions", metavar="ID", multiple=True,
    help="Attack only at this junction, or just before it; may be repeated.",
)  # fmt: skip
@click.option(
    "--edge", "edges", metavar="ID", multiple=True,
    help="Attack only on this edge, or on the edges of the street of this name; may be repeated.",
)  # fmt: skip
@click.option(
    "--at", "at_s", metavar="S", multiple=True, type=FiniteRange(min=0),
    help="Attack at this time of the simulation, in s; may be repeated.",
)  # fmt: skip
@click.option(
    "--moments-of", "of", metavar="OUT", type=click.Path(path_type=Path),
    help="Attack the vehicles and times of this result folder, to compare.",
)  # fmt: skip
@click.option(
    "--from", "from_s", metavar="S", type=FiniteRange(min=0),
    help="Attack from this time on.  [default: once the number of vehicles has settled; any time"
    " with --av]",
)  # fmt: skip
@click.option(
    "--until", "until_s", metavar="S", type=FiniteRange(min=1),
    help="Look for moments up to this time.  [default: the end, or a million vehicle"
    " steps, five million while their number grows]",
)  # fmt: skip
@click.option(
    "--tries", type=click.IntRange(1, 1000), metavar="N",
    help="Simulate an attack at most N times, until it finds an error of the AV or an"
    " avoidable hit; 1 is a quick look.  [default: the profile's, 4 for fair]",
)  # fmt: skip
@click.option("--planner", metavar="NAME", help="Let this planner drive the AV.  [default: idm]")
@set_option
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    help="Seed all choices and SUMO.  [default: the configuration's]",
)
@click.option(
    "--save-spec", "file", metavar="FILE", type=click.Path(dir_okay=False, path_type=Path),
    help="Write the spec of this attack, for `deepmf-sumo run`, and attack nothing.",
)  # fmt: skip
@options(out="results")
@click.pass_context
def command(
    ctx: click.Context,
    /,
    configs: tuple[Path, ...],
    sets: tuple[str, ...],
    file: Path | None,
    **wanted: Any,
) -> None:
    """Attack vehicles of CONFIG, a .sumocfg, at moments spread over its roads and its time.

    A simulation without an attack records where each vehicle is; each moment chosen is then a
    separate run: SUMO's traffic up to the moment, the planner and the attack from then on. Writes a
    result folder as `run` does, moments.csv and a risk map. Where no vehicle can be attacked it
    says why, and ends with 0. Several CONFIGs are attacked alike, all in one result folder.

    It is short for `deepmf-sumo run` with a spec whose source is {network: CONFIG, moments: {...}}:
    --set sets all that has no option, e.g. duration_s=30, source.moments.prefer=encounters or
    profile=any, and --save-spec writes that spec.
    """
    if file is not None:
        _, rest = sweep_keys(sets, "figures")
        _save(file, _documents(ctx.meta[AFTER], configs, rest, wanted))
        return
    ctx.exit(attack_configs(ctx.meta[AFTER], configs, sets, **wanted))


def attack_configs(
    sumo_options: tuple[str, ...], configs: tuple[Path, ...], sets: Sequence[str], **wanted: Any
) -> int:
    """Attack as the command does with these values of its options; returns the exit code."""
    from deepmf_sumo.cli._moments import announce_moments, no_conflict
    from deepmf_sumo.cli._screen import progress, tell_causes
    from deepmf_sumo.study import moments, plans

    keys, rest = sweep_keys(sets, "figures")
    sweep = Sweep.begin(wanted, keys, pictures=True)
    documents = _documents(sumo_options, configs, rest, wanted)
    specs = [moments.spec_of(one) for one in documents]
    looked: list[tuple[MomentRequest, FoundMoments]] = []

    def announce(request: "MomentRequest", found: "FoundMoments") -> None:
        looked.append((request, found))
        announce_moments(request, found)

    with progress() as report:
        results = plans.run_specs(specs, sweep.options, report, announce, by_option=True)
    code = show_runs(sweep, results)
    tell_causes(sweep.options.out)
    if told := no_conflict(results, looked):
        click.echo(shown(told))
    if keys.risk and any(one["status"] == "ok" and one["opponent"] for one in results):
        map_risk(sweep.options.out)
    return code


def _documents(
    sumo_options: tuple[str, ...],
    configs: tuple[Path, ...],
    sets: Sequence[str],
    wanted: dict[str, Any],
) -> "list[Document]":
    """The specs that the options are short for."""
    from deepmf_sumo.study import moments

    keys: dict[str, Any] = {} if wanted["seed"] is None else {"seed": wanted["seed"]}
    if wanted["planner"] is not None:
        keys["planner"] = {"name": wanted["planner"]}
    if wanted["tries"] is not None:
        sets = (f"adversary.tries={wanted['tries']}", *sets)
    chosen = {key: wanted[key] for key in _MOMENTS}
    if chosen["of"]:
        chosen["of"] = str(chosen["of"].absolute())
    return moments.documents(configs, keys, sets, sumo_options=sumo_options, **chosen)


_MOMENTS = ("count", "av", "at_s", "of", "from_s", "until_s", "junctions", "edges")
"""Options that are keys of the spec's moments."""


def _save(file: Path, documents: "list[Document]") -> None:
    import yaml

    from deepmf_sumo import files
    from deepmf_sumo.study import moments

    if len(documents) > 1:
        raise UsageError("--save-spec goes with one configuration: a spec has one network.")
    moments.spec_of(documents[0])  # what is wrong with it shows now; files become absolute
    text = yaml.safe_dump(documents[0].values, sort_keys=False, allow_unicode=True)
    with files.writing(file):
        files.write(file, text)
    click.echo(f"{file}: deepmf-sumo run {file}")
