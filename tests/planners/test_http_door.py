"""A server as the planner: equal tracks, and servers that misbehave."""

import contextlib
import json
import socket
import threading
import time
import urllib.error
import urllib.request

import numpy as np
import pytest

from deepmf_sumo import plugins
from deepmf_sumo.errors import PlannerError, PluginError
from deepmf_sumo.planners import http, idm
from deepmf_sumo.planners.remote import serve
from deepmf_sumo.sumo.simulation import network_case, simulate

from tests.support.tiny_network import build

READY = b'{"type": "ready", "protocol": 1}'


@pytest.fixture(scope="module")
def config(tmp_path_factory, starts_sumo):
    return build(tmp_path_factory.mktemp("tiny"))


def drive(config, planner, steps=60):
    case = network_case(config, 3.0, "av", steps, seed=0)
    return simulate(case, planner, None, rng=np.random.default_rng(0))


@contextlib.contextmanager
def serving(values):
    server = serve.on_port(serve.Answerer("idm", values), 0)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def test_the_same_idm_through_the_door_drives_the_same(config):
    values = {"perception": "corridor"}
    direct = drive(config, idm.build(idm.Settings(**values)))
    with serving(values) as url:
        planner = http.build(http.Settings(url=url, step_budget_s=10.0))
        for _ in range(2):  # the server goes on after an episode
            through = drive(config, planner)
            assert direct.tracks.position_m.tobytes() == through.tracks.position_m.tobytes()
            assert direct.leaders == through.leaders


def test_a_server_that_does_not_know_the_episode_says_so(config):
    with serving({}) as url:
        server = http.HttpConnection("it", url)
        view = {
            "type": "view", "episode": "other", "step": 3, "dt_s": 0.1, "steps_left": 1,
            "av_id": "av", "agents": [], "signals": {}, "av_path_m": None,
        }  # fmt: skip
        with pytest.raises(PlannerError, match=r"status 400: .*'other' before its reset"):
            server.ask("act", json.dumps(view).encode(), 5.0, "step 3")
        server.close()


@pytest.mark.parametrize("length", ["abc", "1e12", "-1", "1000000000000", "\u0663", "9" * 5000, ""])
def test_a_question_of_a_length_that_is_none_is_a_clean_400(length):
    server = serve.on_port(serve.Answerer("idm", {}), 0)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        for _ in range(2):  # it goes on
            with socket.create_connection(("127.0.0.1", server.server_port), timeout=10) as client:
                host = f"Host: localhost:{server.server_port}"
                head = f"POST / HTTP/1.1\r\n{host}\r\nContent-Length: {length}\r\n\r\n"
                client.sendall(head.encode())
                answer = b"".join(iter(lambda: client.recv(65536), b""))
            assert answer.startswith(b"HTTP/1.1 400 ")
            assert b"it must be a number of bytes" in answer
    finally:
        server.shutdown()
        server.server_close()


def response(body: bytes, status: str = "200 OK") -> bytes:
    return f"HTTP/1.1 {status}\r\nContent-Length: {len(body)}\r\n\r\n".encode() + body


def command(**changes) -> bytes:
    good = {"type": "command", "step": 10, "kind": "speed", "speed_mps": 5.0}
    return response(json.dumps(good | changes).encode())


def drip(connection):
    connection.sendall(b"HTTP/1.1 200 OK\r\n")
    with contextlib.suppress(OSError):
        while True:  # a byte at a time is no progress
            connection.sendall(b"X")
            time.sleep(0.05)


def gigabyte(connection):
    connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 1000000000\r\n\r\n")
    with contextlib.suppress(OSError):
        for _ in range(1000):
            connection.sendall(b"x" * 1_000_000)


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda connection: time.sleep(1.5), "did not answer step 10 within 0.8 s"),
        (drip, "did not answer step 10 within 0.8 s"),
        (gigabyte, "answered step 10 with more than 65536 bytes"),
        (lambda connection: connection.close(), "cannot be asked for step 10"),
        (response(b"a bug", "500 Internal Server Error"), "with status 500: b'a bug'"),
        (response(b"hello"), "answered 'hello', which is not JSON"),
        (b"hello\r\n\r\n", "cannot be asked for step 10: "),
        (command(speed_mps=1e9), "less than or equal to 150"),
        (command(speed_mps=float("nan")), "finite number"),
        (command(step=9), "answered for step 9 when asked for step 10"),
        (response(b"[1, 2]"), "is not a JSON object"),
        (response(b"", "302 Found"), "with status 302"),
    ],
)
def test_a_hostile_server_is_a_clear_error(config, act, message):
    with socket.create_server(("127.0.0.1", 0)) as listening:
        thread = threading.Thread(target=_misbehave, args=(listening, act))
        thread.start()
        url = f"http://127.0.0.1:{listening.getsockname()[1]}"
        planner = http.build(http.Settings(url=url, step_budget_s=0.8))
        begin = time.monotonic()
        with pytest.raises(PlannerError, match=r"^planner_error: server http://127") as found:
            drive(config, planner, 5)
        thread.join()
    assert message in str(found.value)
    assert time.monotonic() - begin < 10.0


