"""Train a driver on attacked traffic, and compare it with one that never met an attack.

The driver chooses an acceleration five times a second. It learns with PPO (stable-baselines3), in
several processes: one driver in plain traffic alone, the other one also under attacks of DeepMF,
which become more aggressive. Both train for the same number of steps. Then both drive in scenes
that neither has seen, without attacks and under attacks, and `deepmf-sumo compare` says what the
attacks taught.

    pip install "deepmf-sumo[gym]" stable-baselines3
    python examples/train_planner.py record --out drivers     # scenes of sumo_nets/
    python examples/train_planner.py train --out drivers      # a quarter of an hour on two cores
    python examples/train_planner.py test --out drivers

A trained driver is a planner of a spec, and needs numpy alone: ``planner: {name:
"train_planner:Driver", policy: drivers/attacked.npz}``, with the folder of this file in PYTHONPATH.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from deepmf_sumo.gym import AttackEnv
from deepmf_sumo.plugins import Settings as PluginSettings
from deepmf_sumo.results.reader import Results
from deepmf_sumo.scene import Case, Command, Floats, VehicleModel, View
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.spec import Spec

ROOT = Path(__file__).resolve().parents[1]
NETWORKS = ("arterial", "four_way", "roundabout", "rural")
SEEDS = {"train": 1, "held_out": 2}
ACCELERATIONS_MPS2 = (-8.0, -4.0, -2.0, 0.0, 2.0)
HELD_STEPS = 2
"""A choice holds for 0.2 s."""
NEAREST = 6
LOOK_AHEAD_S = 4.0
SLOWEST_LIMIT_MPS = 8.0
STAGES = ((0.0, 0.0), (0.3, 0.5), (0.6, 1.0))
"""From which share of the training on the attacks have which aggressiveness."""
PLAIN_SHARE = 0.3
"""Of the episodes of the attacked driver, so that it does not learn to brake for everything."""
REWARD = {"progress": 0.01, "comfort": 0.0005, "contact": 2.0, "findings_only": True}


def observed(view: View) -> Floats:
    """(4 + 9 N) the AV's speed and its change, and the N vehicles that come closest to the AV.

    Of each: whether there is one, position, velocity and heading in the AV's frame, and the time
    and the distance of the closest approach if both keep their velocity.
    """
    tracks = view.history
    me = tracks.row(view.av_id)
    heading, length = float(tracks.heading_rad[me, -1]), float(tracks.size_m[me, 0])
    speed = tracks.speed_mps[me, -2:]
    others = np.flatnonzero(tracks.valid[:, -1] & (np.arange(tracks.agents) != me))
    at = frames.to_local(tracks.position_m[others, -1], tracks.position_m[me, -1], heading)
    moving = frames.to_local(
        tracks.velocity_mps[others, -1] - tracks.velocity_mps[me, -1], np.zeros(2), heading
    )
    turned = tracks.heading_rad[others, -1] - heading
    square = np.maximum((moving**2).sum(axis=1), 1e-3)
    closest_s = np.clip(-(at * moving).sum(axis=1) / square, 0.0, LOOK_AHEAD_S)
    closest_m = np.hypot(*(at + closest_s[:, None] * moving).T) - length / 2
    order = np.argsort(closest_m + closest_s, kind="stable")[:NEAREST]
    each = np.column_stack(
        [
            np.ones(len(others)), at / (30.0, 10.0), moving / 10.0, np.cos(turned), np.sin(turned),
            closest_s / LOOK_AHEAD_S, closest_m / 5.0,
        ]
    )[order]  # fmt: skip
    table = np.zeros((NEAREST, each.shape[1]))
    table[: len(each)] = np.clip(each, -3.0, 3.0)
    change = (speed[-1] - speed[0]) / view.dt_s
    own = [speed[-1] / 10.0, change / 5.0, length / 5.0, view.steps_left / 100.0]
    return np.concatenate([own, table.ravel()])


def command(choice: int, view: View, limit_mps: float) -> Command:
    """The AV's speed after a step of a choice among `ACCELERATIONS_MPS2`."""
    speed = speed_of(view) + ACCELERATIONS_MPS2[choice] * view.dt_s
    return Command(kind="speed", speed_mps=float(np.clip(speed, 0.0, limit_mps)))


def speed_of(view: View) -> float:
    """The AV's, m/s."""
    return float(view.history.speed_mps[view.history.row(view.av_id), -1])


