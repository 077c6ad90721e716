"""The options that `run`, `attack` and `try` share, and how they end."""

import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

import click

import deepmf_sumo
from deepmf_sumo import system
from deepmf_sumo.errors import UsageError, exit_code

if TYPE_CHECKING:
    from deepmf_sumo.cli._keys import SweepKeys
    from deepmf_sumo.errors import Ending
    from deepmf_sumo.results.result import Result
    from deepmf_sumo.study.sweep.batch import Options
    from deepmf_sumo.study.sweep.episode import Draw


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """How runs are done, and by what they are judged.

    Attributes:
        options: of the runs.
        keys: of ``--set sweep.KEY=VALUE``.
    """

    options: "Options"
    keys: "SweepKeys"

    @classmethod
    def begin(
        cls, values: dict[str, Any], keys: "SweepKeys", *, pictures: bool, **more: Any
    ) -> Self:
        """Take the shared options out of ``values``, those of a command; ``more`` are its own.

        ``pictures``: whether runs are drawn where no option says so. Raises UsageError for what
        would show only after hours of runs: a shard, an executor, a device, formats, thresholds or
        a baseline that are wrong; OutputError for a folder that cannot be used.
        """
        from deepmf_sumo.deepmf.networks import weights
        from deepmf_sumo.results import folder
        from deepmf_sumo.results.exports import Format
        from deepmf_sumo.study.sweep import batch
        from deepmf_sumo.study.sweep.shards import Shard

        sys.path.append(os.getcwd())  # noqa: PTH109 - planners under test lie in the working folder
        weights.runtime_and_device()  # raises where the environment asks for what is not there
        shard, drawn = values.pop("shard"), values.pop("pictures")
        formats = dict.fromkeys(values.pop("formats"))
        if keys.gui:
            _check_gui(keys.executor)
            values["jobs"] = 1
        options = batch.Options(
            **{name: values.pop(name) for name in ("out", "jobs", "resume", "overwrite")},
            **more,
            executor=keys.executor,
            timeout_s=None if keys.gui else keys.timeout_s,
            memory_mb=None if keys.gui else keys.memory_mb,
            minutes=keys.max_minutes,
            gui=keys.gui,
            junit=keys.junit,
            formats=tuple(map(Format.named, formats)),
            shard=Shard.parse(shard) if shard else None,
            draw=_draw() if (pictures if drawn is None else drawn) else None,
        )
        sweep = cls(options=options, keys=keys)
        check(sweep)
        executor = batch.executor_named(options.executor, options.jobs)
        if options.resume and options.overwrite:
            raise UsageError(
                "--resume keeps the results in the folder, and --overwrite deletes them: leave one"
                " of them out."
            )
        folder.check(options.out, resume=options.resume, overwrite=options.overwrite)
        executor.check()
        return sweep


def sweep_keys(sets: Sequence[str], *others: str) -> "tuple[SweepKeys, list[str]]":
    """The keys of a sweep, and what else is set. ``others``: keys of another command.

    Raises SpecError or UsageError for keys and values that are wrong.
    """
    from deepmf_sumo.cli._keys import SWEEP, SweepKeys, taken

    keys, rest = taken(sets, SweepKeys, SWEEP)
    wrong = next((name for name in others if name in keys.model_fields_set), None)
    if wrong:
        raise UsageError(f"--set {SWEEP}.{wrong} is not for this command; leave it out.")
    return keys, rest


def _draw() -> "Draw":
    from deepmf_sumo.report.picture import draw  # loads matplotlib, which takes half a second

    return draw


def _check_gui(executor: str) -> None:
    if executor != "local":
        raise UsageError(
            f"sweep.gui shows runs on this machine: leave sweep.executor={executor} out."
        )
    display = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY")
    if system.NEEDS_DISPLAY and not display:  # the run would wait for sumo-gui for ever
        raise UsageError(
            "sweep.gui: there is no display (DISPLAY is not set); leave it out, or put xvfb-run -a"
            " before the command."
        )


set_option: Final = click.option(
    "--set", "sets", metavar="KEY=VALUE", multiple=True,
    help="Set a key of the spec, or sweep.KEY, e.g. sweep.timeout_s=60; may be repeated.",
)  # fmt: skip


