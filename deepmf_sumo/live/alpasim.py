"""A traffic service for AlpaSim: the log of a scene, in which DeepMF attacks the ego.

AlpaSim asks its traffic service where all objects of a scene are at the next time, and says where
the ego is. Up to the handover, objects are where the log has them; after it an opponent is where
its plan puts it, and all others stay in the log: they do not react. Objects that are static do not
attack, nor those whose class is not known here.

The calls carry no road. ``SCENE_ID.net.xml`` in a folder is the SUMO network of a scene, in the
scene's local frame (x, y in m); scenes without one are not available.

It needs the extra ``alpasim`` (grpcio).
"""

import importlib
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import numpy as np
import shapely

import deepmf_sumo
from deepmf_sumo.errors import RunError, UsageError
from deepmf_sumo.live.alpasim_log import EGO, STEP_US, LoggedScene, RefusedCall, pose_message
from deepmf_sumo.live.alpasim_messages import CALLS, MESSAGES, SERVICE
from deepmf_sumo.live.attacker import AttackRequest, policy_of, spec_of, triggers_of
from deepmf_sumo.live.record import SessionRecord, Setting
from deepmf_sumo.live.session import LiveAttack
from deepmf_sumo.scene import HISTORY_STEPS, AgentId, Driver, RoadMap, TurnRules
from deepmf_sumo.scene.policy import Policy
from deepmf_sumo.sumo.network.sumo_road import road_of_net
from deepmf_sumo.sumo.simulation.attack_schedule import AttackSchedule
from deepmf_sumo.sumo.simulation.frame import Frame, Pose
from deepmf_sumo.sumo.simulation.log_plan import recorded_body, recorded_frame
from deepmf_sumo.sumo.simulation.ownership import LogOwner
from deepmf_sumo.sumo.simulation.recorder import EpisodeRecord, Recorder

_ENDING: Final = ".net.xml"
_OFF_ROAD_M: Final = 10.0
"""An ego whose log is mostly farther from every lane is on another road, or in another frame."""


class _Owner(LogOwner):
    """The log, which keeps what is static."""

    def __init__(self, log: LoggedScene) -> None:
        super().__init__(log.tracks)
        self._fixed = log.fixed

    def refusals(self, agents: Collection[AgentId]) -> Mapping[AgentId, str]:
        """What is static."""
        return {one: f"'{one}' is static" for one in agents if one in self._fixed}


class AttackedScene:
    """One session of AlpaSim: a logged scene that goes on step by step, under attack.

    Args:
        log: the scene. road: its map.
        policy: drives the opponents. rng: for it.
        rules: when an attack ends, and another one begins.
    """

    def __init__(
        self,
        log: LoggedScene,
        road: RoadMap,
        policy: Policy,
        rng: np.random.Generator,
        rules: TurnRules,
    ) -> None:
        self._log, self._road, self._rules = log, road, rules
        self._policy, self._rng = policy, rng
        self._first = max(log.now, HISTORY_STEPS - 1)
        self._step = -1
        self._frames: list[Frame] = []
        self._record: EpisodeRecord | None = None
        self._driven: dict[AgentId, Pose] = {}

    def at(self, time_us: int) -> Any:
        """The answer: where all objects are at a time, which is not before the last one.

        Raises RefusedCall for a time that no step leads to, and RunError as the policy does.
        """
        step = self._log.step_at(time_us)
        if step < self._step:
            raise RefusedCall("INVALID_ARGUMENT", f"time_query_us {time_us} is in the past")
        if time_us > self._log.time_us(max(step, self._log.now)):
            text = f"time_query_us {time_us} is not a multiple of {STEP_US} us after the handover"
            raise RefusedCall("INVALID_ARGUMENT", text)
        while self._step < step:
            self._go_on()
        updates = []
        for name in self._log.objects:
            pose = self._driven.get(name)
            found = self._log.pose_at(name, time_us, pose)
            if found is not None:
                way = MESSAGES["Trajectory"](poses=[pose_message(found, time_us)])
                one = MESSAGES["ObjectTrajectoryUpdate"](object_id=name, trajectory=way)
                updates.append(one)
        return MESSAGES["TrafficReturn"](object_trajectory_updates=updates)

    def attack(self) -> LiveAttack | None:
        """The attacks so far as one episode, which is over; None if there was none."""
        record = self._record
        if record is None or record.step <= record.now:
            return None
        rollout = record.rollout("time")  # it is not told what lights show
        if not rollout.turns:
            return None
        first = min(one.first_step for one in rollout.turns)
        last = max(one.last_step for one in rollout.turns)
        begin_s, end_s = (self._log.time_us(one) / 1e6 for one in (first, last))
        return LiveAttack(begin_s=begin_s, end_s=end_s, rollout=rollout)

    def _go_on(self) -> None:
        """One step of 0.1 s."""
        record = self._record
        if record is None:
            self._step += 1
            self._frames.append(self._frame())
            if self._step == self._first:
                self._begin()
            return
        if record.step == record.end:  # the log is over
            self._step += 1
            self._driven = {}
            return
        record.replan()
        self._step += 1
        poses = record.schedule.advance(self._step)
        self._driven = {one: pose for one, pose in poses.items() if pose is not None}
        record.add(self._frame())

    def _begin(self) -> None:
        tracks = self._log.tracks
        left = tracks.steps - 1 - self._step
        recorder = Recorder(
            len(self._frames) + left, lambda one: recorded_body(tracks, tracks.row(one))
        )
        for frame in self._frames:
            recorder.add(frame)
        self._record = EpisodeRecord(
            EGO, self._road, recorder, self._frames[-1], left, dict,
            lambda view: AttackSchedule(
                self._policy, view, self._rng, self._rules, _Owner(self._log)
            ),
        )  # fmt: skip

    def _frame(self) -> Frame:
        """All objects now: opponents on their plans, the ego where it was told to be."""
        tracks = self._log.tracks
        own = [name == EGO or name in self._driven for name in tracks.ids]
        logged = recorded_frame(tracks, self._step, ~np.array(own))
        driven = {name: (pose, Driver.POLICY) for name, pose in self._driven.items()}
        ego = self._log.ego_at(self._log.time_us(self._step))
        return logged.with_poses({EGO: (ego, Driver.PLANNER), **driven})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Open:
    """An open session."""

    log: LoggedScene
    scene: AttackedScene
    setting: Setting


