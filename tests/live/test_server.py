"""``deepmf-sumo serve``: clients that know nothing of it, and clients that misbehave."""

import csv
import functools
import json
import os
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import time
import urllib.error
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import pytest
import sumo
import traci
from traci import constants

import deepmf_sumo
from deepmf_sumo.cli import _leaving, main
from deepmf_sumo.errors import WeightsError, exit_code
from deepmf_sumo.live.attacker import AttackRequest, prepare
from deepmf_sumo.live.relay import CLOSE, GET_SIMULATION, LARGEST, LOAD, ORDER, STEP, _Filter
from deepmf_sumo.live.server import SumoServer, _finer

from tests.support.forked_workers import Command

pytestmark = pytest.mark.sumo

CLIENT = """
import json, sys, traci
api = traci.connect(int(sys.argv[1]), numRetries=50, waitBetweenRetries=0.1)
step, seen = float(sys.argv[2]), []
api.simulationStep()
api.vehicle.subscribe("leader", [0x42, 0x40])
api.vehicle.subscribeContext("av", 0xA4, 60.0, [0x40])
api.simulation.subscribe([0x66, 0x74, 0x73, 0x7A, 0x79, 0x6D])
api.route.add("way", ["ab"])
for late in (2.1, 2.3, 4.2):
    api.vehicle.add(f"late {late}", "way", depart=str(late), departPos="free")
while api.simulation.getTime() < 6.0:
    api.simulationStep(api.simulation.getTime() + step)
    seen.append([api.simulation.getTime(), sorted(
        (one, *api.vehicle.getPosition(one)) for one in api.vehicle.getIDList())])
    seen.append(repr(api.vehicle.getSubscriptionResults("leader")))
    seen.append(repr(api.vehicle.getContextSubscriptionResults("av")))
    seen.append(repr(api.simulation.getSubscriptionResults()))
seen.append(sorted(map(str, api.poi.getAllContextSubscriptionResults())))
json.dump(seen, open(sys.argv[3], "w"))
api.close()
"""
STEPS = ("--", "--step-length", "0.1")
OPTIONS = ["--no-warnings", "--no-step-log", "--step-length", "0.1", "--collision.action", "none"]


@pytest.fixture
def served(tiny, tmp_path):
    """Starts the command; gives the process and its port."""
    started = []

    def start(av="av", *more, status=False):
        process = Command(
            "serve", tiny / "tiny.sumocfg", "--port", "0", "--av", av,
            "--out", tmp_path / "live", *more, "--", *OPTIONS,
        )  # fmt: skip
        started.append(process)
        line, said = process.stderr.readline(), "localhost:" if status else "listening on port "
        return process, int(re.search(rf"{said}(\d+)", line)[1])

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.fixture
def talked(tiny, tmp_path, capsys):
    """Runs the command in this process, for a client in a thread; gives code and output."""

    def run(talk, *more):
        port = free_port()
        command = ["serve", tiny / "tiny.sumocfg", "--port", port, "--av", "nobody"]
        command += ["--out", tmp_path / "live", "--", *OPTIONS, *more]
        with ThreadPoolExecutor(1) as pool:
            client = pool.submit(lambda: talk(functools.partial(connection, port)))
            code = main.run(list(map(str, command)))
            client.result(timeout=60)
        return code, *capsys.readouterr()

    return run


def free_port():
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return probe.getsockname()[1]


def connection(port):
    """A connection to the command, which may not listen yet."""
    end = time.monotonic() + 60
    while True:
        try:
            return socket.create_connection(("localhost", port))
        except ConnectionRefusedError:
            assert time.monotonic() < end
            time.sleep(0.05)


