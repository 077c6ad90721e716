"""Result folders made by hand, with the writers of real ones: what figures are tested with."""

import csv
from dataclasses import replace

import numpy as np
import yaml

from deepmf_sumo import files, spec
from deepmf_sumo.results import artifacts, result
from deepmf_sumo.results.tracks import write_tracks
from deepmf_sumo.scene import (
    Attack,
    Forecast,
    Futures,
    MetricValue,
    OpponentScores,
    Plan,
    PlanReason,
)
from deepmf_sumo.scene.readers import npz
from deepmf_sumo.spec.tasks import Label, Task

from tests.support.rollout_doubles import case_of, contact_of, rollout_of, straight

OTHERS = {
    "c": straight(20, 3.5, 8),
    "d": straight(-25, 0, 9),
    "e": straight(30, 0, 8),
    "NA": straight(-30, 3.5, 8),
}


def forecast(modes=2):
    futures = Futures(
        agent_id="b", position_m=np.ones((modes, 80, 2)), heading_rad=np.zeros((modes, 80))
    )
    return Forecast(futures=futures, probability=np.full(modes, 1 / modes))


def plan(scores=None):
    """The opponent's plan; ``scores`` are chances by id."""
    known = scores and OpponentScores(
        ids=tuple(scores),
        logits=np.log([p / (1 - p) for p in scores.values()]),
        partner_logits=np.zeros(len(scores)),
    )
    reason = PlanReason(
        scores=known or None,
        candidates=forecast(),
        reactions=(),
        collides=np.zeros((2, 0), bool),
        collision_step=np.zeros((2, 0)),
        value=np.zeros(2),
        product=np.zeros(2),
        chosen=0,
        rule="expected",
        bent_m=np.zeros(2),
    )
    pose = straight(-8, 3.5, 12, steps=80)
    return Plan(
        agent_id="b",
        first_step=11,
        position_m=pose[:, :2],
        heading_rad=pose[:, 2],
        speed_mps=np.full(80, 12.0),
        reason=reason,
    )


class Folder:
    """A result folder that is being filled."""

    def __init__(self, root):
        self.root, self.out, self.rows = root, root / "out", []
        (self.out / "runs").mkdir(parents=True)

    def _recording(self, scene):
        path = self.root / f"{scene}.npz"
        if not path.exists():
            npz.write(replace(case_of().scene, name=scene), path)
        return path

    def _task(self, scene, method, adversary, planner, part):
        path = self.root / f"{method}-{planner}.yaml".replace(" ", "_").replace("$", "_")
        source = {"recording": str(self._recording(scene)), "scenes": "all"}
        values = {"version": 1, "name": method, "source": source, "adversary": adversary}
        path.write_text(yaml.safe_dump({**values, "planner": "replay", "weights": "open"}))
        run_id = f"{len(self.rows):02d}-{scene}"
        label = Label(method=method, planner=planner, part=part)
        return Task(run_id=run_id, spec=spec.load(path), scene=scene, label=label)

    def add(
        self, scene, method="S1", adversary="S1", planner="replay", part="main", hit=True,
        sector=0, speed=12.0, opponent="b", scores=None, metrics=(), turn=0.0,
        course=0.0,
    ):  # fmt: skip
        """Add a run; its opponent drives at ``speed`` and hits the AV at step 40."""
        steps = 41 if hit else 91
        b = {"b": straight(-8, 3.5, speed, steps=steps, heading=course)} if opponent else {}
        others = {name: path[:steps] for name, path in OTHERS.items()}
        paths = {"av": straight(0, 0, 10, steps=steps, heading=turn), **b, **others}
        poses = np.array([40.0, 0.0, turn]), np.array([37.0, 1.0, turn])
        contact = replace(contact_of(), pose_first=poses[0], pose_second=poses[1], sector=sector)
        plans = [plan(scores)] if opponent else []
        rollout = rollout_of(paths, [contact] if hit else [], opponent, plans)
        task = self._task(scene, method, adversary, planner, part)
        folder = self.out / "runs" / task.run_id
        folder.mkdir()
        files.write(folder / "spec.yaml", yaml.safe_dump(task.resolved()))
        write_tracks(folder / "tracks.csv.gz", rollout)
        artifacts.write_plans(folder / "plans.npz", rollout)
        values = [
            MetricValue(name=name, value=value, unit="1", better="lower")
            for name, value in dict(metrics).items()
        ]
        found = result.finished(task, case_of(), Attack(rollout=rollout), values, 0.0)
        found["expectations_broken"] = []
        files.write_json(folder / "result.json", found)
        self.rows.append(result.row(found))
        self.write()
        return rollout

    def fail(self, scene):
        """Add a row of a run that did not go through."""
        task = self._task(scene, "S1", "S1", "replay", "main")
        self.rows.append(result.row(result.unfinished(task, "failed", "no reason")))
        self.write()

    def write(self):
        with (self.out / "runs.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, result.COLUMNS)
            writer.writeheader()
            writer.writerows(self.rows)
