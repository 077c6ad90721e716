"""Made-up attacks on the four-way junction of `sumo_nets`, as result folders."""

import csv
import gzip
import json
import shutil
from pathlib import Path

import numpy as np

from deepmf_sumo.results.tracks import TRACK_COLUMNS
from deepmf_sumo.spec.tasks import slug

from tests.support import worth_doubles

NET = Path(__file__).resolve().parents[2] / "sumo_nets" / "four_way" / "four_way.net.xml"
LEFT_IN = "w_in", "n_out"
"""The permissive left turn from west to north."""


def straight(start, speed, heading, steps=91):
    """Poses (T, 3) of somebody who keeps heading and speed."""
    way = np.arange(steps)[:, None] * 0.1 * speed * np.array([np.cos(heading), np.sin(heading)])
    return np.column_stack([np.array(start) + way, np.full(steps, heading)])


def eastward(x=-150.0, y=-4.8, speed=10.0):
    """Along the middle lane from west to east."""
    return straight((x, y), speed, 0.0)


class Attacks:
    """A result folder that is being filled with runs."""

    def __init__(self, out, version="0.1.0", net=NET):
        self.out, self.version, self.net = out, version, net
        self.keys, self.moments = {}, []
        (out / "runs").mkdir(parents=True)

    def add(
        self, scene, seed=0, *, av, opponent=None, hit=None, metrics=(), moment=None, spec="city",
        planner="idm lane", other=None, network="four_way", **changes,
    ):  # fmt: skip
        """Add a run; the AV is hit at step ``hit``, or touches somebody else at step ``other``."""
        run_id = f"{slug(spec)}--{slug(scene)}--{seed}"
        folder = self.out / "runs" / run_id
        (folder / "sumo").mkdir(parents=True)
        shutil.copyfile(self.net, folder / "sumo" / "net.net.xml")
        poses = {"ego": av, **({} if opponent is None else {"foe": opponent})}
        _tracks(folder / "tracks.csv.gz", poses)
        np.savez(folder / "plans.npz", plans=0)
        contacts = [
            {
                "kind": kind,
                "step": step,
                "first_id": "ego",
                "second_id": foe,
                "striker_id": foe,
                "closing_mps": 6.0,
                "delta_v_mps": 3.0,
                "sector": 4,
                "relative_mps": 6.0,
            }
            for kind, step, foe in (("av_opponent", hit, "foe"), ("av_other", other, "bus"))
            if step is not None
        ]
        known = {"min_gap": 0.0 if hit else 2.0, "ttc_min": 0.0 if hit else 4.0}
        if hit:
            known |= {**worth_doubles.metrics(), "delta_v": 6.0, "accident_type": 1.0}
        values = {
            "counterfactual": "episode",
            "run_id": run_id, "key": "k", "spec": spec, "scene": scene, "network": network,
            "seed": seed, "planner": "idm", "planner_label": planner, "adversary": "deepmf",
            "settings": {"planner": {}, "adversary": {}}, "weights": "open", "status": "ok",
            "error": "", "opponent": None if opponent is None else "foe",
            "outcome": contacts[0]["kind"] if contacts else "none", "contacts": contacts,
            "steps": len(av) - 11, "duration_steps": 80, "ended": "contact" if hit else "time",
            "search": {"simulations": 1},
            "expectations_broken": [], "timings": {"wall_s": 1.0},
            "metrics": {name: {"value": one} for name, one in {**known, **dict(metrics)}.items()},
            **changes,
        }  # fmt: skip
        (folder / "result.json").write_text(json.dumps(values))
        self.keys[run_id] = "k"
        if moment:
            names = ("edge", "following", "turn")
            self.moments.append({"run_id": run_id, **dict(zip(names, moment, strict=True))})
        self.write()
        return run_id

    def write(self):
        manifest = {"tool": "deepmf-sumo", "format_version": 1, "version": self.version}
        (self.out / "manifest.json").write_text(json.dumps({**manifest, "runs": self.keys}))
        if self.moments:
            with (self.out / "moments.csv").open("w", newline="") as file:
                writer = csv.DictWriter(file, self.moments[0])
                writer.writeheader()
                writer.writerows(self.moments)


def _tracks(file, poses):
    """Ten steps of history, then the attack."""
    lines = [TRACK_COLUMNS]
    for step in range(max(map(len, poses.values()))):
        for name, path in poses.items():
            if step < len(path):
                x, y, heading = path[step]
                role = "av" if name == "ego" else "opponent"
                lines.append(
                    f"{step},{(step - 10) * 0.1:.1f},{name},vehicle,{role},sumo,"
                    f"{x:.4f},{y:.4f},{heading:.5f},10.0,4.5,1.8,0.00"
                )
    file.write_bytes(gzip.compress("\n".join(lines).encode()))