def _misbehave(listening, act):
    connection, _ = listening.accept()
    with connection:
        _question(connection)
        connection.sendall(response(READY))
        _question(connection)
        if callable(act):
            act(connection)
        else:
            connection.sendall(act)


def _question(connection):
    """Read one whole request."""
    text = b""
    while b"\r\n\r\n" not in text:
        text += connection.recv(65536)
    head, _, body = text.partition(b"\r\n\r\n")
    length = int(head.lower().partition(b"content-length: ")[2].split(b"\r\n")[0])
    while len(body) < length:
        body += connection.recv(65536)


def test_nobody_listens(config):
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
    planner = http.build(http.Settings(url=f"http://127.0.0.1:{port}"))
    with pytest.raises(PlannerError, match=r"cannot be asked for the reset: .*refused"):
        drive(config, planner)


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("127.0.0.1:80", "must be like http"),
        ("http://127.0.0.1", "must be like http"),
        ("http://127.0.0.1:99999", "must be like http"),
        ("https://127.0.0.1:80", "must be like http"),
        ("http://10.0.0.1:80", "is not on this machine"),
    ],
)
def test_addresses_that_are_refused(url, message):
    with pytest.raises(PluginError, match=message):
        plugins.settings("planners", "http", {"url": url})


RESET = {
    "type": "reset", "protocol": 1, "episode": "e", "case": "c", "seed": 1, "av_id": "av",
    "dt_s": 0.1, "steps": 10, "own_lane": False, "road": None,
}  # fmt: skip
AGENT = {
    "id": "av", "kind": "vehicle", "size_m": [4.0, 2.0, 1.5], "x_m": [0.0], "y_m": [0.0],
    "z_m": [0.0], "heading_rad": [0.0], "vx_mps": [1.0], "vy_mps": [0.0], "valid": [True],
}  # fmt: skip
LONGER = {name: value * 2 for name, value in AGENT.items() if name not in {"id", "kind", "size_m"}}
VIEW = {
    "type": "view", "episode": "e", "step": 0, "dt_s": 0.1, "steps_left": 1, "av_id": "av",
    "agents": [AGENT], "signals": {}, "av_path_m": None,
}  # fmt: skip


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (RESET | {"seed": -5}, "seed is -5; it must be 0 or more"),
        (VIEW | {"agents": [AGENT | {"y_m": [1.0, 2.0]}]}, "y_m of 'av' has 2 numbers, and valid"),
        (VIEW | {"agents": [AGENT | {"size_m": [1.0]}]}, "size_m of 'av' has 1 numbers, not 3"),
        (VIEW | {"agents": [AGENT, AGENT | LONGER]}, "different numbers of steps: [1, 2]"),
        (VIEW | {"av_path_m": [[1.0, 2.0], [3.0]]}, "ValueError"),
        (VIEW | {"signals": {"lane": "purple"}}, "KeyError"),
    ],
)
def test_a_question_that_cannot_be_answered_is_a_400(message, said, capfd):
    with serving({}) as url:
        for question, status in ((RESET, 200), (message, 400), (VIEW, 200)):
            found = asked(url, question)
            assert found[0] == status, found
            if question is message:
                assert said in found[1]


def asked(url, message, **headers):
    request = urllib.request.Request(url, json.dumps(message).encode(), headers)
    try:
        with urllib.request.urlopen(request, timeout=10) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


@pytest.mark.parametrize("headers", [{"Host": "evil.example"}, {"Origin": "http://evil.example"}])
def test_a_web_page_cannot_ask_a_planner(headers):
    with serving({}) as url:
        assert asked(url, RESET, **headers)[0] == 403
        assert asked(url, RESET)[0] == 200