def limit_of(view: View) -> float:
    """The driver never drives faster than at the beginning, or than 8 m/s."""
    return max(speed_of(view), SLOWEST_LIMIT_MPS)


class Traffic(gymnasium.Env[Floats, int]):
    """Episodes of recorded scenes, plain or attacked as the stage of the training says."""

    def __init__(self, scenes: Path, *, attacked: bool, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._attacked, self._scenes = attacked, scenes
        self._names = sorted(file.stem for file in scenes.rglob("*.npz"))
        self._environments: dict[float | None, AttackEnv] = {}
        self._done = 0.0
        self._limit_mps = 0.0
        self.action_space = gymnasium.spaces.Discrete(len(ACCELERATIONS_MPS2))
        size = 4 + 9 * NEAREST
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float64)

    def train_on(self, share: float) -> None:
        """``share`` of the training is done."""
        self._done = share

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Floats, Any]:
        """A scene drawn at random, with the attack of the stage or without one."""
        attack = self._attacked and self._rng.random() >= PLAIN_SHARE
        how = next(how for since, how in reversed(STAGES) if self._done >= since)
        self._now = self._environment(how if attack else None)
        scene = str(self._rng.choice(self._names))
        self._now.reset(seed=int(self._rng.integers(2**31)), options={"scene": scene})
        self._limit_mps = limit_of(self._now.view)
        return observed(self._now.view), {}

    def step(self, action: int) -> tuple[Floats, float, bool, bool, Any]:
        """Drive for 0.2 s."""
        total, over, late = 0.0, False, False
        for _ in range(HELD_STEPS):
            chosen = command(int(action), self._now.view, self._limit_mps)
            _, reward, over, late, _ = self._now.step(chosen)
            total += reward
            if over or late:
                break
        return observed(self._now.view), total, over, late, {}

    def _environment(self, aggressiveness: float | None) -> AttackEnv:
        if aggressiveness not in self._environments:
            adversary: dict[str, Any] = {"name": "none"}
            if aggressiveness is not None:
                adversary = {
                    "name": "deepmf", "period_s": 2.0, "aggressiveness": aggressiveness,
                    "constraints": ["no_rear_end"],
                }  # fmt: skip
            spec = Spec.model_validate(
                {
                    "version": 3, "name": "training", "duration_s": 8.0, "traffic": "sumo",
                    "source": {"recording": str(self._scenes)}, "adversary": adversary,
                    "planner": {"name": "idm", "perception": "corridor"}, "profile": "any",
                }
            )  # fmt: skip
            self._environments[aggressiveness] = AttackEnv(spec, reward=REWARD)
        return self._environments[aggressiveness]


class Driver:
    """A trained driver as a planner plug-in; ``policy``: a file that `train` wrote."""

    class Settings(PluginSettings):
        """Keys of the planner in a spec."""

        policy: str

    model: VehicleModel | None = None

    @classmethod
    def build(cls, settings: "Driver.Settings") -> "Driver":
        """The planner."""
        return cls(settings.policy)

    def __init__(self, policy: str) -> None:
        with np.load(policy) as layers:
            self._layers = [layers[name] for name in layers.files]

    def reset(self, case: Case, rng: np.random.Generator) -> None:
        """Start of an episode."""
        self._limit_mps: float | None = None
        self._left = self._choice = 0

    def act(self, view: View) -> Command:
        """The most likely choice of the policy, held for 0.2 s."""
        if self._limit_mps is None:
            self._limit_mps = limit_of(view)
        if self._left == 0:
            self._left, self._choice = HELD_STEPS, self._chosen(observed(view))
        self._left -= 1
        return command(self._choice, view, self._limit_mps)

    def _chosen(self, state: Floats) -> int:
        *hidden, (weight, bias) = zip(self._layers[::2], self._layers[1::2], strict=True)
        for matrix, offset in hidden:
            state = np.tanh(matrix @ state + offset)
        return int(np.argmax(weight @ state + bias))


def written(model: Any, file: Path) -> None:
    """Write the layers of a policy of stable-baselines3."""
    policy = model.policy
    linear = [one for one in policy.mlp_extractor.policy_net if hasattr(one, "weight")]
    layers = [array for one in (*linear, policy.action_net) for array in (one.weight, one.bias)]
    np.savez(file, *[array.detach().numpy().astype(float) for array in layers])


def record(out: Path, scenes: int) -> None:
    """Record scenes of the packaged networks to train on, and others to test with."""
    for part, seed in SEEDS.items():
        for name in NETWORKS:
            config = ROOT / "sumo_nets" / name / f"{name}.sumocfg"
            run(
                "data", "record", config, "--out", out / part / name, "--scenes", scenes,
                "--seed", seed,
            )  # fmt: skip