def client(port, step, file):
    done = subprocess.run(
        [sys.executable, "-c", CLIENT, str(port), str(step), str(file)],
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(file.read_text())


def alone(tiny, step, file):
    """What the client sees of SUMO itself."""
    port = free_port()
    program = f"{sumo.SUMO_HOME}/bin/sumo"
    command = [program, "-c", tiny / "tiny.sumocfg", "--remote-port", str(port), *OPTIONS]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as server:
        found = client(port, step, file)
        assert server.wait(timeout=20) == 0
    return found


@pytest.mark.parametrize("step", [0.1, 0.5])
def test_without_attacks_a_client_sees_what_it_sees_of_sumo(tiny, served, tmp_path, step):
    process, port = served("nobody")
    seen = client(port, step, tmp_path / "served.json")
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0, out
    assert seen == alone(tiny, step, tmp_path / "alone.json")


SECONDS = """
import json, sys, traci
api = traci.connect(int(sys.argv[1]), numRetries=50, waitBetweenRetries=0.1)
own, seen = len(sys.argv) == 3, []
for second in range(1, 13):
    api.simulationStep(*() if own else (float(second),))
    seen.append([api.simulation.getTime(), api.simulation.getDepartedIDList(), sorted(
        (one, *api.vehicle.getPosition(one)) for one in api.vehicle.getIDList())])
steps = [api.simulation.getDeltaT(), float(api.simulation.getOption("step-length"))]
json.dump([steps, api.simulation.getOption("seed"), seen], open(sys.argv[2], "w"))
api.close()
"""


def by_seconds(port, file, *more):
    command = [sys.executable, "-c", SECONDS, str(port), str(file), *more]
    subprocess.run(command, check=True, timeout=60)
    return json.loads(file.read_text())


@pytest.mark.parametrize("named", [False, True])
def test_a_client_whose_steps_are_seconds_sees_sumo_at_steps_of_01(tiny, tmp_path, named):
    """Its steps are SUMO's default, or stated; the twin asks SUMO for each second by its time."""
    places = ["-n", tiny / "tiny.net.xml", "-r", tiny / "tiny.rou.xml"] if named else []
    config, options = [] if named else [tiny / "tiny.sumocfg"], OPTIONS[:2] + OPTIONS[4:]
    process = Command(
        "serve", *config, "--port", "0", "--av", "nobody", "--out", tmp_path / "live",
        "--", *places, *options, *(["--step-length", "1"] if named else []),
    )  # fmt: skip
    port = int(re.search(r"listening on port (\d+)", process.stderr.readline())[1])
    steps_s, *seen = by_seconds(port, tmp_path / "served.json")
    _, told = process.communicate(timeout=60)
    assert process.returncode == 0, told
    assert "SUMO steps by 0.1 s in place of 1 s" in told
    assert steps_s == [1.0, 1.0]

    port = free_port()
    command = [f"{sumo.SUMO_HOME}/bin/sumo", *(places or ["-c", tiny / "tiny.sumocfg"]), *OPTIONS]
    with subprocess.Popen([*command, "--remote-port", str(port)], stdout=subprocess.DEVNULL):
        assert [[0.1, 0.1], *seen] == by_seconds(port, tmp_path / "alone.json", "timed")


@pytest.mark.parametrize("words", [["--step-length", "1"], ["--step-length=1"], []])
def test_only_the_step_length_changes(tmp_path, words):
    """Another option may have the same value, before it or behind it."""
    given = ["-n", "a.net.xml", "--seed", "1", *words, "--scale", "1"]
    assert _finer(given) == (
        ["-n", "a.net.xml", "--seed", "1", "--scale", "1", "--step-length", "0.1"], 1.0,
    )  # fmt: skip
    config = tmp_path / "a.sumocfg"
    config.write_text('<configuration><time><step-length value="0.5"/></time></configuration>')
    for more, step_s in (([], 0.5), (["--step-length", "2"], 2.0)):
        found = ["-c", str(config), "--step-length", "0.1"], step_s
        assert _finer(["-c", str(config), *more]) == found
    for fine in ("0.1", "0.05", "0.01", "soon"):
        assert _finer(["--step-length", fine]) == (["--step-length", fine], None)


def test_a_client_that_loads_has_the_steps_that_it_loads(tiny, tmp_path):
    """First SUMO's own steps of 0.1 s, then, after a load, those of a second."""
    process = Command(
        "serve", tiny / "tiny.sumocfg", "--port", "0", "--av", "nobody",
        "--out", tmp_path / "live", "--", *OPTIONS,
    )  # fmt: skip
    port = int(re.search(r"listening on port (\d+)", process.stderr.readline())[1])
    api = traci.connect(port, numRetries=50, waitBetweenRetries=0.1)
    api.simulationStep()
    assert (api.simulation.getTime(), api.simulation.getDeltaT()) == (0.1, 0.1)
    api.load(["-c", str(tiny / "tiny.sumocfg"), *OPTIONS[:2], *OPTIONS[4:]])
    api.simulationStep()
    assert (api.simulation.getTime(), api.simulation.getDeltaT()) == (1.0, 1.0)
    api.close()
    _, told = process.communicate(timeout=60)
    assert (process.returncode, told.count("SUMO steps by 0.1 s")) == (0, 1), told
    assert json.loads((tmp_path / "live" / "session.json").read_text())["client_step_s"] == 1.0


def test_nonsense_from_a_client_of_seconds_reaches_sumo(tiny, tmp_path):
    """A question without content, a step without a time, one to no number: as with SUMO alone."""
    numbers = [bytes((2, GET_SIMULATION)), bytes((2, STEP)), b"\x0a\x02" + b"\x7f\xf8" + bytes(6)]
    for each in numbers:
        sumo_double = SimpleNamespace(step_s=1.0, asked=lambda commands, **_: b"SUMO" + commands)
        passed = _Filter(sumo_double, tmp_path).answered(each)
        assert passed == b"SUMO" + each


def test_a_vehicle_is_attacked_within_the_seconds_of_its_client(tiny, tmp_path):
    process = Command(
        "serve", tiny / "tiny.sumocfg", "--port", "0", "--av", "av", "--out", tmp_path / "live",
        "--duration", "3", "--set", "live.pause_s=0", "--set", "adversary=G",
        "--", *OPTIONS[:2], *OPTIONS[4:],
    )  # fmt: skip
    port = int(re.search(r"listening on port (\d+)", process.stderr.readline())[1])
    by_seconds(port, tmp_path / "seen.json")
    _, told = process.communicate(timeout=60)
    assert process.returncode == 0, told
    attacks = (tmp_path / "live" / "attacks.jsonl").read_text().splitlines()
    assert json.loads(attacks[0])["opponent"] == "leader"
    assert json.loads((tmp_path / "live" / "session.json").read_text())["client_step_s"] == 1.0


def test_its_vehicle_is_attacked(served, tmp_path):
    process, port = served(
        "av", "--duration", "3", "--set", "live.pause_s=0", "--set", "adversary=G"
    )
    seen = client(port, 0.1, tmp_path / "seen.json")
    out, told = process.communicate(timeout=60)
    assert process.returncode == 0, told
    assert "the script left at 6.0 s" in out
    assert (tmp_path / "live" / "runs.csv").is_file()
    rows = (tmp_path / "live" / "attacks.jsonl").read_text().splitlines()
    assert json.loads(rows[0])["opponent"] == "leader"
    assert seen[-1] == []  # nothing of what the attack has subscribed to


LIBTRACI = r"""
#include <libsumo/libtraci.h>
#include <cstdio>
#include <cstdlib>
using namespace libtraci;
int main(int, char** argv) {
    Simulation::init(std::atoi(argv[1]), 50);
    Vehicle::subscribeContext("av", libsumo::CMD_GET_VEHICLE_VARIABLE, 60.0, {libsumo::VAR_SPEED});
    for (int step = 0; step < 60; ++step) {
        Simulation::step();
        for (const auto& one : Vehicle::getIDList()) {
            const auto at = Vehicle::getPosition(one);
            std::printf("at %s %.17g %.17g\n", one.c_str(), at.x, at.y);
        }
        std::printf("at %zu\n", Vehicle::getContextSubscriptionResults("av").size());
    }
    Simulation::close();
}
"""


@pytest.mark.skipif(shutil.which("g++") is None, reason="there is no C++ compiler")
def test_a_client_of_sumos_cpp_library_sees_what_it_sees_of_sumo(tiny, served, tmp_path):
    home = Path(sumo.SUMO_HOME)
    (tmp_path / "client.cpp").write_text(LIBTRACI)
    library = [f"-L{home}/lib64", "-ltracicpp", f"-Wl,-rpath,{home}/lib64"]
    subprocess.run(
        ["g++", "-O0", "-o", "client", "client.cpp", f"-I{home}/include", *library],
        cwd=tmp_path, check=True, capture_output=True,
    )  # fmt: skip

    def seen(port):
        program = [tmp_path / "client", str(port)]
        told = subprocess.run(program, check=True, capture_output=True, timeout=60).stdout
        return [line for line in told.splitlines() if line.startswith(b"at ")]

    process, port = served("nobody")
    behind = seen(port)
    process.communicate(timeout=60)
    own = free_port()
    command = [home / "bin/sumo", "-c", tiny / "tiny.sumocfg", "--remote-port", str(own), *OPTIONS]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL):
        assert seen(own) == behind
    assert any(b"leader" in line for line in behind)


