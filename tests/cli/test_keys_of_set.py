"""What ``--set`` takes beside keys of specs, and a port that names its host."""

import click
import pytest

from deepmf_sumo.cli._keys import AttachKeys, LiveKeys, RecordKeys, SweepKeys, taken
from deepmf_sumo.cli._parameters import Place
from deepmf_sumo.errors import SpecError


def test_keys_of_a_sweep_are_taken_out_and_the_rest_is_the_specs():
    sets = ["seed=3", "sweep.timeout_s=5", " sweep.gui = true", "sweeps.x=1", "adversary.tries=2"]
    keys, rest = taken(sets, SweepKeys, "sweep")
    assert (keys.timeout_s, keys.gui, keys.junit) == (5.0, True, False)
    assert rest == ["seed=3", "sweeps.x=1", "adversary.tries=2"]
    assert taken(["sweep={timeout_s: null, junit: true}"], SweepKeys, "sweep")[0].timeout_s is None


def test_a_command_without_a_spec_has_no_other_keys():
    keys, rest = taken(["avs=2", "diverse=false"], RecordKeys)
    assert (keys.avs, keys.diverse, keys.every_s, rest) == (2, False, 9.0, [])
    with pytest.raises(SpecError, match="--set seed=3: key 'seed': unknown key"):
        taken(["seed=3"], RecordKeys)


@pytest.mark.parametrize(
    ("assignment", "told"),
    [
        ("live.pauses_s=3", "Did you mean 'pause_s'"),
        ("live.pause_s=-1", "key 'live.pause_s': -1"),
        ("live.pause_s=.inf", "key 'live.pause_s'"),
        ("live.attacks=0", "key 'live.attacks'"),
        ("live=3", r"write live\.KEY=VALUE"),
        ("live.net=nowhere.net.xml", "no such file or folder: .*nowhere.net.xml"),
    ],
)
def test_what_is_wrong_is_named(assignment, told):
    with pytest.raises(SpecError, match=told):
        taken([assignment], AttachKeys, "live")


def test_where_sumo_is_is_for_attach_alone():
    with pytest.raises(SpecError, match="unknown key"):
        taken(["live.order=1"], LiveKeys, "live")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("8813", ("localhost", 8813)),
        ("sumo.example.org:1", ("sumo.example.org", 1)),
        ("[::1]:65535", ("::1", 65535)),
    ],
)
def test_a_port_may_name_its_host(text, expected):
    assert Place().convert(text, None, None) == expected


@pytest.mark.parametrize("text", ["0", "65536", ":8813", "host:", "host:http"])
def test_what_is_no_port_is_refused(text):
    with pytest.raises(click.BadParameter):
        Place().convert(text, None, None)
