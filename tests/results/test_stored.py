"""Result folders that are damaged, or made to reach outside themselves."""

import copy
import csv
import json
import shutil

import pytest

import deepmf_sumo
from deepmf_sumo.errors import UsageError
from deepmf_sumo.report.page import document
from deepmf_sumo.report.side_by_side import groups
from deepmf_sumo.results import run_sets, stored
from deepmf_sumo.results.result import COLUMNS
from deepmf_sumo.spec.tasks import is_run_id, run_id_of
from deepmf_sumo.study.sweep import shards

from tests.support import gate_doubles

OUTSIDE = ["../../../EVIL/x", "/tmp/x", "..", ".", "", "a/b", "a\\b", "A", "a\n", "ä", "x" * 201]

WHOLE = {
    "opponent_score": None,
    "budget": {"simulations": None, "seconds": None},
    "metrics": {"min_gap": {"value": 2.0, "unit": "m", "better": "lower"}},
    "timings": {
        "wall_s": 1.5, "generation_s": 0.5, "cycle_ms_median": None, "simulation_s": 0.5,
    },
}  # fmt: skip


def shard(folder, run_id="made-up--a--0"):
    """A part with one run, whose shard.json names it ``run_id``."""
    one = gate_doubles.result() | WHOLE
    gate_doubles.write_folder(folder, [one])
    runs = [[run_id, one["key"]]]
    note = {"version": deepmf_sumo.__version__, "runs": runs}
    (folder / "shard.json").write_text(json.dumps(note))
    return folder


@pytest.mark.parametrize("run_id", OUTSIDE)
def test_merge_refuses_ids_that_are_no_names_of_runs(tmp_path, run_id):
    given = shard(tmp_path / "a" / "b" / "given", run_id)
    (tmp_path / "EVIL").mkdir()
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(UsageError, match=r"shard\.json is damaged: .* not the id of a run"):
        shards.merge(tmp_path / "out", [given])
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("first", [None, "a,b\n1,2\n"], ids=["missing", "damaged"])
def test_the_table_of_moments_is_that_of_a_part_that_has_it(tmp_path, first):
    table = "run_id,start_s\nmade-up--a--0,3.0\n"
    parts = [shard(tmp_path / name) for name in "ab"]
    shutil.rmtree(parts[1] / "runs" / "made-up--a--0")
    (parts[1] / stored.MOMENTS).write_text(table)
    if first:
        (parts[0] / stored.MOMENTS).write_text(first)
        with pytest.raises(UsageError, match="is not a table of moments"):
            shards.merge(tmp_path / "alone", parts[:1])
        assert not (tmp_path / "alone").exists()
    shards.merge(tmp_path / "out", parts)
    assert (tmp_path / "out" / stored.MOMENTS).read_text() == table


def test_merge_refuses_a_run_that_reaches_elsewhere_by_a_link(tmp_path):
    given = shard(tmp_path / "given")
    (tmp_path / "secret").write_text("secret")
    (given / "runs" / "made-up--a--0" / "log.txt").symlink_to(tmp_path / "secret")
    with pytest.raises(UsageError, match=r"log\.txt is a link, a device or a pipe"):
        shards.merge(tmp_path / "out", [given])


