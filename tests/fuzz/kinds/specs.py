"""Specs: read, and planned as `run` does before anything is simulated."""

import random
from pathlib import Path
from typing import Any

import yaml

from deepmf_sumo import spec
from deepmf_sumo.spec import tasks
from deepmf_sumo.study.sweep.inputs import fingerprinted

from tests.fuzz import mutators, runner

_SPEC = {
    "version": 3,
    "name": "one",
    "source": {
        "network": "tiny.sumocfg",
        "start_s": 2.0,
        "av": {"vehicle": "av"},
        "sumo_options": ["--step-length", "0.1"],
    },
    "duration_s": 1.0,
    "traffic": "sumo",
    "weights": "open",
    "seed": 3,
    "planner": {"name": "idm", "perception": "lane"},
    "profile": "lawful",
    "adversary": {
        "name": "deepmf",
        "version": "S1",
        "rule": "expected",
        "form": {"preset": "extended", "reactions": 16},
        "sector": "left",
        "goal": "hit",
        "constraints": ["fair", "on_road"],
    },
    "opponents": "in_turn",
    "turns": {"longest_s": 8.0},
    "budget": {"simulations": 4},
    "expect": {"av_collision": True},
}
_TAGS = ("int", "float", "bool", "null", "str", "binary", "timestamp", "set", "omap", "python/x")
_PIECES = ("*a", "&a ", "[", "{", "]", "}", "? ", "- ", "--- ", "| ", "<<: ", "%Y 9\n", "\t", "\n")
_SCALARS = ("0x" + "f" * 200, "1:" * 300 + "1", "2020-99-99", ".nan", "-.inf", "1e999", "~", "''")
_SETS = ("seed=1", "planner=idm", "adversary=S1", "source.start_s=1.0", "turns.longest_s=2.0",
    "profile=any", "duration_s=30")  # fmt: skip


def _make(folder: Path) -> Path:
    (folder / "tiny.sumocfg").write_text("<configuration/>")
    path = folder / "one.yaml"
    path.write_text(yaml.safe_dump(_SPEC, sort_keys=False))
    return path


def _change(rng: random.Random, path: Path) -> None:
    match rng.randrange(4):
        case 0:
            mutators.file(rng, path)
        case 1:
            tree = mutators.bent(rng, yaml.safe_load(path.read_text()))
            path.write_text(_text(tree), "utf-8", "surrogatepass")
        case 2:
            lines = path.read_text().splitlines()
            at = rng.randrange(len(lines))
            key, colon, value = lines[at].partition(": ")
            tag = f"!!{rng.choice(_TAGS)} " if rng.random() < 0.6 else ""
            new = rng.choice((value, *_SCALARS, '""', "_"))
            lines[at] = f"{key}{colon}{tag}{new}"
            path.write_text("\n".join(lines))
        case _:
            text = path.read_text()
            for _ in range(rng.randint(1, 3)):
                at = rng.randrange(len(text))
                piece = rng.choice(_PIECES) * rng.choice((1, 1, 3, 1000))
                text = text[:at] + piece + text[at:]
            path.write_text(text)


def _text(tree: Any) -> str:
    try:
        return yaml.dump(tree, sort_keys=False, allow_unicode=True)
    except ValueError:  # a number of too many digits to be written in decimals
        return "version: 1" + "0" * 400


def _use(path: Path, out: Path) -> None:
    """As `run` reads it, with an assignment or without."""
    sets = _SETS[len(path.read_bytes()) % len(_SETS)]
    for loaded in (spec.load(path), spec.load(path, [sets])):
        planned, _ = fingerprinted(tasks.plan([loaded], out))
        for task in planned:
            assert tasks.is_run_id(task.run_id)
            (out / "spec.yaml").write_text(
                yaml.safe_dump(task.resolved(), sort_keys=False, allow_unicode=True), "utf-8"
            )


KINDS = (runner.Kind("specs", _make, _change, _use),)
