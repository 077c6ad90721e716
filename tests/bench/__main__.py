"""Speed and memory, printed side by side: ``make bench``; ``--episodes 1000`` for the long one.

Uses the recorded scenes of `DEEPMF_SUMO_SCENES`, else ``../shared/womd/val``; says so where there
are none.
"""

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from deepmf_sumo import plugins
from deepmf_sumo.scene import Budget, RecordedCase, Scene, readers
from deepmf_sumo.sumo import network
from deepmf_sumo.sumo.simulation import simulate

ROOT = Path(__file__).resolve().parents[2]
SCENES = Path(os.environ.get("DEEPMF_SUMO_SCENES", ROOT.parent / "shared" / "womd" / "val"))


def main() -> None:
    """Print every figure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--weights", default="open")
    options = parser.parse_args()
    start_up()
    if not SCENES.is_dir():
        print(
            f"no recorded scenes in {SCENES}: conversion, steps, cycles and memory are not measured"
        )
        return
    with tempfile.TemporaryDirectory() as folder:
        cases = conversion(options.scenes, Path(folder))
        steps(cases)
        for driver in ("planner", "human"):
            cycles([replace(case, av_driver=driver) for case in cases], options.weights)
        memory(cases, options.episodes)


def start_up() -> None:
    """``deepmf-sumo --help`` beside a bare interpreter."""
    program = Path(sys.executable).with_name("deepmf-sumo")
    bare = fastest([sys.executable, "-c", "pass"])
    ours = fastest([str(program), "--help"])
    print(f"--help: {ours:.2f} s, python -c pass: {bare:.2f} s, ratio {ours / bare:.1f}")


def fastest(command: list[str], tries: int = 5) -> float:
    """Least wall time of a command, seconds."""
    times = []
    for _ in range(tries):
        start = time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        times.append(time.perf_counter() - start)
    return min(times)


def conversion(count: int, folder: Path) -> list[RecordedCase]:
    """Reading and conversion a scene, one process."""
    start = time.perf_counter()
    found = (scene for scene in readers.scenes([SCENES]) if isinstance(scene, Scene))
    scenes = [scene for scene, _ in zip(found, range(count), strict=False)]
    read = (time.perf_counter() - start) / len(scenes)
    start = time.perf_counter()
    nets = [network.cached(scene, folder) for scene in scenes]
    built = (time.perf_counter() - start) / len(scenes)
    print(f"{len(scenes)} scenes: read {1000 * read:.0f} ms, converted {1000 * built:.0f} ms each")
    return [
        RecordedCase(
            name=scene.name,
            road=scene.road,
            av_id=scene.av_id,
            duration_steps=scene.tracks.steps - 1 - scene.now,
            traffic="log",
            seed=0,
            scene=scene,
            net=net,
            partner_id=scene.partner_id,
        )
        for scene, net in zip(scenes, nets, strict=True)
    ]


def steps(cases: list[RecordedCase]) -> None:
    """Milliseconds a simulated step, planner by planner, SUMO's start included and apart."""
    for name, values in (
        ("replay", {}),
        ("idm", {"perception": "lane"}),
        ("idm", {"perception": "corridor"}),
    ):
        planner = plugins.load("planners", name)
        settings = plugins.settings("planners", name, values)
        inside, outside = [], []
        for case in cases:
            start = time.perf_counter()
            rollout = simulate(case, planner.build(settings), None, rng=np.random.default_rng(0))
            wall = time.perf_counter() - start
            done = rollout.tracks.steps - 1 - rollout.now
            inside.append(1000 * sum(rollout.seconds.values()) / done)
            outside.append(1000 * wall / done)
        label = " ".join([name, *values.values()])
        print(
            f"a step, {label}: median {statistics.median(inside):.2f} ms, with start and end "
            f"{statistics.median(outside):.2f} ms"
        )


def cycles(cases: list[RecordedCase], weights: str) -> None:
    """A replanning cycle by part, and the generation time of S1, one torch thread and two."""
    import torch

    module = plugins.load("adversaries", "deepmf")
    replay = plugins.load("planners", "replay")
    for threads in (1, 2):
        torch.set_num_threads(threads)
        adversary = module.build(module.Settings(period_s=1.0), weights)
        parts, generation = [], []
        for number, case in enumerate(cases[:10]):
            attack = adversary.attack(
                case,
                lambda policy, case=case: simulate(
                    case, replay.build(replay.Settings()), policy, rng=np.random.default_rng(0)
                ),
                Budget(),
                np.random.default_rng(0),
            )
            if number:  # the first loads the weights and warms up
                parts += [plan.reason.milliseconds for plan in attack.rollout.plans if plan.reason]
                generation.append(attack.generation_s)
        total = statistics.median(sum(part.values()) for part in parts)
        detail = ", ".join(
            f"{name} {statistics.median(part[name] for part in parts):.0f}" for name in parts[0]
        )
        print(
            f"a cycle, AV of a {cases[0].av_driver}, {threads} threads: median {total:.0f} ms "
            f"({detail}); S1 generation median {statistics.median(generation):.2f} s a scene"
        )


def memory(cases: list[RecordedCase], episodes: int) -> None:
    """Growth of this process over episodes."""
    planner = plugins.load("planners", "idm")
    peak = []
    for number in range(episodes):
        case = cases[number % len(cases)]
        simulate(case, planner.build(planner.Settings()), None, rng=np.random.default_rng(number))
        peak.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    warm = min(len(cases), episodes - 1)
    print(f"memory: {peak[warm]:.0f} MB after {warm} episodes, {peak[-1]:.0f} MB after {episodes}")


if __name__ == "__main__":
    main()