@pytest.mark.parametrize("run_id", OUTSIDE)
def test_every_reader_refuses_ids_that_are_no_names_of_runs(tmp_path, run_id):
    out = gate_doubles.write_folder(tmp_path / "out", [gate_doubles.result()], missing=[run_id])
    with pytest.raises(UsageError, match=r"manifest\.json is damaged: .* not the id of a run"):
        run_sets.read(out)
    with pytest.raises(UsageError, match="is not the id of a run"):
        stored.run_folder(out, run_id, "runs.csv")
    row = dict.fromkeys(COLUMNS, "") | {"run_id": run_id, "status": "ok", "seed": "0"}
    with (out / "runs.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        table.writeheader()
        table.writerow(row)
    with pytest.raises(UsageError, match="is not the id of a run"):
        groups([out])
    with pytest.raises(UsageError, match="is not the id of a run"):
        document.write(out)


def test_ids_of_our_own_runs_are_ids():
    class Named:
        name, seed = "Ein Überholen: <b> 🚗 " * 40, 2**31 - 1

    assert is_run_id(run_id_of(Named, "../../scene " * 40))
    assert is_run_id(gate_doubles.result()["run_id"])
    assert is_run_id("attack-001")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("metrics", ""),
        ("metrics", {"min_gap": 1.0}),
        ("metrics", {"min_gap": {"value": "near"}}),
        ("metrics", None),
        ("contacts", [{"kind": "av_opponent", "sector": 8}]),
        ("contacts", {}),
        ("status", ["ok"]),
        ("timings", {"wall_s": "long"}),
        ("settings", {"planner": [], "adversary": {}}),
        ("seed", 1.5),
        ("opponent", 7),
    ],
)
def test_a_result_of_another_shape_is_named_with_its_key(tmp_path, key, value):
    out = gate_doubles.write_folder(tmp_path / "out", [gate_doubles.result() | {key: value}])
    with pytest.raises(UsageError, match=rf"result\.json is not a result of .* \({key}"):
        run_sets.read(out)


def test_a_result_that_says_it_is_of_another_folder(tmp_path):
    out = gate_doubles.write_folder(tmp_path / "out", [gate_doubles.result()])
    file = out / "runs" / "made-up--a--0" / "result.json"
    file.write_text(json.dumps(gate_doubles.result() | {"run_id": "../../../elsewhere"}))
    with pytest.raises(UsageError, match=r"result\.json is damaged .run_id: "):
        stored.result_of(file)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b'{"status": "ok", "value": NaN', "damaged"),
        (b"[" * 100_000, "nested too deeply"),
        (b"\xff\xfe", "damaged"),
        (b"[]", "not a mapping"),
        (b"1" * 10_000, "damaged"),
    ],
)
def test_json_that_is_none(tmp_path, content, why):
    (tmp_path / "result.json").write_bytes(content)
    with pytest.raises(UsageError, match=why):
        stored.result_of(tmp_path / "result.json")


def test_numbers_that_are_none_are_named(tmp_path):
    found = gate_doubles.result(more={"here": [1.0, float("inf")]})
    (tmp_path / "result.json").write_text(json.dumps(found))
    with pytest.raises(UsageError, match=r"more\.here\.1 is not a finite number"):
        stored.result_of(tmp_path / "result.json")


def test_a_manifest_with_such_a_number_is_damaged(tmp_path):
    (tmp_path / "manifest.json").write_text('{"machine": {"timeout_s": 1e400}}')
    with pytest.raises(UsageError, match=r"machine\.timeout_s is not a finite number"):
        stored.manifest_of(tmp_path)


def test_a_device_in_place_of_a_result(tmp_path):
    (tmp_path / "result.json").symlink_to("/dev/zero")
    with pytest.raises(UsageError, match="it is a device, not a regular file"):
        stored.result_of(tmp_path / "result.json")


@pytest.mark.parametrize("key", ["opponent_score", "budget", "timings"])
def test_what_merge_puts_into_tables_must_be_whole(tmp_path, key):
    """Gates and comparisons need less, and read what earlier versions wrote."""
    found = gate_doubles.result() | copy.deepcopy(WHOLE)
    file = tmp_path / "result.json"
    file.write_text(json.dumps(found))
    stored.result_of(file, whole=True)
    if key == "timings":
        del found["timings"]["generation_s"]
    else:
        del found[key]
    file.write_text(json.dumps(found))
    stored.result_of(file)
    with pytest.raises(UsageError, match=rf"not a result of this version.* \({key}.*required"):
        stored.result_of(file, whole=True)
