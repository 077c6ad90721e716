import csv
from dataclasses import dataclass, replace

import pytest
from click.testing import CliRunner

from deepmf_sumo.cli.data import convert as command
from deepmf_sumo.errors import ConversionError, OutputError
from deepmf_sumo.scene import RoadMap, readers
from deepmf_sumo.training.convert_all import convert_all

pytestmark = pytest.mark.sumo


@dataclass
class Refused:
    name: str = "refused"
    reason: str = "it is broken"


@pytest.fixture
def mixed(crossing, scene_of):
    """Two good scenes of one name, one without lanes, one that was not read."""
    empty = replace(scene_of(RoadMap(lanes={})), name="empty")
    return [crossing, Refused(), empty, crossing]


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_failure_is_a_row_and_the_others_go_on(mixed, tmp_path, jobs):
    rows = list(convert_all(mixed, tmp_path, jobs))
    assert [row.status for row in rows] == ["ok", "failed", "failed", "ok"]
    assert [row.scene for row in rows] == ["synthetic", "refused", "empty", "synthetic"]
    assert rows[1].reason == "it is broken"
    assert "no lane with a length" in rows[2].reason
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "convert.csv",
        "synthetic",
        "synthetic-2",
    ]
    with (tmp_path / "convert.csv").open(newline="") as file:
        table = list(csv.reader(file))
    assert ",".join(table[0]).startswith(
        "scene,status,reason,lanes,lanes_lost,connections,connections_lost,"
        "error_mean_m,error_p99_m,error_max_m,seconds"
    )
    assert [row[:2] for row in table[1:]] == [[row.scene, row.status] for row in rows]
    assert table[1][3:7] == ["26", "0", "27", "0"]
    assert float(table[1][9]) <= 0.03


def test_the_table_is_there_when_the_batch_is_ended_before(mixed, tmp_path):
    rows = convert_all(mixed, tmp_path, 1)
    next(rows)
    rows.close()
    assert len((tmp_path / "convert.csv").read_text().splitlines()) == 2


def test_an_output_folder_that_cannot_be_written(mixed, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        list(convert_all(mixed, tmp_path / "file", 1))


def test_the_command_says_how_many_failed(mixed, tmp_path, monkeypatch):
    monkeypatch.setattr(readers, "scenes", lambda paths: iter(mixed))
    result = CliRunner().invoke(command, ["data", "--out", str(tmp_path), "--jobs", "1"])
    assert isinstance(result.exception, ConversionError)
    assert result.exception.exit_code == 3
    assert "2 of 4 scenes could not be converted" in str(result.exception)
    assert "refused: it is broken" in result.output


def test_the_command_ends_well(crossing, tmp_path, monkeypatch):
    monkeypatch.setattr(readers, "scenes", lambda paths: iter([crossing]))
    result = CliRunner().invoke(command, ["data", "--out", str(tmp_path), "--jobs", "1"])
    assert result.exit_code == 0, result.output
    assert "1 of 1 scenes" in result.output
