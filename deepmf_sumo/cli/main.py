"""``deepmf-sumo``: one file for each command, found by its name (`try_.py` is `try`).

A command file exposes ``command`` and imports large libraries inside it, so that help is fast.
"""

import errno
import importlib
import io
import keyword
import os
import pkgutil
import signal
import sys
import threading
import traceback
from typing import Final, NoReturn

import click

import deepmf_sumo
from deepmf_sumo import cli
from deepmf_sumo.cli import _gone as gone
from deepmf_sumo.cli._parameters import CommandGroup
from deepmf_sumo.errors import EXIT_CODES, DeepmfError, OutputError
from deepmf_sumo.texts import shown

SECTIONS: Final = {
    "Attack": ("attack", "run", "attach", "serve"),
    "Results": ("show", "report", "risk", "compare", "check", "export", "shrink", "merge"),
    "Network": ("screen", "conflicts", "try"),
    "Predictors": ("data", "train", "evaluate"),
    "Set-up": ("init", "doctor", "schema"),
}
"""As help shows the commands, those that most users need first."""
_INSTALLED_APART: Final = ("torch", "onnx", "onnxscript", "onnxruntime")
"""Packages that the light installation or some extras leave out."""
_SUMO_HOME: Final = "--sumo-home"
_AGAIN_S: Final = 0.02
_FULL: Final = {errno.ENOSPC, errno.EDQUOT}
_MAKE_ROOM: Final = (
    "make room where --out is, and give the same command again; sweeps go on with --resume, and"
    " finished runs are kept"
)


class Commands(CommandGroup):
    """The modules of this folder."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Names of all commands, sorted."""
        found = (module.name for module in pkgutil.iter_modules(cli.__path__))
        names = (name for name in found if not name.startswith("_") and name != "main")
        return sorted(name.removesuffix("_") for name in names)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """A command of `list_commands`."""
        if cmd_name not in self.list_commands(ctx):
            return None
        name = f"{cmd_name}_" if keyword.iskeyword(cmd_name) else cmd_name
        command: click.Command = importlib.import_module(f"deepmf_sumo.cli.{name}").command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """As of `CommandGroup`; a command that is gone is refused with what to write instead."""
        if args[0] in gone.COMMANDS:
            ctx.fail(gone.command(args[0]))
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """All commands, in the sections of `SECTIONS`."""
        width = max(map(len, self.list_commands(ctx)))
        for title, names in SECTIONS.items():
            found = [(name, self.get_command(ctx, name)) for name in names]
            with formatter.section(title):
                formatter.write_dl(
                    [(name.ljust(width), one.get_short_help_str()) for name, one in found if one]
                )


def _use_sumo(ctx: click.Context, option: click.Parameter, folder: str | None) -> None:  # noqa: ARG001
    """Let this process and those that it starts use the user's own SUMO."""
    if folder is None:
        return
    from pathlib import Path

    from deepmf_sumo.errors import UsageError
    from deepmf_sumo.sumo import installed

    home = Path(folder).absolute()
    if why := installed.reason(home):
        raise UsageError(f"--sumo-home: {home} {why}, so it is no SUMO that can be used.")
    os.environ[installed.VARIABLE] = str(home)


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(deepmf_sumo.__version__, prog_name="deepmf-sumo")
@click.option(
    "--debug", is_flag=True, expose_value=False,
    help="Show the traceback of an error; may be given anywhere in the command.",
)  # fmt: skip
@click.option(
    "--sumo-home", metavar="DIR", expose_value=False, callback=_use_sumo,
    help="Use the SUMO of this folder instead of the installed package, as SUMO_HOME does; may be"
    " given anywhere in the command.",
)  # fmt: skip
def commands() -> None:
    """Attack an automated vehicle in SUMO traffic, in closed loop, with DeepMF and others.

    \b
    Exit codes: 0 success; 1 an expectation is broken; 2 the command or a spec
    is wrong; 3 a run failed; 130 interrupted.
    """


