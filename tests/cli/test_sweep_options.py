"""What `run` and `attack` share: shards, limits, thresholds, signals."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from deepmf_sumo.cli import main
from deepmf_sumo.results import stored
from deepmf_sumo.study.sweep import shards

from tests.support import same_bytes, tiny_network, tiny_plan

SHARED = (
    "--out", "--resume", "--overwrite", "--jobs", "--shard", "--pictures", "--export", "--set",
)  # fmt: skip


NO_TIME = ("--set", "sweep.max_minutes=1.0e-9")


def call(*arguments):
    return main.run([str(one) for one in arguments])


@pytest.fixture(scope="module")
def specs(tiny):
    return [
        tiny_network.spec(tiny, f"part {number}", seed=str(number), duration_s="0.5")
        for number in range(3)
    ]


@pytest.fixture(scope="module")
def folders(specs, tmp_path_factory):
    """Result folders: of the whole sweep, and of its two parts."""
    os.environ["DEEPMF_SUMO_HOME"] = str(tmp_path_factory.mktemp("home"))
    made = tmp_path_factory.mktemp("folders")
    for name, part in {"whole": (), "1": ("--shard", "1/2"), "2": ("--shard", "2/2")}.items():
        assert call("run", *specs, "--no-pictures", "--out", made / name, *part) == 0
    return made


@pytest.fixture
def whole(folders, tmp_path):
    """A copy of the whole sweep's folder."""
    return Path(shutil.copytree(folders / "whole", tmp_path / "copy"))


@pytest.mark.parametrize("command", ["run", "attack", "evaluate", "train"])
def test_a_gpu_that_is_not_there_is_refused_before_anything_runs(
    command, specs, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    monkeypatch.setenv("DEEPMF_SUMO_DEVICE", "cuda")
    out = () if command == "evaluate" else ("--out", tmp_path / "out")
    given = {"run": specs[:1], "attack": [specs[0]], "evaluate": [tmp_path]}
    given["train"] = ["all", "--data", tmp_path]
    assert call(command, *given[command], *out) == 2
    told = "There is no CUDA device for DEEPMF_SUMO_DEVICE=cuda; use cpu or auto."
    assert told in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["run", "attack"])
def test_every_sweep_has_the_same_options(command, capsys):
    call(command, "--help")
    shown = capsys.readouterr().out
    assert [one for one in SHARED if one not in shown] == []


def test_shards_are_merged_to_the_whole(folders, tmp_path, capsys):
    parts = (folders / "1", folders / "2")
    assert call("merge", tmp_path / "all", *parts) == 0
    assert "3 runs: 3 ok" in capsys.readouterr().out
    assert same_bytes.differences(folders / "whole", tmp_path / "all") == []
    assert call("merge", tmp_path / "half", parts[1]) == 130
    assert f"2 runs are in no shard: the command without --shard, with --out {tmp_path}" in (
        capsys.readouterr().out
    )
    assert call("check", tmp_path / "half", "--write-baseline", tmp_path / "b.json") == 3
    assert "max_failed_runs is 2 (3 runs)" in capsys.readouterr().out
    assert call("merge", tmp_path / "twice", parts[0], parts[0]) == 2
    assert "give each shard once" in capsys.readouterr().err
    assert call("merge", *parts) == 2
    assert "runs that no shard has" in capsys.readouterr().err


def test_each_spec_runs_with_each_seed(specs, tmp_path, capsys):
    out = tmp_path / "out"
    run = ("run", *specs[:2], "--no-pictures", "--set", "sweep.junit=true", "--jobs", 2)
    assert call(*run, "--seeds", "7-8, 11", "--out", out) == 0
    assert "6 runs: 6 ok" in capsys.readouterr().out
    table = (out / "runs.csv").read_text().splitlines()
    ids = [row["run_id"] for row in csv.DictReader(table)]
    assert ids == [f"part-{spec}--tiny--{seed}" for spec in (0, 1) for seed in (7, 8, 11)]
    names = [case.get("name") for case in ET.parse(out / "junit.xml").iter("testcase")]
    assert names == ids
    written = {one: (out / "runs" / one / "result.json").stat().st_mtime_ns for one in ids}
    assert call(*run, "--seeds", "7-8,11-12", "--out", out, "--resume") == 0
    now = {one: (out / "runs" / one / "result.json").stat().st_mtime_ns for one in ids}
    assert now == written
    for part in ("1/2", "2/2"):
        folder = tmp_path / part[0]
        assert call(*run, "--seeds", "7-8,11-12", "--out", folder, "--shard", part) == 0
    assert call("merge", tmp_path / "all", tmp_path / "1", tmp_path / "2") == 0
    assert same_bytes.differences(out, tmp_path / "all") == []


