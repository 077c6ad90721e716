import re
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import click
import pytest

from deepmf_sumo.cli import _gone as gone
from deepmf_sumo.cli import _keys, data, main
from deepmf_sumo.errors import ReaderError, SpecError

ROOT = Path(__file__).resolve().parents[2]


def run(*arguments, **options):
    command = [sys.executable, "-m", "deepmf_sumo.cli.main", *map(str, arguments)]
    return subprocess.run(command, check=False, cwd=ROOT, capture_output=True, text=True, **options)


def test_help_lists_the_files_of_the_folder():
    done = run("--help")
    assert done.returncode == 0
    files = {
        path.stem.removesuffix("_") for path in (ROOT / "deepmf_sumo" / "cli").glob("[!_]*.py")
    }
    listed = done.stdout.partition("Attack:")[2]
    assert "  -" not in listed
    lines = [line for line in listed.splitlines() if line.startswith("  ")]
    assert sorted(line.split()[0] for line in lines) == sorted(files - {"main"})
    assert [one for one in listed.splitlines() if one.endswith(":")] == [
        f"{title}:" for title in main.SECTIONS if title != "Attack"
    ]


def every_command():
    """All commands by their names, those of groups with the group's."""
    context = click.Context(main.commands)
    for name in main.commands.list_commands(context):
        command = main.commands.get_command(context, name)
        if isinstance(command, click.Group):
            yield from ((f"{name} {one}", each) for one, each in command.commands.items())
        else:
            yield name, command


def test_options_fit_into_a_head():
    counts = {
        name: sum(isinstance(one, click.Option) for one in command.params)
        for name, command in every_command()
    }
    assert max(counts.values()) <= 20
    assert sum(counts.values()) <= 130
    assert not any(command.hidden for _, command in every_command())
    assert not any(
        getattr(one, "hidden", False) for _, each in every_command() for one in each.params
    )


@pytest.mark.parametrize("name", gone.COMMANDS)
def test_a_command_that_is_gone_says_what_to_write(capsys, name):
    assert main.run([name, "x", "--out", "y"]) == 2
    told = capsys.readouterr().err
    assert f"There is no command '{name}' any more; write `{gone.COMMANDS[name]}`." in told


def instead():
    for name, options in gone.OPTIONS.items():
        for option, text in options.items():
            yield pytest.param(name, option, text, id=f"{name} {option}")


@pytest.mark.parametrize(("name", "option", "text"), list(instead()))
def test_an_option_that_is_gone_is_read_as_its_key_or_says_what_to_write(
    capsys, name, option, text
):
    """And what it says is an option that the command has, with a key that it knows."""
    told = " ".join(
        (capsys.readouterr().err, *gone.in_todays_words([*name.split(), option, "7"])[1])
    )
    if text.startswith(("--set ", "--export ")):
        assert f"{name}: {option} is gone; it is read as --" in told
    else:
        assert main.run([*name.split(), option, "x"]) == 2
        assert f"{name} has no {option} any more; write {text}." in " ".join(
            capsys.readouterr().err.split()
        )
    command = dict(every_command())[name]
    known = {each for one in command.params for each in (*one.opts, *one.secondary_opts)}
    assert option not in known
    for part in re.split(r", or |; | or ", text):
        for found in re.findall(r"^--[a-z-]+", part):
            assert found in known
    for head, key in re.findall(r"--set (sweep|live)\.(\w+)=", text):
        model = {"sweep": _keys.SweepKeys, "live": _keys.AttachKeys}[head]
        assert key in model.model_fields


@pytest.mark.parametrize(
    ("given", "read"),
    [
        (
            "attack x --no-risk --seed 1",
            ["attack", "x", "--set", "sweep.risk=false", "--seed", "1"],
        ),
        ("attack x --duration=12", ["attack", "x", "--set", "duration_s=12"]),
        ("attack x --av-type 7", ["attack", "x", "--set", 'source.moments.av_type="7"']),
        ("try x --at 5 --at 6.5", ["try", "x", "--set", "source.moments.at_s=[5, 6.5]"]),
        (
            "attack x --all-conflicts",
            ["attack", "x", "--set", "profile=any", "--set", "adversary.constraints=[on_road]"],
        ),
        ("data record x --as-it-is", ["data", "record", "x", "--set", "diverse=false"]),
        ("run x --device cuda", ["run", "x", "--device", "cuda"]),  # which is refused
        ("attack x --duration", ["attack", "x", "--duration"]),
        (
            "--sumo-home x run y --junit",
            ["--sumo-home", "x", "run", "y", "--set", "sweep.junit=true"],
        ),
        ("report run --junit", ["report", "run", "--junit"]),
        ("show x --seed 3", ["show", "x", "--seed", "3"]),
    ],
)
def test_gone_options_are_keys(given, read):
    assert gone.in_todays_words(given.split())[0] == read


def test_a_script_of_the_release_before_makes_the_same_attacks(tmp_path, capsys):
    network, least = (
        str(ROOT / "sumo_nets/four_way/four_way.sumocfg"),
        ["--at", "40", "--seed", "1"],
    )
    gone_words = ["--no-risk", "--duration", "3", "--tries", "1", "--no-pictures"]
    keys = ["--set", "sweep.risk=false", "--set", "duration_s=3", "--tries", "1", "--no-pictures"]
    for name, options in (("before", gone_words), ("now", keys)):
        assert main.run(["attack", network, *least, *options, "--out", str(tmp_path / name)]) == 0
        said = capsys.readouterr().err
        assert ("--no-risk is gone; it is read as --set sweep.risk=false" in said) == (
            name == "before"
        )
    one, two = (next((tmp_path / name / "runs").iterdir()) for name in ("before", "now"))
    assert one.name == two.name
    assert (one / "spec.yaml").read_text() == (two / "spec.yaml").read_text()


