"""Times of a live session in which attacks were off, in all that judges its results."""

import json

import pytest
from click.testing import CliRunner

from deepmf_sumo import files
from deepmf_sumo.cli.show import command as show
from deepmf_sumo.errors import UsageError
from deepmf_sumo.report import page
from deepmf_sumo.results import gate, sessions
from deepmf_sumo.results.gate import verdict

from tests.support import gate_doubles
from tests.support.result_folders import Folder


def change(time_s, new_attacks, door="HTTP", av="ego", simulation=1):
    return {
        "simulation": simulation, "av": av, "time_s": time_s, "new_attacks": new_attacks,
        "door": door,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("switches", "expected"),
    [
        ([], []),
        ([change(2, "off")], ["new attacks on 'ego' were off from 2.0 s to the end (HTTP)"]),
        (
            [change(2, "off"), change(9.5, "on", "API"), change(30, "off", "signal")],
            [
                "new attacks on 'ego' were off from 2.0 s to 9.5 s (HTTP, API)",
                "new attacks on 'ego' were off from 30.0 s to the end (signal)",
            ],
        ),
        (
            [change(2, "off"), change(3, "off", av="b"), change(4, "on"), change(5, "on", av="b")],
            [
                "new attacks on 'ego' were off from 2.0 s to 4.0 s (HTTP)",
                "new attacks on 'b' were off from 3.0 s to 5.0 s (HTTP)",
            ],
        ),
        (
            [change(7, "off"), change(0, "off", simulation=2)],
            [
                "new attacks on 'ego' were off from 7.0 s to the end (HTTP)",
                "new attacks on 'ego' were off from 0.0 s to the end of simulation 2 (HTTP)",
            ],
        ),
    ],
)
def test_each_time_without_attacks_is_a_sentence(switches, expected):
    assert list(sessions.sentences(switches)) == expected


def session(out, *switches):
    (out / sessions.FILE).write_text(json.dumps({"switches": list(switches)}))


@pytest.mark.parametrize(
    "text", ["[]", '{"switches": 3}', '{"switches": [{}]}', '{"switches": [3]}']
)
def test_a_damaged_session_is_named(tmp_path, text):
    (tmp_path / sessions.FILE).write_text(text)
    with pytest.raises(UsageError, match=r"session\.json is damaged"):
        sessions.switched_off(tmp_path)


def test_the_gate_gives_no_verdict_on_a_session_without_attacks(tmp_path):
    """All runs are without a hit: they would pass."""
    runs = [gate_doubles.result("a", seed) for seed in range(5)]
    out = gate_doubles.write_folder(tmp_path / "out", runs)
    thresholds = tmp_path / "t.yaml"
    thresholds.write_text("version: 1\nmax_av_collision_rate: 0.5\n")
    wanted = gate.load(thresholds)
    session(out)
    assert gate.check(out, wanted).exit_code == 0
    session(out, change(2, "off"))
    found = gate.check(out, wanted)
    assert found.exit_code == 3
    text = verdict.text(found)
    assert "no verdict" in text
    assert "new attacks on 'ego' were off from 2.0 s to the end (HTTP)" in text
    verdict.write_junit(tmp_path / "junit.xml", found)
    assert "attacks_switched_off" in (tmp_path / "junit.xml").read_text()


@pytest.mark.sumo  # the page reads the recording in a process of its own
def test_show_and_the_page_tell_it(tmp_path):
    folder = Folder(tmp_path)
    folder.add("a")
    out = folder.out
    files.write_json(out / "manifest.json", {"runs": {}})
    session(out, change(2, "off"))
    said = "new attacks on 'ego' were off from 2.0 s to the end (HTTP)"
    for more in ((), ("--failures",), ("--format", "json")):
        told = CliRunner().invoke(show, [str(out), *more])
        assert told.exit_code == 0, told.output
        assert said in told.output
    assert said in page.write(out).read_text()