def options(*, out: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorator: the shared options, as keywords that `Sweep.begin` takes; ``out`` is a default."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed((*_place(out), *_written())):
            command = option(command)
        return command

    return decorate


def _place(out: str) -> tuple[Callable[..., Any], ...]:
    """Where results go, and how many runs are done at a time."""
    return (
        click.option(
            "--out", type=click.Path(path_type=Path), default=out, show_default=True,
            help="Write the results into this folder.",
        ),
        click.option(
            "--resume", is_flag=True, help="Keep the runs that the folder already has."
        ),
        click.option(
            "--overwrite", is_flag=True, help="Delete the results that the folder has."
        ),
        click.option(
            "--jobs", "-j", type=click.IntRange(1, 4096),
            help="Execute this number of runs at a time.  [default: 1; with Ray all processors]",
        ),
        click.option(
            "--shard", metavar="I/N",
            help="Make every N-th run, from the I-th on; `deepmf-sumo merge` joins the shards.",
        ),
    )  # fmt: skip


def _written() -> tuple[Callable[..., Any], ...]:
    return (
        click.option(
            "--pictures/--no-pictures", default=None,
            help="Draw a picture of every run.  [default: yes, but not for a plan]",
        ),
        click.option(
            "--export", "formats", metavar="FORMAT", multiple=True,
            help="Also write each run in this format, as `deepmf-sumo export` does; may be"
            " repeated.",
        ),
    )  # fmt: skip


def show_runs(sweep: Sweep, results: "Sequence[Result]") -> int:
    """Show the table of the runs; returns the exit code."""
    from deepmf_sumo.cli._screen import table
    from deepmf_sumo.report.table import counted
    from deepmf_sumo.results import stored
    from deepmf_sumo.results.folder import summary

    out = sweep.options.out
    missing = stored.missing(out)
    if results:
        table(results, summary(results), out)
    if missing:
        click.echo(f"{counted(missing, 'run')} not begun: --resume goes on")
    return exit_code_of(sweep, results, missing)


def exit_code_of(sweep: Sweep, results: "Sequence[Result]", missing: int) -> int:
    """The exit code, see `errors.exit_code`.

    Thresholds judge the results instead of the expectations of specs and the runs that failed, and
    nothing else: what is missing, wrong or could not be exported counts beside the verdict.
    """
    from deepmf_sumo.results import folder
    from deepmf_sumo.study.sweep import batch

    if not system.memory_known():
        click.echo("deepmf-sumo: this system does not show memory: no limit of memory", err=True)
    endings: set[Ending] = set(batch.endings(results))
    exported = _all_exported(sweep, results)
    out = sweep.options.out
    if not folder.known(out):
        unlocked = "its file system has no locks: do not let two sweeps write into it at a time"
        click.echo(f"deepmf-sumo: {out}: {unlocked}", err=True)
    if sweep.keys.thresholds or sweep.keys.baseline:
        endings = (endings & {"wrong"}) | {judge(sweep)}
    if not exported:
        endings.add("failed")
    if missing:
        endings.add("interrupted")
    return exit_code(*endings)


def _all_exported(sweep: Sweep, results: "Sequence[Result]") -> bool:
    """Say how many runs were written in each format; whether that is all that could be."""
    from deepmf_sumo.report.table import counted

    done = [one["run_id"] for one in results if one["status"] == "ok"]
    whole = True
    for form in sweep.options.formats:
        runs = sweep.options.out / "runs"
        there = sum(form.place(runs / run_id).exists() for run_id in done)
        click.echo(f"{form.name}: {there} of {counted(len(done), 'run')} written")
        whole = whole and there == len(done)
    return whole


def write_page(out: Path) -> None:
    """Write report.html and say where it is."""
    from deepmf_sumo.report import page

    click.echo(page.write(out))


def map_risk(out: Path) -> None:
    """Write ``out/risk`` again and say where; a line says why there is no map.

    The runs are complete either way, so that is not an error.
    """
    from deepmf_sumo.errors import DeepmfError
    from deepmf_sumo.report import risk as files
    from deepmf_sumo.results import risk
    from deepmf_sumo.results.folder import RISK, forget_map

    forget_map(out / RISK)
    try:
        written = files.write(out / RISK, risk.read([out]), out.resolve().name)
    except DeepmfError as error:
        click.echo(f"deepmf-sumo: no risk map: {error}", err=True)
        return
    for one in written:
        click.echo(f"{one.folder}/{files.PAGE}")


def check(sweep: Sweep) -> None:
    """Raise UsageError for files that no result could be judged by."""
    from deepmf_sumo.results import gate

    named = gate.load(sweep.keys.thresholds).baseline.results
    place = sweep.keys.baseline or (Path(named) if named else None)
    if place:
        version = gate.read(place).version
        if version != deepmf_sumo.__version__:
            raise UsageError(
                f"{place} was made by version {version} of deepmf-sumo, and this is"
                f" {deepmf_sumo.__version__}: the attacks differ; write the baseline again."
            )


def judge(sweep: Sweep) -> "Ending":
    """Judge the result folder, show the verdict, and write it to junit.xml where asked for."""
    from deepmf_sumo.cli._screen import show_verdict
    from deepmf_sumo.results import gate
    from deepmf_sumo.results.gate.verdict import write_junit

    verdict = gate.check(sweep.options.out, gate.load(sweep.keys.thresholds), sweep.keys.baseline)
    show_verdict(verdict)
    if sweep.options.junit:
        write_junit(sweep.options.out / "junit.xml", verdict)
    return verdict.ending