def test_help_fits_a_terminal_of_80_columns(capsys):
    """Each command is one line that is not cut off, a sentence that begins with a verb."""
    context = click.Context(main.commands)
    for arguments, group in (([], main.commands), (["data"], data.command)):
        assert main.run([*arguments, "--help"]) == 0
        shown = capsys.readouterr().out
        assert max(map(len, shown.splitlines())) <= 80
        for name in group.list_commands(context):
            command = group.get_command(context, name)
            assert command.hidden or f"  {name} " in shown
            assert command.hidden or f" {command.short_help}\n" in shown
            assert command.short_help.endswith(".")


def test_every_option_is_explained_by_a_sentence():
    context = click.Context(main.commands)
    commands = [
        main.commands.get_command(context, name) for name in main.commands.list_commands(context)
    ]
    for command in [*commands, *data.command.commands.values()]:
        for option in (one for one in command.params if isinstance(one, click.Option)):
            told = f"{command.name} {option.opts[0]}: {option.help}"
            assert option.help, told
            assert option.help[0].isupper(), told
            assert re.search(r"[.\]]$", option.help), told


def test_a_mistyped_command_gets_a_suggestion(capsys):
    assert main.run(["atack", "my.sumocfg"]) == 2
    assert "No such command 'atack'. Did you mean 'attack'?" in capsys.readouterr().err
    assert main.run(["data", "lst"]) == 2
    assert "Did you mean 'list'?" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["--debug", "x"], ["x", "--debug"], ["x", "y", "--debug"]])
def test_debug_may_be_anywhere(monkeypatch, capsys, arguments):
    @click.command()
    @click.argument("rest", nargs=-1)
    def command(rest):
        raise ReaderError(f"broken {rest}")

    monkeypatch.setattr(main.Commands, "get_command", lambda *_: command)
    assert main.run(arguments) == 3
    shown = capsys.readouterr().err
    assert "Traceback" in shown
    assert "--debug" not in shown.splitlines()[-1]


def test_every_command_explains_itself():
    context = click.Context(main.commands)
    for name in main.commands.list_commands(context):
        command = main.commands.get_command(context, name)
        assert isinstance(command, click.Command)
        assert command.help, name


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from deepmf_sumo.cli import main; main.run(['--help'])\n"
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
    assert main.run(["run"]) == code
    captured = capsys.readouterr().err
    assert text in captured
    assert "Traceback" not in captured


def test_an_interrupt_as_a_class_is_made_is_an_interrupt(monkeypatch, capsys):
    class Named:
        def __set_name__(self, owner, name):
            raise KeyboardInterrupt

    @click.command()
    def command():
        type("Made", (), {"one": Named()})

    monkeypatch.setattr(main.Commands, "get_command", lambda *_: command)
    assert main.run(["run"]) == 130
    assert capsys.readouterr().err == "deepmf-sumo: interrupted\n"


def test_debug_shows_where(monkeypatch, capsys):
    @click.command()
    def command():
        raise ReaderError("broken")

    monkeypatch.setattr(main.Commands, "get_command", lambda *_: command)
    assert main.run(["--debug", "run"]) == 3
    assert "Traceback" in capsys.readouterr().err


def test_exit_code_of_a_command_is_passed_on(monkeypatch):
    @click.command()
    @click.pass_context
    def command(ctx):
        ctx.exit(1)

    monkeypatch.setattr(main.Commands, "get_command", lambda *_: command)
    assert main.run(["run"]) == 1


@pytest.mark.parametrize("arguments", [["nonsense"], ["run"], ["run", "--jobs", "0", "x.yaml"]])
def test_wrong_command_lines(arguments, capsys):
    assert main.run(arguments) == 2
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


def test_an_interrupt_while_a_text_is_executed_ends_with_the_same_code(tmp_path):
    """As in the import of a data class; under `python -m`, CPython would end by SIGINT."""
    (tmp_path / "interrupted.py").write_text(
        "import click\n"
        "from deepmf_sumo.cli import main\n"
        "@click.command()\n"
        "def command():\n"
        "    exec('raise KeyboardInterrupt')\n"
        "main.Commands.get_command = lambda *_: command\n"
        "main.main()"
    )
    line = [sys.executable, "-m", "interrupted", "x"]
    done = subprocess.run(line, check=False, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stderr.strip()) == (130, "deepmf-sumo: interrupted")


@pytest.mark.parametrize(
    ("number", "ctrl_c"),
    [
        (signal.SIGINT, signal.SIG_DFL),
        (signal.SIGTERM, signal.SIG_DFL),
        (signal.SIGTERM, signal.SIG_IGN),  # as in what a script started with `&`
    ],
)
def test_an_interrupt_within_a_callback_of_c_code_is_not_lost(number, ctrl_c):
    """Python prints what such a callback raises, and goes on; here ctypes calls it."""
    code = (
        "import ctypes, signal, time, click; from deepmf_sumo.cli import main; import sys\n"
        "@click.command()\n"
        "def command():\n"
        f"    ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal({int(number)}))()\n"
        "    time.sleep(60)\n"
        "main.Commands.get_command = lambda *_: command\n"
        "sys.argv[1:] = ['x']; main.main()"
    )
    line = [sys.executable, "-c", code]
    done = subprocess.run(
        line, check=False, cwd=ROOT, capture_output=True, text=True, timeout=30,
        preexec_fn=partial(signal.signal, signal.SIGINT, ctrl_c),
    )  # fmt: skip
    assert (done.returncode, done.stderr.strip()) == (130, "deepmf-sumo: interrupted")
