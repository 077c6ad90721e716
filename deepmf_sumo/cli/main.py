"""``deepmf-sumo``: a file a command, found by its name.

A command file exposes ``command`` and imports what is heavy inside it, so that help is quick.
"""

import errno
import importlib
import io
import os
import pkgutil
import signal
import sys
import traceback
from typing import NoReturn

import click

import deepmf_sumo
from deepmf_sumo import cli
from deepmf_sumo.errors import DeepmfError, OutputError
from deepmf_sumo.texts import shown

INTERRUPTED = 130
FAILED = DeepmfError.exit_code
_FULL = {errno.ENOSPC, errno.EDQUOT}
_MAKE_ROOM = (
    "make room where --out is, and give the same command again; sweeps go on with --resume, what"
    " was finished is kept"
)


class Commands(click.Group):
    """The modules of this folder."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Names of all commands, sorted; underscores of file names are dashes."""
        found = [
            module
            for module in pkgutil.iter_modules(cli.__path__)
            if not (module.ispkg or module.name.startswith("_"))
        ]
        return sorted(one.name.replace("_", "-") for one in found if one.name != "main")

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """A command of `list_commands`."""
        if cmd_name not in self.list_commands(ctx):
            return None
        module = importlib.import_module(f"deepmf_sumo.cli.{cmd_name.replace('-', '_')}")
        command: click.Command = module.command
        return command


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(deepmf_sumo.__version__, prog_name="deepmf-sumo")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
def commands(debug: bool) -> None:
    """Attack an automated vehicle in SUMO traffic, in closed loop, with DeepMF and others.

    \b
    Exit codes: 0 fine; 1 an expectation is broken; 2 the command or a spec is wrong;
    3 a run failed; 130 interrupted.
    """


def main() -> NoReturn:
    """Run the command line; errors are one line on standard error, never a traceback."""
    signal.signal(signal.SIGTERM, _interrupt)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # names of files can be any bytes
    sys.exit(_run(sys.argv[1:]))


def _run(arguments: list[str]) -> int:
    try:
        code = commands.main(arguments, prog_name="deepmf-sumo", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        click.echo("deepmf-sumo: interrupted", err=True)
        return INTERRUPTED
    except BrokenPipeError:  # e.g. `| head`; a second complaint at exit is avoided
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except DeepmfError as error:
        _show(error, str(error), arguments)
        return error.exit_code
    except Exception as error:  # noqa: BLE001 - people get a line; --debug shows the rest
        where, failed = "deepmf-sumo --debug ... shows where", FAILED
        text = f"unexpected {type(error).__name__}: {error} ({where})"
        if isinstance(error, OSError) and error.filename:  # rights, or a full disk
            text, failed = (
                f"{error.filename} cannot be used: {error.strerror}.",
                OutputError.exit_code,
            )
        elif isinstance(error, OSError) and error.errno in _FULL:
            text, failed = f"{error.strerror}: {_MAKE_ROOM}.", OutputError.exit_code
        _show(error, text, arguments)
        return failed
    return code if isinstance(code, int) else 0


def _show(error: Exception, text: str, arguments: list[str]) -> None:
    if "--debug" in arguments[:1]:
        traceback.print_exception(error)
    click.echo(f"deepmf-sumo: {shown(' '.join(text.split()))}", err=True)


def _interrupt(number: int, frame: object) -> NoReturn:  # noqa: ARG001 - as `signal` wants it
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()
