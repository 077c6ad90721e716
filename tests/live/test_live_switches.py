"""New attacks turned off and on: by a page, a program or a signal; and the record of it."""

import http.client
import json
from types import SimpleNamespace

import numpy as np
import pytest

from deepmf_sumo.live.attacker import AttackRequest, spec_of
from deepmf_sumo.live.record import SessionRecord
from deepmf_sumo.live.session import Session
from deepmf_sumo.live.status import StatusServer


def session(av="ego", time_s=2.0):
    """A session that takes no step."""
    simulation = SimpleNamespace(getDeltaT=lambda: 0.1, getTime=lambda: time_s)
    scenery = SimpleNamespace(api=SimpleNamespace(simulation=simulation), av_id=av)
    return Session(scenery, None, (), np.random.default_rng(0), lambda attack: None)


def record(out=None):
    return SessionRecord(out, ["ego"], spec_of(AttackRequest(avs=("ego",))))


def post(port, path, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    connection.request("POST", path, headers=headers)
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, body


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "attacker.example"},
        {"Origin": "http://attacker.example"},
        {"Sec-Fetch-Site": "cross-site"},
    ],
)
def test_a_web_page_of_others_switches_nothing(headers):
    own, kept = session(), record()
    own.switched = kept.switch
    with StatusServer(0, ["ego"]) as status:
        status.watch([own])
        assert post(status.port, "/stop", **headers)[0] == 403
        assert (own.paused, kept.switches) == (False, [])
        code, body = post(status.port, "/stop")
    assert (code, json.loads(body)["new_attacks"]) == (200, "off")
    assert own.paused
    assert kept.switches == [
        {"simulation": 0, "av": "ego", "time_s": 2.0, "new_attacks": "off", "door": "HTTP"}
    ]
    assert own.last_failure == "new attacks are off since 2.0 s (HTTP)"


def test_each_change_is_recorded_once_and_told():
    own, kept, told = session(), record(), []
    own.switched, kept.switched = kept.switch, told.append
    for on in (True, False, False, True, True):
        own.switch(on=on)
    assert [(one["new_attacks"], one["door"]) for one in kept.switches] == [
        ("off", "API"),
        ("on", "API"),
    ]
    assert told == kept.switches
    assert own.last_failure == ""


def test_what_the_page_has_switched_stays_so_in_the_simulation_that_is_loaded():
    first, second, kept = session(), session(time_s=0.0), record()
    second.switched = kept.switch
    first.attacks = 2
    with StatusServer(0, ["ego"]) as status:
        status.watch([first])
        status.switch(on=False)
        status.watch([second])
        assert second.paused
        assert status._before["ego"] == 2
    assert [one["time_s"] for one in kept.switches] == [0.0]