SCRIPT = """
import sys, traci
traci.start([*sys.argv[1:]])
for _ in range(20):
    traci.simulationStep()
print(traci.simulation.getTime())
traci.close()
"""


@pytest.mark.parametrize("options", [[], ["--", *OPTIONS]], ids=["none", "of SUMO"])
def test_a_script_that_starts_sumo_itself_can_start_serve(tiny, tmp_path, options):
    config = tmp_path / "tenths.sumocfg"
    config.write_text(
        f'<configuration><input><net-file value="{tiny / "tiny.net.xml"}"/>'
        f'<route-files value="{tiny / "tiny.rou.xml"}"/></input>'
        '<time><step-length value="0.1"/></time></configuration>'
    )
    command = [
        sys.executable, "-c", SCRIPT, Path(sys.executable).with_name("deepmf-sumo"), "serve",
        config, "--av", "nobody", "--out", tmp_path / "live", *options,
    ]  # fmt: skip
    done = subprocess.run(
        list(map(str, command)), capture_output=True, text=True, check=False, timeout=60
    )
    assert (done.returncode, "2.0" in done.stdout.split("\n")) == (0, True), done.stderr


def test_broken_weights_are_said_before_anybody_can_connect(tiny, tmp_path):
    """The predictors are loaded only where an attack begins."""
    weights = tmp_path / "weights"
    shutil.copytree(Path(deepmf_sumo.__file__).parent / "weights" / "open", weights)
    (weights / "conditional.safetensors").write_bytes(b"nothing")
    process = Command(
        "serve", tiny / "tiny.sumocfg", "--port", "0", "--av", "av", "--out", tmp_path / "live",
        "--set", f"weights={weights}",
    )  # fmt: skip
    said = process.communicate(timeout=60)[1]
    assert process.returncode == exit_code("wrong")
    assert "conditional.safetensors" in said
    assert "listening" not in said
    assert "Traceback" not in said
    assert not (tmp_path / "live").exists()