@pytest.mark.parametrize(
    ("seeds", "told"),
    [
        ("1-", "'1-' is not a seed or a range of seeds"),
        ("0x10", "'0x10' is not a seed"),
        ("", "'' is not a seed"),
        ("-3", "'-3' is not a seed"),
        ("5-1", "5-1 ends before it begins"),
        ("1-3,2", "the seed 2 is given twice"),
        ("0-4294967296", "4294967296 is too large"),
        ("0-2147483647", "holds more than 100000 seeds"),
    ],
)
def test_seeds_that_are_not_plain_decimals_are_refused(specs, tmp_path, capsys, seeds, told):
    assert call("run", specs[0], f"--seeds={seeds}", "--out", tmp_path / "out") == 2
    assert told in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "given",
    [
        ("--seeds", "1-2", "--seed", 3),
        ("--seeds", "1-2", "--set", "seed=3"),
        ("--seeds", "5", "--set", "seeds=[1,2,3]"),
        ("--seed", "5", "--set", "seeds=[1,2,3]"),
        ("--seed", "5", "--set", "seed=3"),
    ],
)
@pytest.mark.parametrize("of", ["spec", "plan"])
def test_seeds_that_are_said_twice_are_refused(specs, tiny, tmp_path, capsys, given, of):
    file = specs[0] if of == "spec" else tiny_plan.write(tiny)
    assert call("run", file, *given, "--out", tmp_path / "out") == 2
    assert "goes without --se" in capsys.readouterr().err


def test_the_whole_knows_what_its_parts_read(folders, tmp_path):
    assert call("merge", tmp_path / "all", folders / "1", folders / "2") == 0
    read = stored.inputs_of(tmp_path / "all")
    assert read
    assert read == stored.inputs_of(folders / "1") | stored.inputs_of(folders / "2")


def test_moments_of_an_attack_are_those_of_every_part(folders, tmp_path):
    part = shutil.copytree(folders / "1", tmp_path / "1")
    (part / "moments.csv").write_text("run_id,av\n")
    assert call("merge", tmp_path / "all", part, folders / "2") == 0
    assert (tmp_path / "all" / "moments.csv").read_text() == "run_id,av\n"


