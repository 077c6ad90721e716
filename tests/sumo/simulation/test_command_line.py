"""SUMO's options beside a configuration."""

from pathlib import Path

import pytest

from deepmf_sumo.errors import UsageError
from deepmf_sumo.sumo.simulation.sumo_config import SUMO_SEED, read_configuration
from deepmf_sumo.sumo.simulation.sumo_options import parse

from tests.support.tiny_network import build


def test_all_spellings_of_sumo_are_understood(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    given = ["--scale", "2", "-b", "10", "--time-to-teleport=-1", "--ignore-route-errors"]
    assert parse([*given, "-r", "a.xml,b.xml", "--max-depart-delay", "-1"]) == {
        "scale": "2",
        "begin": "10",
        "time-to-teleport": "-1",
        "ignore-route-errors": "true",
        "route-files": f"{tmp_path}/a.xml,{tmp_path}/b.xml",
        "max-depart-delay": "-1",
    }


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--step-length", "1"], "every run steps by 0.1 s"),
        (["--srand", "1"], "give --seed before the --"),
        (["--scale", "2", "--scale=3"], "given twice"),
        (["other.sumocfg"], "'other.sumocfg' is not a SUMO option"),
        (["-Q"], "write it out"),
    ],
)
def test_options_that_are_not_the_users_are_refused(options, reason):
    with pytest.raises(UsageError, match=reason):
        parse(options)


def test_options_are_laid_over_the_configuration(tmp_path):
    config = build(tmp_path)
    more = tmp_path / "more.add.xml"
    more.write_text("<additional/>")
    found = read_configuration(config, ("-b", "00:01:00", "-a", str(more), "--scale", "2"))
    assert found.begin_s == 60.0
    assert found.additional == (more,)
    assert found.options == ("--begin", "00:01:00", "--scale", "2")
    assert found.seed == SUMO_SEED


def test_a_configurations_seed_and_variables_are_known(tmp_path, monkeypatch):
    config = build(tmp_path)
    monkeypatch.setenv("TINY", str(tmp_path))
    text = config.read_text().replace("tiny.net", "${TINY}/tiny.net")
    config.write_text(
        text.replace("</conf", '<random_number><seed value="7"/></random_number></conf')
    )
    found = read_configuration(config)
    assert found.seed == 7
    assert found.net == Path(tmp_path / "tiny.net.xml")
