import os
import subprocess
import sys

import pytest

from deepmf_sumo import system
from deepmf_sumo.cli import doctor, main
from deepmf_sumo.cli.doctor import CheckResult
from deepmf_sumo.sumo import installed


def test_a_probe_that_dies_is_a_finding():
    assert doctor.probe("print('a'); print('b')") == (True, "b")
    assert doctor.probe("import no_such_library")[1].endswith("'no_such_library'")
    good, text = doctor.probe("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    assert (good, text) == (False, "its process was ended by signal 11")


def test_programs_that_hang_or_are_not_there(tmp_path):
    hang = [sys.executable, "-c", "import time; time.sleep(60)"]
    assert doctor.ended(hang, 0.2) == (False, "did not end within 0.2 s")
    assert doctor.ended([str(tmp_path / "no")], 1.0)[0] is False
    plain = tmp_path / "plain"
    plain.write_text("")
    assert "cannot be started" in doctor.ended([str(plain)], 1.0)[1]


def test_a_check_that_fails_itself_is_a_finding():
    def check():
        raise KeyError("oops")

    assert doctor.look(check) == CheckResult("broken", "KeyError: 'oops'")


def test_what_the_system_lacks_is_shown_with_what_is_done_instead(monkeypatch):
    assert doctor.system_calls().state == "ok"
    few = (system.Ability("wings", False, "it walks"), system.Ability("legs", True, "it rests"))
    monkeypatch.setattr(system, "abilities", lambda: few)
    found = doctor.system_calls()
    assert found.state == "warning"
    assert "no wings: it walks (" in found.text
    assert "legs" not in found.text


def test_sumo_packages_of_two_versions(monkeypatch):
    assert doctor.sumo_versions().state == "ok"
    versions = dict.fromkeys(doctor.SUMO, "1.28.0") | {"traci": "1.20.0"}
    monkeypatch.setattr(doctor, "_installed", versions.get)
    found = doctor.sumo_versions()
    assert found.state == "broken"
    assert found.text.endswith("install them as: pip install traci==1.28.0")
    monkeypatch.setattr(doctor, "_installed", (versions | {"libsumo": None}).get)
    assert "libsumo missing" in doctor.sumo_versions().text


def test_sumo_home(monkeypatch, tmp_path):
    monkeypatch.delenv("SUMO_HOME", raising=False)
    assert doctor.sumo_home().state == "ok"
    monkeypatch.setenv("SUMO_HOME", str(tmp_path))
    (tmp_path / "bin").mkdir()
    found = doctor.sumo_home()
    assert (found.state, "has no libsumo in its folder" in found.text) == ("warning", True)
    monkeypatch.setenv("SUMO_HOME", str(tmp_path / "no"))
    assert "is not a folder" in doctor.sumo_home().text
    (tmp_path / "tools" / "libsumo").mkdir(parents=True)
    (tmp_path / "tools" / "libsumo" / "_libsumo.so").touch()
    monkeypatch.setenv("SUMO_HOME", str(tmp_path))
    assert doctor.sumo_home().text == f"{tmp_path} is used instead of the installed package"
    monkeypatch.setenv("SUMO_HOME", str(installed.package()))
    assert doctor.sumo_home() == CheckResult("ok", str(installed.package()))


def test_display(monkeypatch):
    monkeypatch.setattr(system, "NEEDS_DISPLAY", True)
    monkeypatch.setattr(doctor.subprocess, "run", _done)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert doctor.sumo_gui().state == "warning"
    monkeypatch.setenv("DISPLAY", ":7")
    assert doctor.sumo_gui() == CheckResult("ok", "starts, display :7")


def _done(command, **_):
    return subprocess.CompletedProcess(command, 0, stdout="/sumo\n", stderr="")


def _refused(command, **_):
    if command[0] == sys.executable:
        return _done(command)
    return subprocess.CompletedProcess(command, 127, stdout="", stderr="lib.so: not found\n")


def test_programs_without_their_libraries(monkeypatch):
    monkeypatch.setattr(doctor.subprocess, "run", _refused)
    found = doctor.netconvert()
    assert found.state == "broken"
    assert found.text == "networks cannot be built: lib.so: not found"
    assert doctor.sumo_gui().state == "warning"


def test_a_cache_that_cannot_be_written(monkeypatch, tmp_path):
    assert doctor.cache().state == "ok"
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("DEEPMF_SUMO_HOME", str(blocked))
    found = doctor.cache()
    assert found.state == "broken"
    assert "set DEEPMF_SUMO_HOME" in found.text


@pytest.mark.parametrize(
    ("free", "limit", "state"),
    [(8000.0, None, "ok"), (500.0, None, "warning"), (8000.0, 512.0, "warning")],
)
def test_memory(monkeypatch, free, limit, state):
    monkeypatch.setattr(doctor, "_free_mb", lambda: free)
    monkeypatch.setattr(doctor, "_limit_mb", lambda: limit)
    assert doctor.memory().state == state


def test_machine_is_read():
    assert doctor.cores().state == "ok"
    assert doctor._free_mb() is None or doctor._free_mb() > 0


BROKEN = {
    "libsumo.py": "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)",
    "torch.py": "raise OSError('libtorch.so: undefined symbol')",
    "matplotlib.py": "raise ImportError('_path failed to import')",
    "sumo.py": "raise ImportError('no binaries')",
}
"""Modules that stand before the installed ones, as broken wheels do."""


def test_broken_wheels_are_lines(tmp_path):
    for name, text in BROKEN.items():
        (tmp_path / name).write_text(text)
    done = subprocess.run(
        [sys.executable, "-m", "deepmf_sumo.cli.main", "doctor"], check=False,
        capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": str(tmp_path), "SUMO_HOME": ""},
    )  # fmt: skip
    assert done.returncode == 1
    assert not done.stderr
    bad = {line[5:20].strip(): line[20:] for line in done.stdout.splitlines() if line[:3] == "BAD"}
    assert bad.pop("weights open").startswith("OSError: libtorch.so: undefined symbol")
    missing = f"SUMO's program 'netconvert' is missing in {tmp_path / 'bin'}."
    assert bad == {
        "libsumo": "cannot be loaded: its process was ended by signal 11",
        "netconvert": f"networks cannot be built: {missing}",
        "networks": "cannot be loaded: OSError: libtorch.so: undefined symbol",
        "libraries": "cannot be loaded: ImportError: _path failed to import",
    }


def test_other_weights_are_named(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(doctor, "probe", lambda code: (True, "/weights/open"))
    (tmp_path / ".weights" / "mine").mkdir(parents=True)
    (tmp_path / ".weights" / "mine" / "opponent.json").write_text("{}")
    assert doctor.weights_of_set("open").text == "/weights/open; also there: mine"
    assert doctor.weights_of_set("mine").text == "/weights/open"


def test_the_command_goes_on_after_a_broken_line(monkeypatch, capsys):
    fine = CheckResult("ok", "fine")
    for name in ("libsumo", "netconvert", "sumo_gui", "networks", "libraries"):
        monkeypatch.setattr(doctor, name, lambda: fine)
    monkeypatch.setattr(doctor, "weights_of_set", lambda name: fine)
    assert main.run(["doctor"]) == 0
    monkeypatch.setattr(doctor, "networks", lambda: 1 / 0)
    assert main.run(["doctor"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert "BAD  networks       ZeroDivisionError: division by zero" in lines
    assert lines[-1].split()[1] == "cache"
