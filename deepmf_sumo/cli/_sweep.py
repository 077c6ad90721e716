"""The options that `run` and `attack` share, and how both end."""

import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

import click

import deepmf_sumo
from deepmf_sumo.cli._parameters import FiniteRange
from deepmf_sumo.errors import UsageError, exit_code
from deepmf_sumo.study.sweep.limits import MEMORY_MB, TIMEOUT_S

if TYPE_CHECKING:
    from deepmf_sumo.errors import Ending
    from deepmf_sumo.results.result import Result
    from deepmf_sumo.study.sweep.batch import Options
    from deepmf_sumo.study.sweep.episode import Draw

_POSITIVE: Final = FiniteRange(min=0, min_open=True)
_GIVEN: Final = click.Path(exists=True, path_type=Path)


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """How runs are done, and by what they are judged.

    Attributes:
        options: of the runs.
        thresholds: a file, see `results.gate.load`. baseline: earlier results.
    """

    options: "Options"
    thresholds: Path | None
    baseline: Path | None

    @classmethod
    def begin(cls, values: dict[str, Any], *, pictures: bool, **more: Any) -> Self:
        """Take the shared options out of ``values``, those of a command; ``more`` are its own.

        ``pictures``: whether runs are drawn where no option says so. Raises UsageError for what
        would show only after hours of runs: a shard, an executor, formats, thresholds or a baseline
        that are wrong; OutputError for a folder that cannot be used.
        """
        from deepmf_sumo.results import folder
        from deepmf_sumo.results.exports import Format
        from deepmf_sumo.study.sweep import batch
        from deepmf_sumo.study.sweep.shards import Shard

        sys.path.append(os.getcwd())  # noqa: PTH109 - planners under test lie in the working folder
        predict_on(values.pop("device"))
        shard, drawn = values.pop("shard"), values.pop("pictures")
        judged = {key: values.pop(key) for key in ("thresholds", "baseline")}
        values["formats"] = tuple(map(Format.named, dict.fromkeys(values["formats"])))
        known = [field.name for field in fields(batch.Options) if field.name in values]
        given = {key: values.pop(key) for key in known} | more
        if given["gui"]:
            _check_gui(given["executor"])
            given |= {"jobs": 1, "timeout_s": None, "memory_mb": None}
        options = batch.Options(
            **given,
            shard=Shard.parse(shard) if shard else None,
            draw=_draw() if (pictures if drawn is None else drawn) else None,
        )
        sweep = cls(options=options, **judged)
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


def _draw() -> "Draw":
    from deepmf_sumo.report.picture import draw  # loads matplotlib, which takes half a second

    return draw


def _check_gui(executor: str) -> None:
    if executor != "local":
        raise UsageError(f"--gui shows runs on this machine: leave --executor {executor} out.")
    needs_one = sys.platform not in {"win32", "darwin"}
    display = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY")
    if needs_one and not display:  # the run would wait for sumo-gui for ever
        raise UsageError(
            "--gui: there is no display (DISPLAY is not set); leave it out, or put xvfb-run -a"
            " before the command."
        )


device_option = click.option(
    "--device", type=click.Choice(["cpu", "cuda", "auto"]),
    help="Predict on this device; auto: on a GPU where there is one.  [default:"
    " $DEEPMF_SUMO_DEVICE, else cpu]",
)  # fmt: skip


def predict_on(device: str | None) -> None:
    """Let this process and its workers predict there; None: as the environment says.

    Raises WeightsError for cuda without such a device.
    """
    from deepmf_sumo.deepmf.networks import weights

    if device == "cuda":
        weights.need("torch", "--device cuda")
        from deepmf_sumo.deepmf.networks import torch_networks

        torch_networks.device(device)
    if device is not None:
        os.environ[weights.DEVICE] = device


