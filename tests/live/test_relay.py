"""The relay between a client and a SUMO that the test plays: what hangs, and what is refused."""

import multiprocessing
import signal
import socket
import struct
import subprocess
import sys
import threading

import pytest

from deepmf_sumo import live
from deepmf_sumo.live import relay
from deepmf_sumo.live.kept_files import framed
from deepmf_sumo.live.relay import Wire, commands_of, number_of

STEP = framed(b"\x02" + struct.pack("!d", 0.0))
SILENT = framed(b"\xa4\x00" + struct.pack("!i", 0) + b"x")
"""A command that SUMO does not answer: it has a byte too many."""


class Played:
    """A SUMO that says yes to all but one command, and the relay before it."""

    def __init__(self, tmp_path, pid):
        self.asked, self.told = [], []
        self._sumo = socket.create_server(("127.0.0.1", 0))
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        self.hears, self.says = multiprocessing.Pipe()
        self.sumo = threading.Thread(target=self._play, daemon=True)
        self.sumo.start()
        self.relay = threading.Thread(
            target=relay._serve,
            args=(self.listener, self._sumo.getsockname()[1], self.says, [pid], tmp_path),
            daemon=True,
        )
        self.relay.start()

    def _play(self):
        connection, _ = self._sumo.accept()
        with connection:
            inside = Wire(connection)
            while (body := inside.receive()) is not None:
                self.asked.append(body)
                if body != SILENT:
                    inside.send(b"".join(relay._done(number_of(one)) for one in commands_of(body)))

    def close(self):
        self.relay.join(10)
        self.sumo.join(10)
        for one in (self._sumo, self.listener, self.hears, self.says):
            one.close()

    def said(self):
        self.relay.join(10)
        assert not self.relay.is_alive()
        while self.hears.poll():
            self.told.append(self.hears.recv())
        return self.told


@pytest.fixture
def killed(monkeypatch):
    """Instead of signals to SUMO."""
    sent = []
    monkeypatch.setattr(relay.os, "kill", lambda *values: sent.append(values))
    return sent


@pytest.fixture
def played(tmp_path, killed, monkeypatch):
    monkeypatch.setattr(relay, "_LOOK_S", 0.01)
    monkeypatch.setattr(relay, "_refuse", lambda *_: None)  # it would wait for others for ever
    found = Played(tmp_path, 77)
    yield found
    found.close()


def client(played):
    connection = socket.create_connection(("127.0.0.1", played.port), timeout=10)
    outside = Wire(connection)
    outside.send(STEP)
    assert outside.receive() == relay._done(2)
    return connection, outside


def test_a_command_that_is_not_answered_ends_sumo_and_is_named(played, killed, monkeypatch):
    monkeypatch.setattr(relay, "_ANSWER_S", 0.05)
    connection, outside = client(played)
    with connection:
        outside.send(SILENT)
        assert outside.receive() is None
    said = "it has not answered CMD_GET_VEHICLE_VARIABLE (0xa4) in 0.05 s"
    assert ("complaint", f"SUMO was ended: {said}") in played.said()
    assert {("stuck", ""), ("left", "")} <= set(played.told)
    assert killed == [(77, signal.SIGKILL)]


def test_a_client_that_leaves_without_an_answer_ends_sumo(played, killed, monkeypatch):
    monkeypatch.setattr(relay, "_GONE_S", 0.05)
    connection, outside = client(played)
    with connection:
        outside.send(SILENT)
        outside.send(STEP)  # and something that is not read
    assert any("when the client left" in text for _, text in played.said())
    assert killed == [(77, signal.SIGKILL)]


def test_a_client_that_leaves_is_waited_for_where_sumo_answers(played, killed):
    connection, outside = client(played)
    outside.send(STEP)
    connection.close()
    assert ("stuck", "") not in played.said()
    assert killed == []
    assert number_of(played.asked[-1]) == relay.CLOSE


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--save-configuration", "/home/user/.profile"], "--save-configuration"),
        (["-C", "x"], "--C"),
    ],
)
def test_a_load_that_writes_elsewhere_is_refused_by_name_and_the_simulation_goes_on(
    played, words, reason
):
    connection, outside = client(played)
    texts = [one.encode() for one in words]
    content = b"".join(struct.pack("!i", len(one)) + one for one in texts)
    load = framed(b"\x01\x0e" + struct.pack("!i", len(texts)) + content)
    with connection:
        outside.send(load + STEP)
        answer = outside.receive()
        assert answer.endswith(relay._done(2))
        assert (answer[1], answer[2]) == (relay.LOAD, 0xFF)
        assert b"load: SUMO's option " + reason.encode() in answer
    assert load not in played.asked


def test_half_a_step_which_sumo_cannot_do_with_two_clients_is_refused_by_name(played):
    connection, outside = client(played)
    with connection:
        outside.send(framed(bytes((relay.HALF_STEP,))) + STEP)
        answer = outside.receive()
    assert (answer[1], answer[2]) == (relay.HALF_STEP, 0xFF)
    assert b"simulation.executeMove" in answer
    assert answer.endswith(relay._done(2))
    assert played.said()  # the connection has gone on


def test_a_state_is_saved_in_the_folder_only(played, tmp_path):
    connection, outside = client(played)
    with connection:
        for name in (b"/home/user/.profile", b"/"):
            outside.send(framed(b"\xcb\x95\0\0\0\0\x0c" + struct.pack("!i", len(name)) + name))
            answer = outside.receive()
        assert b"simulation.saveState: '/' names no file" in answer
    (asked,) = [one for one in played.asked if number_of(one) == 0xCB]
    assert asked.endswith(str(tmp_path / ".profile").encode())


@pytest.mark.sumo
def test_its_process_loads_nothing_that_only_attacks_need():
    heavy = "{'scipy', 'torch', 'pandas', 'deepmf_sumo.live.attacker', 'deepmf_sumo.results'}"
    code = f"import sys, deepmf_sumo.live.relay; print({heavy} & set(sys.modules) or 'none')"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "none"


def test_the_room_has_the_names_that_it_lists():
    assert all(getattr(live, name).__name__ == name for name in live.__all__)
    with pytest.raises(AttributeError, match="nobody"):
        live.nobody  # noqa: B018
