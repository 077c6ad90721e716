"""Made-up result folders, and rows as a gate reads them."""

import json
from pathlib import Path

from deepmf_sumo.results import run_sets
from deepmf_sumo.results.reader import Results, Run
from deepmf_sumo.results.run_sets import RunSet
from deepmf_sumo.study.plans import tables


def result(scene="a", seed=0, *, hit=False, spec="made up", **changes):
    """A run in which somebody was attacked, as far as a gate looks at it."""
    metrics = {"min_gap": 0.0 if hit else 2.0, "ttc_min": 0.0 if hit else None}
    if hit:
        metrics |= {"avoidable": 1.0, "av_at_fault": 0.0, "delta_v": 4.0, "collision_speed": 6.0}
    return {
        "run_id": f"{spec.replace(' ', '-')}--{scene}--{seed}",
        "key": f"key of {scene} {seed}",
        "spec": spec,
        "scene": scene,
        "network": "crossing",
        "seed": seed,
        "planner": "idm",
        "planner_label": "idm lane",
        "adversary": "deepmf",
        "settings": {"planner": {}, "adversary": {"period_s": 1.0}},
        "weights": "open",
        "budget": {},
        "status": "ok",
        "error": "",
        "opponent": "b",
        "outcome": "av_opponent" if hit else "none",
        "ended": "contact" if hit else "time",
        "steps": 40,
        "search": {"simulations": 1},
        "contacts": [{"kind": "av_opponent", "sector": 0, "relative_mps": 6.0}] if hit else [],
        "metrics": {name: {"value": value} for name, value in metrics.items()},
        "expectations_broken": [],
        "timings": {"wall_s": 1.5},
        **changes,
    }


def failed(scene="a", seed=0, status="failed"):
    """A run that has no result."""
    left = ("opponent", "outcome", "ended", "steps", "search", "contacts", "metrics")
    values = result(scene, seed, status=status, error="SUMO refused")
    return {key: value for key, value in values.items() if key not in left}


def runs_of_plan(results):
    """The frame of results, as tables of plans take it."""
    runs = (Run.of_result(Path("out"), one) for one in results)
    return tables.runs_of(Results(folders=(), runs=tuple(runs)))


def write_folder(out, results, missing=(), version="0.1.0"):
    """A result folder of these runs; ``missing`` are ids of runs that were never begun."""
    out.mkdir(parents=True)
    for one in results:
        folder = out / "runs" / one["run_id"]
        folder.mkdir(parents=True)
        (folder / "result.json").write_text(json.dumps(one))
    manifest = {
        "tool": "deepmf-sumo",
        "format_version": 1,
        "version": version,
        "runs": {**{one["run_id"]: one["key"] for one in results}, **dict.fromkeys(missing, "x")},
    }
    (out / "manifest.json").write_text(json.dumps(manifest))
    return out


def row(scene="a", seed=0, *, spec="made up", **values):
    """A judged run with these values, and with columns that differ from the usual ones."""
    return {
        "run_id": f"{spec}--{scene}--{seed}", "spec": spec, "network": scene, "scene": scene,
        "seed": seed, "method": spec, "planner_label": "idm lane", "status": "ok", "judged": True,
        "expectations_broken": (), **values,
    }  # fmt: skip


def results_of(rows, source, version="0.1.0"):
    runs = run_sets.frame_of(list({one["run_id"]: one for one in rows}.values()))
    return RunSet(source=source, version=version, runs=runs)
