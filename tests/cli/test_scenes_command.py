import csv
import gzip
import json

import pytest
from click.testing import CliRunner

from deepmf_sumo.cli.data import list_scenes as command
from deepmf_sumo.errors import ReaderError, UsageError
from deepmf_sumo.report.scene_table import COLUMNS

from tests.support.recordings_by_hand import gpudrive, scenario, shard


@pytest.fixture
def data(tmp_path):
    repaired = scenario(name="mended")
    repaired.tracks[0].states[10].length = 0
    refused = scenario(name="bad")
    refused.tracks[2].states[10].valid = False
    return shard(tmp_path / "data.tfrecord", scenario(), repaired, refused)


def run(*arguments):
    return CliRunner().invoke(command, [str(one) for one in arguments])


def test_a_row_a_scene(data):
    assert "3 scenes: 1 ok, 1 repaired, 1 refused" in run(data).output
    result = run(data, "--format", "csv")
    assert result.exit_code == 0
    rows = list(csv.DictReader(result.output.splitlines()))
    assert tuple(rows[0]) == COLUMNS
    assert rows[0] == {
        "file": str(data),
        "record": "0",
        "scene": "abc123",
        "dataset": "womd",
        "status": "ok",
        "reason": "",
        "steps": "91",
        "vehicles": "2",
        "pedestrians": "1",
        "cyclists": "0",
        "lanes": "3",
        "connections": "1",
        "signals": "1",
        "av": "12",
        "interest": "12 7",
    }
    assert [row["status"] for row in rows] == ["ok", "repaired", "refused"]
    assert "no size at step 10" in rows[1]["reason"]
    assert "no valid state" in rows[2]["reason"]


def test_reasons_stand_below_their_rows(data):
    output = run(data).output
    assert output.index("mended") < output.index("no size at step 10") < output.index("bad")


def test_nothing_readable_ends_with_3(tmp_path):
    file = tmp_path / "cut.tfrecord.gz"
    file.write_bytes(gzip.compress(shard(tmp_path / "one", scenario()).read_bytes())[:100])
    result = run(file)
    assert isinstance(result.exception, ReaderError)
    assert result.exception.exit_code == 3
    assert "1 scene: 0 ok, 0 repaired, 1 refused" in result.output


def test_a_missing_path_is_a_usage_error(tmp_path):
    result = run(tmp_path / "none", "--format", "csv")
    assert isinstance(result.exception, UsageError)
    assert not result.output


def test_ids_are_no_markup_and_do_not_end_the_listing(tmp_path):
    names = ["[/x]", "[red]", "a\x1b[2J", "last"]
    for number, name in enumerate(names):
        described = gpudrive(scenario()) | {"scenario_id": name}
        (tmp_path / f"{number}.json").write_text(json.dumps(described))
    result = run(tmp_path)
    assert result.exit_code == 0
    assert "4 scenes: 3 ok, 0 repaired, 1 refused" in result.output
    assert all(name in result.output for name in ("[/x]", "[red]", "last"))
    assert "\x1b[2J" not in result.output
    rows = csv.DictReader(run(tmp_path, "--format", "csv").output.splitlines())
    assert [row["scene"] for row in rows] == ["[/x]", "[red]", "2", "last"]
