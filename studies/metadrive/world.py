"""A recorded scene in MetaDrive's simulator, as a world of the episode's loop.

MetaDrive drives the AV, by the recording or by its own IDM, and replays the other agents; the
opponent is put on the poses of its plan. DeepMF sees MetaDrive through the same views as SUMO, and
contacts are judged by the same oriented boxes.
"""

import pickle
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from deepmf_sumo.errors import PluginError
from deepmf_sumo.exporters.scenarionet import described, packed
from deepmf_sumo.scene import (
    AgentId,
    Case,
    Command,
    Driver,
    Event,
    Floats,
    RecordedCase,
    Scene,
    SignalState,
    VehicleModel,
    View,
)
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.sumo.simulation.frame import Body, Frame, Pose
from deepmf_sumo.sumo.simulation.log_plan import recorded_body, recorded_frame
from deepmf_sumo.sumo.simulation.ownership import LogOwner, NextOwner

AvName = Literal["replay", "idm"]
_STANDS_MPS: Final = 0.05


def written(scenes: Sequence[Scene], folder: Path) -> None:
    """Write scenes from now on as a dataset that MetaDrive reads; the order stays."""
    folder.mkdir(parents=True, exist_ok=True)
    summary, mapping = {}, {}
    for number, scene in enumerate(scenes):
        name = f"sd_deepmf_{number:05d}.pkl"
        values = described(from_now(scene))
        values["metadata"]["id"] = values["id"] = name
        (folder / name).write_bytes(packed(values))
        summary[name], mapping[name] = values["metadata"], ""
    for name, content in (("dataset_summary", summary), ("dataset_mapping", mapping)):
        (folder / f"{name}.pkl").write_bytes(pickle.dumps(content))


def from_now(scene: Scene) -> Scene:
    """The scene without the steps before the current one: MetaDrive begins at the first."""
    steps = slice(scene.now, None)
    return replace(
        scene,
        tracks=scene.tracks.window(scene.now, scene.tracks.steps),
        timestamps_s=scene.timestamps_s[steps],
        signals=replace(
            scene.signals, state=scene.signals.state[:, steps], seen=scene.signals.seen[:, steps]
        ),
        now=0,
    )


def environment(folder: Path, scenes: int, av: AvName) -> Any:
    """MetaDrive with the scenes of a folder; nothing is drawn, and nothing ends an episode.

    Raises PluginError where MetaDrive is not installed.
    """
    try:
        from metadrive.component.navigation_module.trajectory_navigation import TrajectoryNavigation
        from metadrive.envs.scenario_env import ScenarioEnv
        from metadrive.policy.idm_policy import TrajectoryIDMPolicy
        from metadrive.policy.replay_policy import ReplayEgoCarPolicy
    except ImportError:
        raise PluginError("MetaDrive is not installed; install deepmf-sumo[metadrive].") from None

    return ScenarioEnv(
        {
            "use_render": False,
            "log_level": 50,
            "agent_policy": {"replay": ReplayEgoCarPolicy, "idm": TrajectoryIDMPolicy}[av],
            "data_directory": str(folder),
            "num_scenarios": scenes,
            "filter_overlapping_car": False,
            "store_map": False,
            "store_data": False,
            "vehicle_config": {
                "navigation_module": TrajectoryNavigation,
                "lidar": {"num_lasers": 0, "distance": 50},
                "side_detector": {"num_lasers": 0, "distance": 50},
            },
        }
    )


class Passenger:
    """The planner of the loop: MetaDrive drives the AV, whatever it commands."""

    model: VehicleModel | None = None

    def reset(self, case: Case, rng: np.random.Generator) -> None:
        """Nothing."""

    def act(self, view: View) -> Command:  # noqa: ARG002
        """A command without effect."""
        return Command(kind="sumo")


class _Av:
    """What the loop asks of the AV; SUMO's path and leaders are not there."""

    leaders: tuple[AgentId, ...] | None = None
    present = True

    def path(self) -> Floats | None:
        """No path: the passenger does not need one."""
        return None