def train(out: Path, steps: int, seed: int, jobs: int) -> None:
    """Train both drivers one after the other, each for ``steps`` of 0.1 s."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.vec_env import SubprocVecEnv, VecMonitor

    choices = steps // HELD_STEPS

    class Curriculum(BaseCallback):
        def _on_step(self) -> bool:
            return True

        def _on_rollout_start(self) -> None:
            self.training_env.env_method("train_on", self.num_timesteps / choices)

    torch.set_num_threads(1)
    for name in ("plain", "attacked"):

        def traffic(number: int, name: str = name) -> Any:
            return lambda: Traffic(
                out / "train", attacked=name == "attacked", seed=1000 * seed + number
            )

        environments = VecMonitor(SubprocVecEnv([traffic(one) for one in range(jobs)], "spawn"))
        model = PPO(
            "MlpPolicy", environments, n_steps=1024 // jobs, batch_size=128, gamma=0.97,
            learning_rate=5e-4, ent_coef=0.005, seed=seed, device="cpu", verbose=1,
        )  # fmt: skip
        with torch.no_grad():  # it begins with a driver that mostly keeps its speed
            model.policy.action_net.bias[ACCELERATIONS_MPS2.index(0.0)] = 2.0
        model.learn(choices, callback=Curriculum())
        environments.close()
        written(model, out / f"{name}.npz")


def test(out: Path, jobs: int) -> int:
    """Run both drivers and the IDM without attacks and under attack; the last `compare`'s code."""
    missing = [
        name for name in ("held_out", "plain.npz", "attacked.npz") if not (out / name).exists()
    ]
    if missing:
        print(f"{out} has no {', '.join(missing)}: record and train first", file=sys.stderr)
        return 2
    spec = out / "test.yaml"
    spec.write_text(
        "version: 3\nname: test\nduration_s: 8.0\ntraffic: sumo\n"
        f"source: {{recording: {(out / 'held_out').resolve()}}}\n"
        "profile: any\nadversary: {name: deepmf, version: S1, constraints: [no_rear_end]}\n"
    )
    planners = {
        name: f"{{name: 'train_planner:Driver', policy: {(out / name).resolve()}.npz}}"
        for name in ("plain", "attacked")
    }
    planners["idm"] = "{name: idm, perception: corridor}"
    told, code = [], 0
    for part, more in (("calm", ("--set", "adversary=none")), ("under_attack", ())):
        folders = {name: out / part / name for name in planners}
        for name, planner in planners.items():
            run(
                "run", spec, *more, "--set", f"planner={planner}", "--out", folders[name],
                "--jobs", jobs, "--no-pictures", "--overwrite",
            )  # fmt: skip
            told.append(f"{part:13} {name:9} {counted(folders[name])}")
        judged = ("av_collision_rate", "av_progress_m", "av_hardest_braking_mps2")
        quantities = [part for name in judged for part in ("--quantity", name)]
        code = run("compare", folders["plain"], folders["attacked"], *quantities)
    print("\n".join(told))
    return code


def counted(folder: Path) -> str:
    """In how many runs the AV touched a vehicle, how many findings there were, how far it drove."""
    runs = Results.of(folder).done
    contacts = [[one["kind"] for one in run.result["contacts"]] for run in runs]
    touched = sum(any(kind.startswith("av_") for kind in kinds) for kinds in contacts)
    findings = sum(run.finding for run in runs)
    driven_m = np.mean([run.metric("av_progress") for run in runs])
    return f"{touched} of {len(runs)} touched a vehicle, {findings} findings; {driven_m:.0f} m"


def run(*arguments: object) -> int:
    """A command of deepmf-sumo; its exit code."""
    command = [sys.executable, "-m", "deepmf_sumo.cli.main", *map(str, arguments)]
    places = [str(Path(__file__).resolve().parent), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, places))}
    return subprocess.run(command, env=environment, check=False).returncode


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("record", "train", "test"))
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--scenes", type=int, default=40, help="of each network")
    parser.add_argument("--steps", type=int, default=60_000, help="of each driver")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_args()
    if asked.what == "record":
        record(asked.out, asked.scenes)
    elif asked.what == "train":
        train(asked.out, asked.steps, asked.seed, asked.jobs)
    else:
        return test(asked.out, asked.jobs)
    return 0


if __name__ == "__main__":
    sys.exit(main())