def main() -> NoReturn:
    """Run the command line; errors are one line on standard error, never a traceback."""
    signal.signal(signal.SIGTERM, _interrupt)
    sys.unraisablehook = _unraised
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # names of files can be any bytes
    code = run(sys.argv[1:])
    for number in (signal.SIGINT, signal.SIGTERM):  # the rest is Python's own end, and has no code
        signal.signal(number, signal.SIG_IGN)
    if code == EXIT_CODES["interrupted"]:
        # Under `python -m`, CPython ends itself by SIGINT if an interrupt once left a text that
        # `exec` ran, as imports of data classes do, however it was handled; the next text resets it
        exec("")  # noqa: S102
    sys.exit(code)


def _unraised(what: "sys.UnraisableHookArgs") -> None:
    """An interrupt that comes within a callback of C code, which cannot raise it, comes again.

    A moment later, and from a thread: else it would be raised here, and be lost again.
    """
    if isinstance(what.exc_value, KeyboardInterrupt):
        from deepmf_sumo import system

        again = threading.Timer(_AGAIN_S, system.interrupt)
        again.daemon = True
        again.start()
    else:
        sys.__unraisablehook__(what)


def run(arguments: list[str]) -> int:
    """Run one command line, without the program's name, in this process; returns the exit code."""
    end = arguments.index("--") if "--" in arguments else len(arguments)
    debug = "--debug" in arguments[:end]
    given = [one for one in arguments[:end] if one != "--debug"]
    given, lines = gone.in_todays_words(_sumo_home_first(given))
    for line in lines:
        click.echo(f"deepmf-sumo: {line}", err=True)
    given += arguments[end:]
    try:
        code = _done(given)
    except click.NoSuchOption as error:
        told = gone.explained(error)
        told.show()
        return told.exit_code
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        click.echo("deepmf-sumo: interrupted", err=True)
        return EXIT_CODES["interrupted"]
    except BrokenPipeError:  # e.g. `| head`; a second complaint at exit is avoided
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_CODES["failed"]
    except Exception as error:  # noqa: BLE001 - people get a line; --debug shows the rest
        if debug:
            traceback.print_exception(error)
        text, code = _told(error)
        click.echo(f"deepmf-sumo: {shown(' '.join(text.split()))}", err=True)
        return code
    return code if isinstance(code, int) else 0


def _done(given: list[str]) -> object:
    """What the command gives back."""
    try:
        return commands.main(given, prog_name="deepmf-sumo", standalone_mode=False)
    except RuntimeError as error:
        # Python before 3.12 makes this of an interrupt that comes as a class is made, on import
        if isinstance(error.__cause__, KeyboardInterrupt):
            raise KeyboardInterrupt from error
        raise


def _sumo_home_first(arguments: list[str]) -> list[str]:
    """The arguments with the option of all commands before the command."""
    for place, one in enumerate(arguments):
        if one == _SUMO_HOME or one.startswith(f"{_SUMO_HOME}="):
            end = place + 1 + (one == _SUMO_HOME)
            return arguments[place:end] + arguments[:place] + arguments[end:]
    return arguments


def _told(error: Exception) -> tuple[str, int]:
    """The line and the exit code of an error."""
    if isinstance(error, DeepmfError):
        return str(error), error.exit_code
    if isinstance(error, OSError) and error.filename:  # rights, or a full disk
        return f"{error.filename} cannot be used: {error.strerror}.", OutputError.exit_code
    if isinstance(error, OSError) and error.errno in _FULL:
        return f"{error.strerror}: {_MAKE_ROOM}.", OutputError.exit_code
    if isinstance(error, ModuleNotFoundError) and error.name in _INSTALLED_APART:
        return f"This needs {error.name}; run `pip install {error.name}`.", EXIT_CODES["failed"]
    where = "deepmf-sumo --debug ... shows where"
    return f"unexpected {type(error).__name__}: {error} ({where})", EXIT_CODES["failed"]


def _interrupt(number: int, frame: object) -> NoReturn:  # noqa: ARG001 - as `signal` wants it
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()