def command(number, content=b""):
    return bytes((2 + len(content), number)) + content


def message(*commands):
    body = b"".join(commands)
    return struct.pack("!i", len(body) + 4) + body


def test_several_commands_in_one_message_are_answered_in_one(talked):
    step = command(0x02, struct.pack("!d", 0.0))
    order = command(0x03, struct.pack("!i", 7))

    def talk(connect):
        with connect() as connection:
            connection.sendall(message(order, step, command(0x00)))
            (length,) = struct.unpack("!i", connection.recv(4))
            answer = b""
            while len(answer) < length - 4:
                answer += connection.recv(4096)
            statuses = [(answer[at + 1], answer[at + 2]) for at in (0, 7)]
            assert statuses == [(0x03, 0x00), (0x02, 0x00)]
            at = 7 + 7 + 4  # the number of subscriptions is behind the step
            assert answer[at + 1] == 0x00
            connection.sendall(message(command(0x7F)))
            connection.recv(4096)

    code, _, told = talked(talk)
    assert code == 0, told


def string(text):
    return struct.pack("!i", len(text)) + text


def well_formed(number):
    """A command of this number that asks for nothing: the answer says that, or that it is none."""
    context = number in range(0x80, 0x90) or number in range(0x04, 0x0C)
    if context or number in range(0xD0, 0xE0) or number in range(0x54, 0x5C):  # a subscription
        more = b"\xa4" + struct.pack("!d", 1.0) if context else b""
        content = struct.pack("!dd", 0.0, 1.0) + string(b"nobody") + more + b"\0"
    elif number in {0x00, 0x7D}:
        content = b""
    else:
        content = b"\x01" + string(b"nobody")
    return command(number, content)


def answers(connection, commands):
    """What is answered to each of them."""
    found = []
    connection.settimeout(60)
    for one in commands:
        connection.sendall(message(one))
        answer = b""
        while len(answer) < 4 or len(answer) < struct.unpack_from("!i", answer)[0]:
            piece = connection.recv(65536)
            if not piece:
                return found
            answer += piece
        found.append((f"0x{one[1]:02x}", answer[4:]))
    return found


