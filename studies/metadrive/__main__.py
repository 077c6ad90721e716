"""The same attacks on the same recorded scenes in MetaDrive and in SUMO, and how often they hit.

``python -m studies.metadrive RECORDING --weights womd --out OUT``
"""

import argparse
import json
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, Final, cast

import numpy as np

from deepmf_sumo import plugins
from deepmf_sumo.errors import DeepmfError, UsageError
from deepmf_sumo.files import cache_folder
from deepmf_sumo.judge.metrics import measure
from deepmf_sumo.results import statistics
from deepmf_sumo.scene import Attack, Budget, RecordedCase, Rollout
from deepmf_sumo.scene.policy import Policy
from deepmf_sumo.spec import Spec, tasks
from deepmf_sumo.spec.tasks import Task
from deepmf_sumo.study.sweep import episode
from deepmf_sumo.sumo.simulation.episode import run
from studies.metadrive.world import AvName, MetaDriveWorld, Passenger, environment, written

PLANNERS: Final[dict[AvName, dict[str, Any]]] = {
    "replay": {"name": "replay"},
    "idm": {"name": "idm", "parameters": "metadrive", "perception": "corridor"},
}
"""In SUMO; in MetaDrive its own policies."""
SIMULATORS: Final = ("metadrive", "sumo")
METHODS: Final[dict[str, dict[str, Any]]] = {
    "none": {"name": "none"},
    "paper": {"name": "deepmf", "form": "paper", "period_s": 1.0},
    "extended": {"name": "deepmf", "period_s": 1.0},
}
_MEASURED: Final = ("opponent_rms_acceleration", "avoidable", "collision_speed")


def planned(asked: argparse.Namespace, av: AvName, method: str) -> list[Task]:
    """The runs of a planner and a method, one a scene."""
    values = {
        "version": 3, "name": f"{av} {method}", "duration_s": 8.0, "traffic": "log",
        "source": {"recording": str(asked.recording.resolve())}, "planner": PLANNERS[av],
        "profile": "any", "adversary": METHODS[method], "weights": asked.weights,
        "seed": asked.seed,
    }  # fmt: skip
    return tasks.plan([Spec.model_validate(values)], cache_folder())[: asked.scenes]


def attacked(adversary: Any, task: Task, case: RecordedCase, world: MetaDriveWorld) -> Attack:
    """The adversary's attack in MetaDrive, of one simulation."""

    def simulate(policy: Policy | None) -> Rollout:
        rng = np.random.default_rng([*task.entropy(), 1])
        return run(case, world, Passenger(), policy, rng)

    rng = np.random.default_rng(task.entropy())
    attack: Attack = adversary.attack(case, simulate, Budget(simulations=1), rng)
    return attack


def line_of(simulator: str, task: Task, case: RecordedCase, rollout: Rollout) -> dict[str, Any]:
    """What the result keeps of a run."""
    contact = rollout.first("av_opponent")
    found = {one.name: one.value for one in measure(rollout, case)}
    driven = rollout.tracks.position_m[rollout.tracks.row(rollout.av_id), rollout.now :]
    return {
        "scene": task.scene,
        "simulator": simulator,
        "opponent": rollout.opponent_id,
        "outcome": rollout.outcome,
        "contact_s": None if contact is None else (contact.step - rollout.now) * rollout.dt_s,
        "av_m": float(np.hypot(*np.diff(driven, axis=0).T).sum()),
        **{name: found[name] for name in _MEASURED},
    }


