"""``deepmf-sumo attack``: a .sumocfg -> result folder, without a spec."""

from pathlib import Path

import click


@click.command(name="attack")
@click.argument("config", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("sumo_options", metavar="[-- SUMO OPTIONS]", nargs=-1, type=click.UNPROCESSED)
@click.option(
    "--moments", "-n", type=click.IntRange(1, 100_000),
    help="How many attacks.  [default: 10, or one for each --at]",
)  # fmt: skip
@click.option("--av", metavar="ID", help="Attack this vehicle.")
@click.option("--av-type", metavar="TYPE", help="Attack vehicles of this type.")
@click.option(
    "--at", "at_s", metavar="S", multiple=True, type=click.FloatRange(min=0),
    help="Attack at this time of the simulation; may be repeated.",
)  # fmt: skip
@click.option(
    "--until", "until_s", metavar="S", type=click.FloatRange(min=1),
    help="Look for moments so far.  [default: the end, or a million steps of vehicles]",
)  # fmt: skip
@click.option("--duration", metavar="S", type=float, help="Of an attack.  [default: 8]")
@click.option("--planner", metavar="NAME", help="Drives the AV.  [default: idm]")
@click.option("--set", "sets", metavar="KEY=VALUE", multiple=True, help="A key of a spec.")
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    help="Of all choices and of SUMO.  [default: the configuration's]",
)
@click.option("--jobs", "-j", type=click.IntRange(1, 256), default=1, show_default=True)
@click.option("--out", type=click.Path(path_type=Path), default=Path("results"), show_default=True)
@click.option(
    "--timeout", metavar="S", type=click.FloatRange(min=0, min_open=True), default=600.0,
    show_default=True, help="Seconds that one run may take.",
)  # fmt: skip
@click.option("--gui", is_flag=True, help="Show each run in sumo-gui, one at a time.")
@click.option("--junit", is_flag=True, help="Write junit.xml.")
@click.option("--no-pictures", is_flag=True, help="Draw no picture.png.")
@click.option("--resume", is_flag=True, help="Keep equal runs that are in the folder already.")
@click.pass_context
def command(
    ctx: click.Context,
    config: Path,
    sumo_options: tuple[str, ...],
    moments: int | None,
    av: str | None,
    av_type: str | None,
    at_s: tuple[float, ...],
    until_s: float | None,
    duration: float | None,
    planner: str | None,
    sets: tuple[str, ...],
    seed: int | None,
    jobs: int,
    out: Path,
    timeout: float,
    gui: bool,
    junit: bool,
    no_pictures: bool,
    resume: bool,
) -> None:
    """Attack vehicles of CONFIG, a .sumocfg, at moments spread over its roads and its time.

    One simulation without an attack shows who is where when; each moment chosen is then a run of
    its own: SUMO's traffic up to the moment, the planner and the attack from there on. Writes a
    result folder as `run` does, and moments.csv. Where nobody can be attacked it says why, and
    ends with 0.
    """
    import os
    import sys

    from deepmf_sumo.benchmark import batch
    from deepmf_sumo.benchmark import moments as chosen
    from deepmf_sumo.benchmark.store import summary
    from deepmf_sumo.cli.screen.moments import announce
    from deepmf_sumo.cli.screen.runs import progress, table
    from deepmf_sumo.report.picture import draw
    from deepmf_sumo.simulation.configuration import read_configuration
    from deepmf_sumo.simulation.scouting import Scouting

    sys.path.append(os.getcwd())  # noqa: PTH109 - planners under test lie in the working folder
    configuration = read_configuration(config, sumo_options)
    keys = {
        "seed": configuration.seed if seed is None else seed,
        **({} if duration is None else {"duration_s": duration}),
        **({} if planner is None else {"planner": {"name": planner}}),
    }
    spec = chosen.base_spec(config, keys, sets, sumo_options)
    wish = chosen.Wish(
        count=moments or len(at_s) or 10,
        av=av,
        av_type=av_type,
        at_s=at_s,
        duration_s=spec.duration_s,
        seed=spec.seed,
    )
    options = batch.Options(
        out=out,
        jobs=1 if gui else jobs,
        timeout_s=None if gui else timeout,
        draw=None if no_pictures else draw,
        gui=gui,
        junit=junit,
        resume=resume,
    )
    scouting = Scouting(config=config, sumo_options=sumo_options, seed=spec.seed, until_s=until_s)
    found = chosen.find(scouting, wish, timeout)
    announce(configuration, found, wish)
    with progress() as report:
        results = chosen.attack(spec, found.moments, options, report)
    if results:
        table(results, summary(results), out)
    ctx.exit(batch.exit_code(results))