def test_each_command_of_the_protocol_is_answered_as_sumo_answers_it(tiny, talked):
    names = {value for name, value in vars(constants).items() if name.startswith("CMD_")}
    numbers = sorted(names - {LOAD, STEP, ORDER, CLOSE, 0x7E, 0x7D})
    assert len(numbers) > 70
    step = command(STEP, struct.pack("!d", 0.0))
    asked = [step, *map(well_formed, numbers), step, command(CLOSE)]
    found = []

    def talk(connect):
        with connect() as connection:
            found.extend(answers(connection, asked))

    code, _, told = talked(talk)
    assert code == 0, told
    port = free_port()
    program = [f"{sumo.SUMO_HOME}/bin/sumo", "-c", tiny / "tiny.sumocfg", *OPTIONS]
    with (
        subprocess.Popen([*program, "--remote-port", str(port)], stdout=subprocess.DEVNULL),
        connection(port) as own,
    ):
        expected = answers(own, asked)
    assert len(expected) == len(asked)
    assert found == expected


LOADING = """
import json, sys, traci
api, seen = traci.connect(int(sys.argv[1]), numRetries=50, waitBetweenRetries=0.1), []
def go(until_s):
    while api.simulation.getTime() < until_s:
        api.simulationStep()
        seen.append([api.simulation.getTime(), sorted(
            (one, *api.vehicle.getPosition(one)) for one in api.vehicle.getIDList())])
for turn in range(3):
    go(1.0 + turn)
    api.load(json.loads(sys.argv[2]))
go(6.0)
json.dump(seen, open(sys.argv[3], "w"))
api.close()
"""