def test_wrong_parts_are_not_merged(folders, tmp_path, capsys):
    other = Path(shutil.copytree(folders / "2", tmp_path / "other")) / shards.FILE
    noted = json.loads(other.read_text())
    for text, told in {
        json.dumps({**noted, "runs": noted["runs"][1:]}): "belongs to other runs than",
        "{": "shard.json is damaged",
        '{"version": "0.0.1", "runs": []}': "was made by version 0.0.1 of deepmf-sumo",
    }.items():
        other.write_text(text)
        assert call("merge", tmp_path / "out", folders / "1", other.parent) == 2
        assert told in capsys.readouterr().err
    assert call("merge", tmp_path / "out", folders / "whole") == 2
    assert "it has no shard.json, which --shard writes" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", ["[]", "{"])
def test_a_damaged_result_is_named_by_merge_and_done_again_by_resume(
    specs, whole, folders, tmp_path, capsys, text
):
    part = Path(shutil.copytree(folders / "1", tmp_path / "1"))
    damaged = min(part.glob("runs/*/result.json"))
    damaged.write_text(text)
    assert call("merge", tmp_path / "all", part, folders / "2") == 2
    assert f"{damaged} is damaged" in capsys.readouterr().err
    assert not (tmp_path / "all").exists()
    again = min(whole.glob("runs/*/result.json"))
    again.write_text(text)
    assert call("run", *specs, "--no-pictures", "--out", whole, "--resume") == 0
    assert same_bytes.differences(folders / "whole", whole) == []


def test_thresholds_are_judged_at_the_end(specs, whole, tmp_path, capsys):
    file = tmp_path / "thresholds.yaml"
    file.write_text("version: 1\nmax_av_collision_rate: 0.1\n")
    sweep = ("run", *specs, "--out", whole, "--resume", "--set", f"sweep.thresholds={file}")
    sweep += ("--set", "sweep.junit=true")
    assert call(*sweep) == 0
    assert "max_av_collision_rate" in capsys.readouterr().out
    assert "max_av_collision_rate" in (whole / "junit.xml").read_text()
    file.write_text("version: 1\nmin_judged_runs: 99\n")
    assert call(*sweep) == 3
    shutil.rmtree(next((whole / "runs").iterdir()))
    assert call(*sweep, *NO_TIME) == 130
    assert "1 run not begun: --resume goes on" in capsys.readouterr().out


def test_a_spec_whose_runs_never_began_is_no_verdict(specs, whole, tmp_path, capsys):
    """A name is the spec's own, not the id of its runs."""
    shutil.rmtree(whole / "runs" / "part-1--tiny--1")
    file = tmp_path / "thresholds.yaml"
    file.write_text("version: 1\nmax_failed_runs: 9\nspecs: {part 1: {max_failed_runs: 0}}\n")
    sweep = ("run", *specs, "--out", whole, "--resume", "--set", f"sweep.thresholds={file}")
    assert call(*sweep, *NO_TIME) == 130
    assert call("check", whole, "-t", file) == 3
    assert "spec part 1: max_failed_runs is 1 (1 run), allowed at most 0" in capsys.readouterr().out
    assert call(*sweep) == 0


def test_runs_of_specs_that_are_not_named_stay(specs, whole, folders, capsys):
    one = ("run", specs[1], "--no-pictures", "--out", whole, "--resume")
    assert call(*one) == 0
    assert "2 runs of earlier commands in the folder: kept in its tables" in capsys.readouterr().err
    assert same_bytes.differences(folders / "whole", whole) == []
    assert call("check", whole, "--write-baseline", whole.parent / "b.json") == 0
    assert "3 runs: 3 judged" in capsys.readouterr().out


def test_an_order_of_commands_is_the_order_of_the_tables(specs, folders, tmp_path):
    for names in (specs[:1], specs[1:2], specs[1:]):
        more = ("--out", tmp_path / "out", "--resume")
        assert call("run", *names, "--no-pictures", *more) == 0
    assert same_bytes.differences(folders / "whole", tmp_path / "out") == []


def test_a_run_of_another_spec_whose_files_changed_is_in_no_table(tiny, tmp_path, capsys):
    other = Path(shutil.copytree(tiny, tmp_path / "other"))
    a = tiny_network.spec(tiny, "stays", duration_s="0.5")
    b = tiny_network.spec(other, "changes", duration_s="0.5")
    out = ("--no-pictures", "--out", tmp_path / "out")
    assert call("run", a, b, *out) == 0
    (other / "tiny.rou.xml").write_text((other / "tiny.rou.xml").read_text() + "<!-- x -->")
    capsys.readouterr()
    assert call("run", a, *out, "--resume") == 0
    told = capsys.readouterr().err
    assert "1 run of earlier commands in the folder: in no table any more" in told
    assert "(changes--tiny--0)" in told
    assert list(stored.keys_of(tmp_path / "out")) == ["stays--tiny--0"]
    assert (tmp_path / "out" / "runs" / "changes--tiny--0" / "result.json").is_file()
    assert call("run", b, *out, "--resume") == 0
    assert [row["run_id"] for row in stored.rows_of(tmp_path / "out")] == [
        "stays--tiny--0",
        "changes--tiny--0",
    ]


def test_runs_of_another_spec_that_never_began_are_still_missing(specs, whole, capsys):
    shutil.rmtree(whole / "runs" / "part-1--tiny--1")
    sweep = ("run", "--no-pictures", "--out", whole, "--resume")
    assert call(*sweep, *specs, *NO_TIME) == 130
    assert call(*sweep, specs[0]) == 130
    assert "1 run of other specs in the folder: never begun" in capsys.readouterr().err
    assert call("check", whole, "--write-baseline", whole.parent / "b.json") == 3
    assert call(*sweep, specs[1]) == 0


def test_an_attack_that_is_switched_off_is_no_verdict(tiny, tmp_path, capsys):
    names = [tiny_network.spec(tiny, f"cut {n}", adversary="rule", seed=str(n)) for n in range(6)]
    assert call("run", *names, "--no-pictures", "--out", tmp_path / "old") == 0
    new = ("run", *names, "--no-pictures", "--out", tmp_path / "new", "--set", "adversary=none")
    capsys.readouterr()
    assert call(*new, "--set", f"sweep.baseline={tmp_path / 'old'}") == 3
    assert "adversary was 'rule' and is 'none' (6 runs)" in capsys.readouterr().out
    assert call("check", tmp_path / "old", "--baseline", tmp_path / "old") != 1


def test_what_is_wrong_is_said_before_anything_is_lost(specs, whole, tmp_path, capsys):
    bad, good = tmp_path / "bad.yaml", tmp_path / "good.yaml"
    bad.write_text("version: 1\nmax_colision_rate: 0.1\n")
    good.write_text("version: 1\n")
    old = tmp_path / "old.json"
    results = {"kind": "deepmf-sumo results", "format_version": 2, "version": "0.0.1"}
    results |= {"runs": [], "attacks": {}}
    old.write_text(json.dumps(results))
    for wrong, told in {
        (f"sweep.thresholds={bad}",): "Did you mean 'max_collision_rate'?",
        (f"sweep.thresholds={good}", f"sweep.baseline={old}"): "was made by version 0.0.1",
        (f"sweep.baseline={old}",): "was made by version 0.0.1",
        ("sweep.executor=rays",): "must be local, ray, or ray://HOST:PORT",
        ("sweep.executor=ray", "sweep.gui=true"): "sweep.gui shows runs on this machine",
        ("--shard", "3/2"): "must be i/n with 1 <= i <= n",
        ("--shard", "4/4", "--overwrite"): "There are 3 runs: this shard of them is empty",
        ("--resume", "--overwrite"): "leave one of them out",
        (): "holds the results of an earlier command: --resume goes on with them, --overwrite",
    }.items():
        sets = (part for one in wrong for part in (["--set", one] if "=" in one else [one]))
        assert call("run", *specs, "--out", whole, *sets) == 2
        assert told in capsys.readouterr().err.strip().splitlines()[-1]
        assert json.loads((whole / "summary.json").read_text())["runs"] == 3


def test_results_are_replaced_where_that_is_asked_for(folders, specs, whole, tmp_path, capsys):
    assert call("run", specs[0], "--no-pictures", "--out", whole, "--overwrite") == 0
    assert len(list((whole / "runs").iterdir())) == 1
    parts = (folders / "1", folders / "2")
    assert call("merge", tmp_path / "all", *parts) == 0
    assert call("merge", tmp_path / "all", *parts) == 2
    assert "--overwrite deletes them, another folder for OUT" in capsys.readouterr().err
    assert call("merge", tmp_path / "all", *parts, "--overwrite") == 0
    assert same_bytes.differences(folders / "whole", tmp_path / "all") == []


@pytest.mark.skipif(sys.platform in {"win32", "darwin"}, reason="has a display always")
def test_without_a_display_the_screen_is_refused(specs, tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert call("run", *specs, "--out", tmp_path / "out", "--set", "sweep.gui=true") == 2
    assert "sweep.gui: there is no display" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_within_five_seconds_and_leaves_no_child(tiny, tmp_path, number):
    names = [tiny_network.spec(tiny, f"many {one}", duration_s="8.0") for one in range(20)]
    out = tmp_path / "out"
    command = (sys.executable, "-m", "deepmf_sumo.cli.main", "run")
    child = subprocess.Popen(
        [*command, *names, "--out", out, "--jobs", "2", "--no-pictures"],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        # A shell's background jobs ignore interrupts, and so would their children.
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.default_int_handler),
    )
    while len(list(out.glob("runs/many-*/result.json"))) < 2:
        assert child.poll() is None
        time.sleep(0.02)
    started = _descendants(child.pid)
    assert len(started) >= 2
    begin = time.monotonic()
    child.send_signal(number)
    _, errors = child.communicate(timeout=60)
    assert time.monotonic() - begin < 5.0 * _slowness()
    assert child.returncode == 130
    assert b"Traceback" not in errors
    end = time.monotonic() + 2.0 * _slowness()  # Python's own helper goes when it notices
    while (left := [pid for pid in started if _alive(pid)]) and time.monotonic() < end:
        time.sleep(0.05)
    assert left == []
    kept = {path.parent.name for path in out.glob("runs/many-*/result.json")}
    table = {line.split(",")[0] for line in (out / "runs.csv").read_text().splitlines()[1:]}
    assert table == kept
    assert len(kept) < 20
    assert json.loads((out / "summary.json").read_text())["interrupted"] is True


def _slowness():
    """How much longer everything takes where more processes want to run than can."""
    return max(1.0, os.getloadavg()[0] / os.cpu_count())


def _descendants(pid):
    """Processes that it has started, and those that they have."""
    try:
        threads = list(Path(f"/proc/{pid}/task").iterdir())
        children = [int(one) for own in threads for one in (own / "children").read_text().split()]
    except OSError:
        return []
    return [each for child in children for each in (child, *_descendants(child))]


def _alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
