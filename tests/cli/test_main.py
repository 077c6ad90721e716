import signal
import subprocess
import sys
import time
from pathlib import Path

import click
import pytest

from deepmf_sumo.cli import main
from deepmf_sumo.errors import ReaderError, SpecError

ROOT = Path(__file__).resolve().parents[2]


def run(*arguments, **options):
    command = [sys.executable, "-m", "deepmf_sumo.cli.main", *map(str, arguments)]
    return subprocess.run(command, check=False, cwd=ROOT, capture_output=True, text=True, **options)


def test_help_lists_the_files_of_the_folder():
    done = run("--help")
    assert done.returncode == 0
    files = {path.stem for path in (ROOT / "deepmf_sumo" / "cli").glob("[!_]*.py")}
    assert "  -" not in done.stdout.partition("Commands:")[2]
    for name in files - {"main"}:
        assert f"  {name.replace('_', '-')} " in done.stdout


def test_every_command_explains_itself():
    context = click.Context(main.commands)
    for name in main.commands.list_commands(context):
        command = main.commands.get_command(context, name)
        assert isinstance(command, click.Command)
        assert command.help, name


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from deepmf_sumo.cli import main; main._run(['--help'])\n"
        "heavy = 'numpy torch libsumo traci matplotlib pandas pydantic shapely sumolib'\n"
        "print([name for name in heavy.split() if name in sys.modules], file=sys.stderr)"
    )
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", code], check=False, cwd=ROOT, capture_output=True, text=True
    )
    assert done.stderr.strip() == "[]"
    assert time.perf_counter() - begin < 3.0  # 0.2 s on an idle machine


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (SpecError("a.yaml:1: key 'x':\nbad."), 2, "deepmf-sumo: a.yaml:1: key 'x': bad."),
        (ReaderError("broken"), 3, "deepmf-sumo: broken"),
        (PermissionError(13, "Permission denied", "x.csv"), 2, "x.csv cannot be used: Permission"),
        (OSError(28, "No space left on device"), 2, "No space left on device: make room where"),
        (ZeroDivisionError("oops"), 3, "deepmf-sumo: unexpected ZeroDivisionError: oops"),
        (KeyboardInterrupt(), 130, "deepmf-sumo: interrupted"),
        (click.UsageError("no such option"), 2, "no such option"),
    ],
)
def test_errors_are_a_line_and_a_code(monkeypatch, capsys, error, code, text):
    @click.command()
    def command():
        raise error

    monkeypatch.setattr(main.Commands, "get_command", lambda *_: command)
    assert main._run(["run"]) == code
    captured = capsys.readouterr().err
    assert text in captured
    assert "Traceback" not in captured


def test_debug_shows_where(monkeypatch, capsys):
    @click.command()
    def command():
        raise ReaderError("broken")

    monkeypatch.setattr(main.Commands, "get_command", lambda *_: command)
    assert main._run(["--debug", "run"]) == 3
    assert "Traceback" in capsys.readouterr().err


def test_exit_code_of_a_command_is_passed_on(monkeypatch):
    @click.command()
    @click.pass_context
    def command(ctx):
        ctx.exit(1)

    monkeypatch.setattr(main.Commands, "get_command", lambda *_: command)
    assert main._run(["run"]) == 1


@pytest.mark.parametrize("arguments", [["nonsense"], ["run"], ["run", "--jobs", "0", "x.yaml"]])
def test_wrong_command_lines(arguments, capsys):
    assert main._run(arguments) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_a_closed_pipe_is_no_traceback():
    done = subprocess.run(
        f"{sys.executable} -m deepmf_sumo.cli.main schema | head -c 1",
        check=False, shell=True, cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
    assert done.stdout == "{"
    assert "Traceback" not in done.stderr


def test_terminate_is_an_interrupt():
    code = (
        "import sys, time, click; from deepmf_sumo.cli import main\n"
        "@click.command()\n"
        "def command():\n"
        "    print('here', flush=True); time.sleep(60)\n"
        "main.Commands.get_command = lambda *_: command\n"
        "sys.argv[1:] = ['x']; main.main()"
    )
    child = subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    child.stdout.readline()
    child.send_signal(signal.SIGTERM)
    _, errors = child.communicate(timeout=10)
    assert child.returncode == 130
    assert errors.decode().strip() == "deepmf-sumo: interrupted"