class TrafficService:
    """The five calls. Sessions may be open beside each other; calls come one at a time.

    Args:
        folder: of the networks.
        wish: the attacks that are wanted: ``sets`` and ``duration_s``.
        out: folder for the attacks, as of `Attacker`; None writes nothing.
        overwrite: delete the results of an earlier command in it.

    Raises UsageError for a folder without networks, and as `Attacker` does.
    """

    def __init__(
        self, folder: Path, wish: AttackRequest, out: Path | None, *, overwrite: bool = False
    ) -> None:
        names = sorted(folder.glob(f"*{_ENDING}")) if folder.is_dir() else []
        self._nets = {one.name.removesuffix(_ENDING): one for one in names}
        if not self._nets:
            raise UsageError(f"There is no SCENE_ID{_ENDING} in '{folder}'.")
        triggers_of(wish)
        self._wish, self._spec = wish, spec_of(wish)
        policy_of(self._spec)
        self._roads: dict[str, RoadMap] = {}
        self._sessions: dict[str, _Open] = {}
        self.record = SessionRecord(out, wish.avs, self._spec, overwrite=overwrite)

    def start_session(self, request: Any) -> Any:
        """Open a session on a scene, with its log."""
        uuid, scene = request.session_uuid, request.scene_id
        if not uuid or uuid in self._sessions:
            text = f"session_uuid '{uuid}' is open already" if uuid else "session_uuid is empty"
            raise RefusedCall("ALREADY_EXISTS" if uuid else "INVALID_ARGUMENT", text)
        if scene not in self._nets:
            raise RefusedCall("NOT_FOUND", f"there is no {scene}{_ENDING} among the networks")
        log = LoggedScene.of(request)
        road = self._road(scene)
        _check_place(log, road, scene)
        rng = np.random.default_rng([self._spec.seed, request.random_seed])
        rules = TurnRules(longest_s=self._wish.duration_s)
        attacked = AttackedScene(log, road, policy_of(self._spec), rng, rules)
        net = self._nets[scene]
        setting = Setting(net=net, road=road, longest_s=self._wish.duration_s, planner="alpasim")
        self._sessions[uuid] = _Open(log=log, scene=attacked, setting=setting)
        return MESSAGES["Empty"]()

    def simulate(self, request: Any) -> Any:
        """Where all objects are at the time of the request."""
        session = self._of(request)
        session.log.follow(request)
        return session.scene.at(request.time_query_us)

    def close_session(self, request: Any) -> Any:
        """Close a session, and write its attacks."""
        session = self._of(request)
        del self._sessions[request.session_uuid]
        self.record.begin(session.setting)
        attack = session.scene.attack()
        if attack is not None:
            self.record.add(attack)
        return MESSAGES["Empty"]()

    def get_metadata(self, request: Any) -> Any:  # noqa: ARG002  (it is empty)
        """Version, and the log that is needed before the handover."""
        version = MESSAGES["VersionId"](version_id=f"deepmf-sumo {deepmf_sumo.__version__}")
        history_us = (HISTORY_STEPS - 1) * STEP_US
        return MESSAGES["TrafficModuleMetadata"](
            version_id=version, minimum_history_length_us=history_us
        )

    def get_available_scenes(self, request: Any) -> Any:  # noqa: ARG002  (it is empty)
        """Scenes that have a network."""
        return MESSAGES["AvailableScenesReturn"](scene_ids=self._nets)

    def _of(self, request: Any) -> _Open:
        uuid = request.session_uuid
        if uuid not in self._sessions:
            raise RefusedCall("NOT_FOUND", f"there is no session '{uuid}'")
        return self._sessions[uuid]

    def _road(self, scene: str) -> RoadMap:
        if scene not in self._roads:
            self._roads[scene] = road_of_net(self._nets[scene])
        return self._roads[scene]


