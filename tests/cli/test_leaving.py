"""Signals to a command that waits for the steps of another program."""

import os
import signal
import socket

import pytest

from deepmf_sumo.cli import _leaving
from deepmf_sumo.cli._leaving import leaving


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(_leaving, "_IDLE_S", 0.05)
    monkeypatch.setattr(_leaving, "_LOOK_S", 0.01)


def send(number):
    os.kill(os.getpid(), number)


@pytest.mark.parametrize("number", _leaving.SIGNALS)
def test_a_signal_asks_and_a_second_one_interrupts(number):
    with leaving() as stopped:
        assert not stopped()
        send(number)
        assert stopped()
        assert stopped.terminated == (number == signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            send(number)


def test_one_sigterm_interrupts_what_waits_for_a_step():
    left, right = socket.socketpair()
    with left, right, leaving():
        send(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            left.recv(1)


def test_ctrl_c_waits_for_the_next_step_of_the_script():
    left, right = socket.socketpair()
    left.settimeout(0.2)
    with left, right, leaving() as stopped:
        send(signal.SIGINT)
        with pytest.raises(TimeoutError):
            left.recv(1)
        assert stopped()


def test_the_handlers_are_as_before():
    numbers = (*_leaving.SIGNALS, signal.SIGALRM)
    before = [signal.getsignal(number) for number in numbers]
    with leaving():
        send(signal.SIGTERM)
    assert [signal.getsignal(number) for number in numbers] == before
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