def options(*, out: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorator: the shared options, as keywords that `Sweep.begin` takes; ``out`` is a default."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed((*_place(out), *_limits(), *_shown(), *_judged())):
            command = option(command)
        return command

    return decorate


def _place(out: str) -> tuple[Callable[..., Any], ...]:
    """Where runs are done, and where their results go."""
    return (
        click.option(
            "--jobs", "-j", type=click.IntRange(1, 4096),
            help="Do this number of runs at a time.  [default: 1; with Ray all its processors]",
        ),
        click.option(
            "--executor", metavar="WHERE", default="local", show_default=True,
            help="Do the runs here (local), on this machine's Ray cluster (ray), or on that of"
            " ray://HOST:PORT.",
        ),
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
            "--shard", metavar="I/N",
            help="Do every N-th run, from the I-th on; `deepmf-sumo merge` joins the shards.",
        ),
        device_option,
    )  # fmt: skip


def _limits() -> tuple[Callable[..., Any], ...]:
    return (
        click.option(
            "--max-minutes", "minutes", metavar="M", type=_POSITIVE,
            help="Start no run after M minutes: exit code 130; --resume does the others.",
        ),
        click.option(
            "--timeout", "timeout_s", metavar="S", type=_POSITIVE, default=TIMEOUT_S,
            show_default=True, help="End a run that takes more seconds.",
        ),
        click.option(
            "--memory", "memory_mb", metavar="MB", type=_POSITIVE, default=MEMORY_MB,
            show_default=True, help="End a run that takes more memory.",
        ),
    )  # fmt: skip


def _shown() -> tuple[Callable[..., Any], ...]:
    return (
        click.option("--gui", is_flag=True, help="Show each run in sumo-gui, one at a time."),
        click.option(
            "--pictures/--no-pictures", default=None,
            help="Draw a picture of every run.  [default: yes, but not for a plan]",
        ),
        click.option("--junit", is_flag=True, help="Write junit.xml into the folder."),
        click.option(
            "--export", "formats", metavar="FORMAT", multiple=True,
            help="Write each run in this format as well, as `deepmf-sumo export` does; may be"
            " repeated.",
        ),
    )  # fmt: skip


def _judged() -> tuple[Callable[..., Any], ...]:
    return (
        click.option(
            "--thresholds", metavar="FILE", type=_GIVEN,
            help="Judge the results as `deepmf-sumo check` does, and end with its exit code.",
        ),
        click.option(
            "--baseline", metavar="RESULTS", type=_GIVEN,
            help="Compare with these earlier results, as `deepmf-sumo check` does.",
        ),
    )  # fmt: skip


def end_of_runs(sweep: Sweep, results: "Sequence[Result]") -> int:
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
    return end(sweep, results, missing)


def end(sweep: Sweep, results: "Sequence[Result]", missing: int) -> int:
    """The exit code, see `errors.exit_code`.

    Thresholds judge the results instead of the expectations of specs and the runs that failed, and
    nothing else: what is missing, wrong or could not be exported counts beside the verdict.
    """
    from deepmf_sumo.results import folder
    from deepmf_sumo.study.sweep import batch
    from deepmf_sumo.study.sweep.workers import watched

    if not watched():
        click.echo("deepmf-sumo: this system does not show memory: no --memory limit", err=True)
    endings: set[Ending] = set(batch.endings(results))
    exported = _all_exported(sweep, results)
    out = sweep.options.out
    if not folder.known(out):
        unlocked = "its file system has no locks: do not let two sweeps write into it at a time"
        click.echo(f"deepmf-sumo: {out}: {unlocked}", err=True)
    if sweep.thresholds or sweep.baseline:
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

    named = gate.load(sweep.thresholds).baseline.results
    place = sweep.baseline or (Path(named) if named else None)
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

    verdict = gate.check(sweep.options.out, gate.load(sweep.thresholds), sweep.baseline)
    show_verdict(verdict)
    if sweep.options.junit:
        write_junit(sweep.options.out / "junit.xml", verdict)
    return verdict.ending