class AlpasimServer:
    """The service on a port, until `close`.

    ::

        with AlpasimServer("networks", address="localhost:50052", out="live") as server:
            server.wait()

    Args:
        folder: contains ``SCENE_ID.net.xml`` of each scene.
        address: host and port to listen on; port 0 takes a free one.
        out: folder for the attacks as runs of a result folder; None writes nothing.
        duration_s: maximum of an attack.
        sets: ``key=value`` as in specs, of ``profile``, ``adversary``, ``weights`` and ``seed``.
        overwrite: delete the results of an earlier command in ``out``; else they are an error.

    Attributes:
        port: on which it listens. attacks: those that are over, as of `Attacker`.

    Raises UsageError without grpcio, without networks, or where the address is taken.
    """

    def __init__(
        self,
        folder: Path | str,
        *,
        address: str = "localhost:50052",
        out: Path | str | None = None,
        duration_s: float = 15.0,
        sets: Sequence[str] = (),
        overwrite: bool = False,
    ) -> None:
        try:
            grpc: Any = importlib.import_module("grpc")
        except ImportError:
            raise UsageError(
                "AlpaSim's service needs grpcio, which is not installed; install"
                " deepmf-sumo[alpasim]."
            ) from None
        wish = AttackRequest(avs=(EGO,), duration_s=duration_s, sets=tuple(sets))
        place = None if out is None else Path(out)
        self._service = TrafficService(Path(folder), wish, place, overwrite=overwrite)
        self._server = grpc.server(ThreadPoolExecutor(max_workers=1))
        handlers = {
            name: grpc.unary_unary_rpc_method_handler(
                _answering(grpc, getattr(self._service, name)),
                request_deserializer=MESSAGES[asked].FromString,
                response_serializer=MESSAGES[answer].SerializeToString,
            )
            for name, (asked, answer) in CALLS.items()
        }
        self._server.add_generic_rpc_handlers(
            (grpc.method_handlers_generic_handler(SERVICE, handlers),)
        )
        try:
            self.port: int = self._server.add_insecure_port(address)
        except RuntimeError:
            raise UsageError(
                f"Nothing can listen on '{address}'; choose another address."
            ) from None
        self._server.start()

    @property
    def attacks(self) -> list[dict[str, Any]]:
        """The attacks of closed sessions."""
        return self._service.record.rows

    def wait(self) -> None:
        """Until `close` is called, or Ctrl-C."""
        self._server.wait_for_termination()

    def close(self) -> None:
        """Listen no more. Sessions that are open are lost."""
        self._server.stop(None).wait()
        self._service.record.finish("closed", 0.0)
        self._service.record.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _answering(grpc: Any, call: Callable[[Any], Any]) -> Callable[[Any, Any], Any]:
    """A handler of gRPC: what is refused ends with its status and one sentence."""

    def answer(request: Any, context: Any) -> Any:
        try:
            return call(request)
        except RefusedCall as error:
            context.abort(getattr(grpc.StatusCode, error.status), str(error))
        except RunError as error:
            context.abort(grpc.StatusCode.FAILED_PRECONDITION, str(error))

    return answer


def _check_place(log: LoggedScene, road: RoadMap, scene: str) -> None:
    """Raise RefusedCall where the ego's log is not on the road."""
    lanes = [one.centre_m for one in road.lanes.values() if len(one.centre_m) > 1]
    way = shapely.points(log.ways[EGO].centre_m[:, :2])
    away_m = float(np.median(shapely.distance(shapely.MultiLineString(lanes), way)))
    if away_m > _OFF_ROAD_M:
        text = f"{scene}{_ENDING}: the ego's log is {away_m:.0f} m from its lanes; it must be in"
        raise RefusedCall("FAILED_PRECONDITION", f"{text} the scene's local frame")