class MetaDriveWorld:
    """MetaDrive at the current step of a case; see `sumo.simulation.world.World`.

    Args:
        env: of `environment`.
        number: of the case's scene in its dataset.
        case: with a recording.
    """

    def __init__(self, env: Any, number: int, case: RecordedCase) -> None:
        self.av, self.events = _Av(), list[Event]()
        self._env, self._case = env, case
        self._tracks, self._step = case.scene.tracks, case.scene.now
        self._row = {agent: row for row, agent in enumerate(self._tracks.ids)}
        self.next_owner: NextOwner = LogOwner(self._tracks)
        self._origin = self._tracks.position_m[self._row[case.av_id], self._step]
        env.reset(seed=number)

    def history(self) -> list[Frame]:
        """The recorded steps up to the current one."""
        everyone = np.ones(self._tracks.agents, bool)
        steps = range(self._case.scene.now + 1)
        return [recorded_frame(self._tracks, step, everyone) for step in steps]

    def body(self, agent: AgentId) -> Body:
        """Kind and size as recorded."""
        return recorded_body(self._tracks, self._row[agent])

    def signals(self) -> dict[str, SignalState]:
        """The recorded lights at this step."""
        signals = self._case.scene.signals
        return signals.at(min(self._step, signals.state.shape[1] - 1))

    def step(self, command: Command, poses: Mapping[AgentId, Pose | None]) -> Frame:  # noqa: ARG002
        """One step of MetaDrive, at whose end the opponent is at the pose."""
        self._step += 1
        driven = {}
        for opponent, pose in poses.items():
            if pose is not None and self._put(opponent, pose):
                driven[opponent] = self._at_height(opponent, pose), Driver.POLICY
        self._env.step([0.0, 0.0])
        shown = {self._case.av_id: (self._pose(self._env.agent), Driver.PLANNER), **driven}
        logged = np.array([agent not in shown for agent in self._tracks.ids])
        return recorded_frame(self._tracks, self._step, logged).with_poses(shown)

    def _put(self, opponent: AgentId, pose: Pose) -> bool:
        """Change what MetaDrive replays of the opponent at this step; False: it is not there."""
        manager = self._env.engine.traffic_manager
        name = manager._scenario_id_to_obj_id.get(opponent)  # noqa: SLF001
        if name is None:
            if not any(event.kind == "opponent_gone" for event in self.events):
                detail = "MetaDrive does not have it"
                gone = Event(
                    step=self._step, agent_id=opponent, kind="opponent_gone", detail=detail
                )
                self.events.append(gone)
            return False
        replayed = manager.get_policy(name).traj_info
        at = self._step - self._case.scene.now
        replayed.extend([None] * (at + 1 - len(replayed)))
        course = pose.heading_rad if pose.course_rad is None else pose.course_rad
        replayed[at] = {
            "valid": True,
            "position": np.array([pose.x_m, pose.y_m]) - self._origin,
            "velocity": pose.speed_mps * frames.unit(np.array(course)),
            "heading": pose.heading_rad,
            "heading_theta": pose.heading_rad,
            "angular_velocity": 0.0,
        }
        return True

    def _at_height(self, agent: AgentId, pose: Pose) -> Pose:
        """On the level where it was recorded: MetaDrive is flat."""
        z_m = float(self._tracks.z_m[self._row[agent], self._case.scene.now])
        return replace(pose, z_m=z_m)

    def _pose(self, av: Any) -> Pose:
        """Of the AV in MetaDrive."""
        x, y = np.asarray(av.position, float)[:2] + self._origin
        velocity = np.asarray(av.velocity, float)[:2]
        speed = float(np.hypot(*velocity))
        pose = Pose(
            x_m=float(x),
            y_m=float(y),
            heading_rad=float(av.heading_theta),
            speed_mps=speed,
            course_rad=float(np.arctan2(*velocity[::-1])) if speed > _STANDS_MPS else None,
        )
        return self._at_height(self._case.av_id, pose)