def results(asked: argparse.Namespace, av: AvName, method: str) -> list[dict[str, Any]]:
    """The lines of all scenes in both simulators; those that the file has are kept."""
    file = asked.out / f"{av}_{method}.jsonl"
    lines = file.read_text().splitlines() if file.exists() else []
    done = [json.loads(line) for line in lines]
    known = {(one["simulator"], one["scene"]) for one in done}
    runs = planned(asked, av, method)
    cases = [cast("RecordedCase", episode.make_case(task, cache_folder())) for task in runs]
    written([case.scene for case in cases], asked.out / "scenes")
    choice = runs[0].spec.adversary
    settings = plugins.settings("adversaries", choice.name, choice.settings)
    adversary = plugins.load("adversaries", choice.name).build(settings, asked.weights)
    env = environment(asked.out / "scenes", len(runs), av)
    with closing(env), file.open("a") as table_file:
        for number, (task, case) in enumerate(zip(runs, cases, strict=True)):
            for simulator in SIMULATORS:
                if (simulator, task.scene) in known:
                    continue
                if simulator == "metadrive":
                    attack = attacked(adversary, task, case, MetaDriveWorld(env, number, case))
                else:
                    attack = episode.attack_case(task, case)
                done.append(line_of(simulator, task, case, attack.rollout))
                table_file.write(f"{json.dumps(done[-1])}\n")
                table_file.flush()
    return done


def check(asked: argparse.Namespace) -> None:
    """Raises UsageError without a recording, or for a folder with runs of other settings."""
    if not asked.recording.exists():
        raise UsageError(
            f"{asked.recording}: no such recording; give a file or a folder of scenes."
        )
    asked.out.mkdir(parents=True, exist_ok=True)
    file = asked.out / "asked.json"
    values = {
        "recording": str(asked.recording.resolve()), "weights": asked.weights,
        "scenes": asked.scenes, "seed": asked.seed,
    }  # fmt: skip
    if file.exists() and (before := json.loads(file.read_text())) != values:
        differ = ", ".join(key for key in values if before[key] != values[key])
        raise UsageError(f"{asked.out} has runs with other values of {differ}: name another --out.")
    file.write_text(json.dumps(values))


def table(asked: argparse.Namespace) -> Iterator[str]:
    """A line for each planner and method."""
    yield (
        f"{'AV':8}{'attack':10}{'hits in MetaDrive':>22}{'in SUMO':>22}{'in both':>9}"
        f"{'avoidable':>11}{'with others':>13}{'rms':>12}"
    )
    for av in asked.planners:
        for method in asked.methods:
            done = results(asked, av, method)
            sides = [
                {one["scene"]: one for one in done if one["simulator"] == simulator}
                for simulator in SIMULATORS
            ]
            hits = [
                {scene for scene, one in side.items() if one["outcome"] == "av_opponent"}
                for side in sides
            ]
            shares = [_share(len(hit), len(side)) for hit, side in zip(hits, sides, strict=True)]
            avoidable, others = (
                [sum(one[name] == value for one in side.values()) for side in sides]
                for name, value in (("avoidable", 1.0), ("outcome", "av_other"))
            )
            rms = "".join(f"{_mean('opponent_rms_acceleration', side):6.2f}" for side in sides)
            yield (
                f"{av:8}{method:10}{shares[0]:>22}{shares[1]:>22}{len(hits[0] & hits[1]):9}"
                f"{avoidable[0]:7}{avoidable[1]:4}{others[0]:9}{others[1]:4}{rms:>12}"
            )


def _share(hits: int, runs: int) -> str:
    share = statistics.rate([[float(number < hits)] for number in range(runs)])
    return f"{hits} of {runs} ({100 * share.low:.0f}-{100 * share.high:.0f} %)"


def _mean(name: str, side: dict[str, dict[str, Any]]) -> float:
    known = [one[name] for one in side.values() if one[name] is not None]
    return float(np.mean(known)) if known else float("nan")


def main() -> int:
    """The command line; 2 for what is wrong with it."""
    parser = argparse.ArgumentParser(prog="python -m studies.metadrive")
    parser.add_argument("recording", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="resumed where it exists")
    parser.add_argument("--weights", default="open")
    parser.add_argument("--scenes", type=int, help="the first of them; default: all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--planners", nargs="+", default=list(PLANNERS), choices=list(PLANNERS))
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=list(METHODS))
    asked = parser.parse_args()
    try:
        check(asked)
        for line in table(asked):
            sys.stdout.write(f"{line}\n")
    except DeepmfError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