def loading(port, tiny, file):
    options = [*OPTIONS, "--remote-port", "8813", "--num-clients=1"]  # which SUMO's load ignores
    options = json.dumps(["-c", str(tiny / "tiny.sumocfg"), *options])
    done = subprocess.run(
        [sys.executable, "-c", LOADING, str(port), options, str(file)],
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(file.read_text())


def test_a_client_that_loads_sees_what_it_sees_of_sumo(tiny, served, tmp_path):
    process, port = served("nobody")
    seen = loading(port, tiny, tmp_path / "served.json")
    out, told = process.communicate(timeout=60)
    assert process.returncode == 0, out
    assert told.count("the client has loaded another simulation") == 3
    own = free_port()
    program = [f"{sumo.SUMO_HOME}/bin/sumo", "-c", tiny / "tiny.sumocfg", *OPTIONS]
    with subprocess.Popen([*program, "--remote-port", str(own)], stdout=subprocess.DEVNULL):
        assert seen == loading(own, tiny, tmp_path / "alone.json")


def test_attacks_go_on_in_the_simulation_that_is_loaded(tiny, served, tmp_path):
    wish = [
        "--duration",
        "3",
        "--set",
        "live.pause_s=0",
        "--set",
        "live.attacks=2",
        "--set",
        "adversary=G",
    ]
    process, port = served("av", *wish)
    loading(port, tiny, tmp_path / "seen.json")
    out, told = process.communicate(timeout=60)
    assert process.returncode == 0, told
    rows = [json.loads(one) for one in (tmp_path / "live/attacks.jsonl").read_text().splitlines()]
    assert [row["number"] for row in rows] == list(range(1, len(rows) + 1))
    assert 0 < len(rows) <= 2
    assert {row["simulation"] for row in rows} <= {2, 3, 4}  # the first one is over too soon
    assert {row["opponent"] for row in rows} == {"leader"}
    assert out.count("the script left") == 1
    lines = csv.DictReader((tmp_path / "live/runs.csv").read_text().splitlines())
    scenes = [line["scene"] for line in lines]
    assert scenes == [f"{row['simulation']}-av-{row['begin_s']:g}s" for row in rows]
    session = json.loads((tmp_path / "live/session.json").read_text())
    assert (session["simulations"], session["attacks"]) == (4, len(rows))
    assert (tmp_path / "live/runs/attack-001/sumo/net.net.xml").is_file()


def load_in_vain(content, connect):
    """A step, and then a load that ends the connection."""
    with connect() as connection:
        connection.sendall(message(command(0x02, struct.pack("!d", 0.0))))
        connection.recv(4096)
        connection.sendall(message(command(0x01, content)))
        assert connection.recv(4096) == b""


@pytest.mark.parametrize(
    "content",
    [
        b"",
        struct.pack("!i", 0),
        b"\x0e" + struct.pack("!ii", 1, 99) + b"-c",
        b"\x0e" + struct.pack("!ii", 2**31 - 1, -4),
        b"\x0e" + struct.pack("!ii", 1, 3) + b"a\0b",
    ],
)
def test_what_is_no_list_to_load_is_refused(talked, content):
    code, _, told = talked(functools.partial(load_in_vain, content))
    assert code == 0
    assert "load is not followed by a list of strings" in told


def test_a_simulation_that_cannot_be_loaded_ends_the_service(talked):
    words = [b"-c", b"nowhere.sumocfg"]
    listed = b"".join(struct.pack("!i", len(one)) + one for one in words)
    content = b"\x0e" + struct.pack("!i", len(words)) + listed
    code, _, told = talked(functools.partial(load_in_vain, content))
    assert code == exit_code("failed")
    assert "SUMO ended with exit code 1" in told


def test_routes_that_sumo_refuses_are_told_as_the_end_of_sumo(talked, tmp_path):
    def talk(connect):
        with connect() as connection, suppress(ConnectionError):
            connection.sendall(message(command(0x02, struct.pack("!d", 0.0))))
            assert connection.recv(4096) == b""

    routes = tmp_path / "bad.rou.xml"
    routes.write_text('<routes><trip id="a" depart="0" from="nowhere" to="neither"/></routes>')
    code, _, told = talked(talk, "--route-files", routes)
    assert code == exit_code("failed")
    assert "SUMO ended with exit code 1" in told
    assert "--order" not in told


@pytest.mark.parametrize(
    ("bytes_", "told"),
    [
        (struct.pack("!i", LARGEST + 9), "is not TraCI"),
        (struct.pack("!i", 12) + b"\x08\x02\x00", "in the middle of a message"),
        (struct.pack("!i", 8) + b"\x09\x02\x00\x00", "longer than its message"),
        (b"", None),
    ],
)
def test_a_client_that_misbehaves_or_dies_is_told_and_sumo_ends_well(talked, bytes_, told):
    def talk(connect):
        with connect() as connection:
            connection.sendall(message(command(0x02, struct.pack("!d", 0.0))))
            assert connection.recv(4096)
            connection.sendall(bytes_)

    code, out, errors = talked(talk)
    assert code == 0, errors
    assert "Traceback" not in errors
    assert "the script left" in out
    assert told is None or told in errors


@pytest.mark.parametrize("bytes_", [b"", b"GET / HTTP/1.1\r\n\r\n", struct.pack("!i", 8)])
def test_a_client_that_leaves_before_its_first_step_starts_nothing(served, tmp_path, bytes_):
    process, port = served("av", "--duration", "3")
    with socket.create_connection(("localhost", port)) as client:
        client.sendall(bytes_)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 3, errors
    assert "the client left before its first step: nothing happened" in errors
    session = json.loads((tmp_path / "live/session.json").read_text())
    assert (session["ended"], session["switches"]) == ("script_left", [])  # no signal came
    assert not [*tmp_path.glob("live/runs/attack-*")]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--trigger", "foo=1"), "foo"),
        (("--set", "adversary.version=Q9"), "Q9"),
        (("--set", "weights=none"), "There are no weights 'none'"),
    ],
)
def test_errors_of_the_command_show_before_a_client_can_come(tiny, tmp_path, capsys, options, told):
    assert serve(tiny, tmp_path, "--port", 0, *options, *STEPS) == 2
    found = capsys.readouterr().err
    assert told in found
    assert "listening" not in found


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("DEEPMF_SUMO_DEVICE", "gpu", "DEEPMF_SUMO_DEVICE is 'gpu'"),
        ("DEEPMF_SUMO_RUNTIME", "onnx", "opponent.onnx is missing"),
    ],
)
def test_what_computes_the_networks_is_checked_before_a_client_can_come(
    tiny, tmp_path, capsys, monkeypatch, name, value, told
):
    """A set needs the files of what computes it, and no others."""
    monkeypatch.setenv(name, value)
    weights = tmp_path / "weights"
    shutil.copytree(Path(deepmf_sumo.__file__).parent / "weights" / "open", weights)
    options = ("--set", f"weights={weights}", *STEPS)
    (weights / "opponent.onnx").unlink()
    assert serve(tiny, tmp_path, "--port", 0, *options) == 2
    found = capsys.readouterr().err
    assert told in found
    assert "listening" not in found


