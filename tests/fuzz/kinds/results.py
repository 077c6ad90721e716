"""Result folders of real runs: read by the commands that read them."""

import contextlib
import csv
import io
import json
import os
import random
import subprocess
from pathlib import Path

from deepmf_sumo import spec
from deepmf_sumo.cli import check, compare, merge, report, risk, show  # noqa: F401 - loaded once
from deepmf_sumo.errors import DeepmfError
from deepmf_sumo.results import stored
from deepmf_sumo.results.folder import Store
from deepmf_sumo.study.sweep import batch
from deepmf_sumo.study.sweep.shards import Shard

from tests.fuzz import mutators, runner
from tests.support import tiny_network

_THRESHOLDS = Path(__file__).resolve().parents[3] / "docs" / "ci" / "thresholds.yaml"
_COMMANDS = ("show", "report", "merge", "risk", "check", "compare")


def _make(folder: Path) -> Path:
    """A part of a sweep of two runs on a network, one of them attacked."""
    tiny_network.build(folder)
    specs = [
        tiny_network.spec(folder, name, adversary=adversary, expect="{av_collision: false}")
        for name, adversary in (("attacked", "rule"), ("left alone", "none"))
    ]
    out = folder / "results"
    batch.run([spec.load(path) for path in specs], batch.Options(out=out, jobs=1, junit=True))
    whole = batch.Options(out=out, jobs=1, resume=True, shard=Shard(number=1, of=1))
    batch.run([spec.load(path) for path in specs], whole)
    (folder / "command").write_text("report")
    return out


def _change(rng: random.Random, folder: Path) -> None:
    """Some files of it; which command is to read it is said beside it."""
    (folder.parent / "command").write_text(rng.choice(_COMMANDS))
    for _ in range(rng.randint(1, 2)):
        files = sorted(path for path in folder.rglob("*") if path.is_file())
        by_ending = sorted({path.suffix for path in files})
        ending = rng.choice((*by_ending, ".json", ".json", ".csv"))
        path = rng.choice([one for one in files if one.suffix == ending] or files)
        if rng.random() < 0.08:
            _replace(rng, path)
        elif path.suffix == ".json" and rng.random() < 0.8:
            path.write_text(_bent(rng, path))
        elif path.suffix == ".csv" and rng.random() < 0.8:
            path.write_text(_cells(rng, path), "utf-8", "surrogatepass")
        else:
            mutators.file(rng, path)


def _replace(rng: random.Random, path: Path) -> None:
    path.unlink()
    match rng.randrange(5):
        case 0:
            path.symlink_to("/dev/zero")
        case 1:
            os.mkfifo(path)
        case 2:
            path.mkdir()
        case 3:
            path.symlink_to(path.name)


def _bent(rng: random.Random, path: Path) -> str:
    try:
        return json.dumps(mutators.bent(rng, json.loads(path.read_text("utf-8"))))
    except ValueError:  # a number of too many digits to be written in decimals, or changed before
        return "1" + "0" * 5000


def _cells(rng: random.Random, path: Path) -> str:
    try:
        rows = [row for row in csv.reader(io.StringIO(path.read_text("utf-8"))) if row]
    except (ValueError, csv.Error):
        return ""
    if rows:
        row = rng.choice(rows)
        row[rng.randrange(len(row))] = str(
            rng.choice((*mutators.TEXTS, "1e400", "-7", "ok", "failed"))
        )
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def _use(folder: Path, out: Path) -> None:
    """As a resumed sweep reads it, and as one of the commands does: some write into it."""
    command = (folder.parent / "command").read_text()
    subprocess.run(["cp", "-a", folder, out / "results"], check=True)
    folder = out / "results"
    store = Store(folder)
    stored.inputs_of(folder)
    for path in sorted((folder / "runs").glob("*")):
        with contextlib.suppress(DeepmfError):
            store.read_run(path.name)
    arguments: dict[str, tuple[object, ...]] = {
        "show": ("show", folder),
        "report": ("report", folder),
        "merge": ("merge", out / "merged", folder),
        "risk": ("risk", folder, "--out", out / "risk"),
        "check": ("check", folder, "--thresholds", _THRESHOLDS),
        "compare": ("compare", folder, folder),
    }
    runner.command(*arguments[command])


KINDS = (runner.Kind("results", _make, _change, _use),)