def test_a_set_of_graphs_alone_is_whole_where_onnx_computes(tmp_path, monkeypatch):
    weights = tmp_path / "weights"
    shutil.copytree(
        Path(deepmf_sumo.__file__).parent / "weights" / "open", weights,
        ignore=shutil.ignore_patterns("*.safetensors"),
    )  # fmt: skip
    wish = AttackRequest(avs=("av",), sets=(f"weights={weights}",))
    with pytest.raises(WeightsError, match="safetensors is missing"):
        prepare(wish, tmp_path / "torch")
    monkeypatch.setenv("DEEPMF_SUMO_RUNTIME", "onnx")
    prepare(wish, tmp_path / "onnx").close()


def test_an_edge_that_is_not_there_ends_everybody(served):
    process, port = served("av", "--trigger", "edge=nowhere")
    with socket.create_connection(("localhost", port)) as client:
        client.sendall(message(command(0x02, struct.pack("!d", 0.0))))
        _, errors = process.communicate(timeout=30)
        assert process.returncode == 2, errors
        assert "the network has no such edge" in errors
        client.settimeout(10)
        while client.recv(4096):  # until SUMO is gone
            pass


def test_status_and_a_switch_over_http(served, tmp_path):
    """New attacks are off before the first step: none begins; then they are on: one does."""

    def ask(path, method="GET"):
        request = urllib.request.Request(f"http://localhost:{http}{path}", method=method)
        with urllib.request.urlopen(request, timeout=20) as answer:
            return answer.read().decode()

    process, port = served(
        "av", "--duration", "3", "--set", "live.pause_s=0", "--set", "live.http=0", status=True
    )
    http, port = port, int(re.search(r"port (\d+)", process.stderr.readline())[1])
    (waiting,) = json.loads(ask("/status"))["avs"]
    assert waiting == {"av": "av", "last_failure": "the first step has not come yet"}
    with pytest.raises(urllib.error.HTTPError, match="409"):
        ask("/stop", "POST")
    step = message(command(0x02, struct.pack("!d", 0.0)))

    def steps(connection, count):
        for _ in range(count):
            connection.sendall(step)
            assert connection.recv(4096)

    with socket.create_connection(("localhost", port)) as connection:
        steps(connection, 3)
        assert json.loads(ask("/stop", "POST"))["new_attacks"] == "off"
        steps(connection, 30)
        found = json.loads(ask("/status"))
        (of_av,) = found["avs"]
        assert (of_av["attacks"], of_av["attacking"]) == (0, None)
        assert found["time_s"] == pytest.approx(3.3, abs=0.15)
        assert json.loads(ask("/start", "POST"))["new_attacks"] == "on"
        steps(connection, 60)
        (of_av,) = json.loads(ask("/status"))["avs"]
        assert of_av["attacks"] or of_av["attacking"]
        assert "<title>deepmf-sumo" in ask("/")
        with pytest.raises(urllib.error.HTTPError, match="404"):
            ask("/nowhere")
        connection.sendall(message(command(0x7F)))
        connection.recv(4096)
    out, told = process.communicate(timeout=30)
    assert process.returncode == 0
    switches = json.loads((tmp_path / "live/session.json").read_text())["switches"]
    assert [(one["new_attacks"], one["door"]) for one in switches] == [
        ("off", "HTTP"),
        ("on", "HTTP"),
    ]
    assert "s: new attacks on 'av' are off (HTTP)" in told
    assert "new attacks on 'av' were off from" in out


ADDS = """
import sys, traci
api = traci.connect(int(sys.argv[1]), numRetries=50, waitBetweenRetries=0.1)
for step in range(30):
    if step == 5:
        api.route.add("way", ["ab"])
        api.vehicle.add("av", "way", departPos="20")
    api.simulationStep()
print(api.vehicle.getIDList())
api.close()
"""


def test_a_client_may_add_its_vehicle_later(tiny, tmp_path):
    """SUMO's traffic is over, as far as SUMO knows, before the vehicle comes."""
    config = tmp_path / "empty.sumocfg"
    net = tiny / "tiny.net.xml"
    config.write_text(f'<configuration><input><net-file value="{net}"/></input></configuration>')
    process = Command(
        "serve", config, "--port", "0", "--av", "av", "--out", tmp_path / "live", "--", *OPTIONS
    )
    port = re.search(r"port (\d+)", process.stderr.readline())[1]
    script = [sys.executable, "-c", ADDS, port]
    done = subprocess.run(script, capture_output=True, text=True, check=False, timeout=60)
    _, told = process.communicate(timeout=60)
    assert ("('av',)" in done.stdout, process.returncode) == (True, 0), (done.stderr, told)


def test_a_client_that_keeps_its_socket_after_closing_is_let_go(talked):
    step = command(0x02, struct.pack("!d", 0.0))

    def talk(connect):
        with connect() as connection:
            connection.settimeout(30)
            connection.sendall(message(step))
            assert connection.recv(4096)
            connection.sendall(message(command(0x7F)))
            while connection.recv(4096):  # until the other side closes
                pass

    code, _, told = talked(talk)
    assert code == 0, told


def test_a_signal_before_a_client_comes_ends_sumo_too(served):
    process, _ = served()
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=30)
    assert process.returncode == 130


def test_the_process_that_relays_begins_without_hearing_of_ctrl_c(tiny, tmp_path, monkeypatch):
    """A terminal sends it to all processes; one that loads would print where it was."""
    monkeypatch.chdir(tiny)
    with SumoServer(tiny / "tiny.sumocfg", 0, tmp_path) as server:
        for _ in range(3):
            os.kill(server._relay.pid, signal.SIGINT)
            time.sleep(0.3)
        assert server._relay.is_alive()


@pytest.mark.skipif(sys.platform == "win32", reason="its processes have no groups")
def test_nothing_is_left_where_the_command_is_killed(served):
    process, port = served()
    process.kill()
    process.communicate(timeout=30)
    end = time.monotonic() + 30
    while time.monotonic() < end:
        try:
            with socket.create_connection(("localhost", port)):
                time.sleep(0.2)
        except OSError:
            return
    raise AssertionError("the port is still open")


@pytest.mark.parametrize("last", [b"", b"\x08\xa4\x00" + struct.pack("!i", 0) + b"x"])
def test_one_sigterm_ends_it_while_the_client_is_idle_or_sumo_hangs(
    talked, tmp_path, monkeypatch, last
):
    monkeypatch.setattr(_leaving, "_IDLE_S", 0.3)
    monkeypatch.setattr(_leaving, "_LOOK_S", 0.05)

    def talk(connect):
        with connect() as connection:
            for _ in range(3):
                connection.sendall(message(command(STEP, struct.pack("!d", 0.0))))
                assert connection.recv(4096)
            if last:
                connection.sendall(message(last))
            os.kill(os.getpid(), signal.SIGTERM)
            connection.settimeout(30)
            with suppress(ConnectionError):
                assert connection.recv(4096) == b""  # SUMO has ended

    code, _, told = talked(talk)
    assert code == exit_code("interrupted"), told
    session = json.loads((tmp_path / "live/session.json").read_text())
    assert (session["ended"], session["switches"][0]["door"]) == ("stopped", "signal")
    assert session["time_s"] > 0


def test_a_second_client_is_turned_away(talked):
    def talk(connect):
        with connect() as connection:
            connection.sendall(message(command(0x02, struct.pack("!d", 0.0))))
            assert connection.recv(4096)
            with connect() as other:
                assert other.recv(10) == b""
            connection.sendall(message(command(0x7F)))
            connection.recv(4096)

    code, _, told = talked(talk)
    assert (code, "a second client was turned away" in told) == (0, True)


def test_what_cannot_begin_is_one_sentence(tiny, tmp_path, capsys):
    with socket.socket() as taken:
        taken.bind(("localhost", 0))
        taken.listen()
        port = taken.getsockname()[1]
        code, told = serve(tiny, tmp_path, "--port", port, *STEPS), capsys.readouterr().err
    assert (code, told.count("\n")) == (2, 1)
    assert f"--port {port} cannot be used" in told
    for words in (["--step-length", "0.04"], ["--step-length=0"], ["-n", "x", "--step-length=.25"]):
        assert serve(tiny, tmp_path, "--port", 0, "--", *words) == 2
        assert "start SUMO with --step-length 0.1" in capsys.readouterr().err
    assert serve(tiny, tmp_path, "--port", 0, *STEPS, "--no-such-option", "1") == 3
    assert "SUMO ended with exit code 1" in capsys.readouterr().err


def serve(tiny, tmp_path, *more):
    command = ["serve", tiny / "tiny.sumocfg", "--av", "av", "--out", tmp_path / "live", *more]
    return main.run(list(map(str, command)))
