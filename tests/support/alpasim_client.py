"""A client of AlpaSim's traffic service, generated from its public protocol.

``alpasim_protos`` has ``common.proto`` and ``traffic.proto`` of AlpaSim unchanged (commit 3032e0c,
``src/grpc/alpasim_grpc/v0``, Apache-2.0, NVIDIA).
"""

import functools
import importlib
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

PROTOS = Path(__file__).with_name("alpasim_protos")
TICK_US = 100_000


@functools.cache
def generated():
    """``common_pb2``, ``traffic_pb2`` and ``traffic_pb2_grpc``."""
    protoc = pytest.importorskip("grpc_tools.protoc", reason="grpcio-tools is not installed")
    folder = Path(tempfile.mkdtemp(prefix="alpasim-"))
    names = [f"alpasim_grpc/v0/{name}.proto" for name in ("common", "traffic")]
    out = [f"--python_out={folder}", f"--grpc_python_out={folder}"]
    assert protoc.main(["protoc", f"-I{PROTOS}", *out, *names]) == 0
    sys.path.insert(0, str(folder))
    try:
        parts = ("common_pb2", "traffic_pb2", "traffic_pb2_grpc")
        return tuple(importlib.import_module(f"alpasim_grpc.v0.{part}") for part in parts)
    finally:
        sys.path.remove(str(folder))


def pose(x, y, heading=0.0, z=0.8):
    """A pose of a box's centre."""
    common, _, _ = generated()
    half = heading / 2
    return common.Pose(
        vec=common.Vec3(x=x, y=y, z=z), quat=common.Quat(w=np.cos(half), z=np.sin(half))
    )


def way(times_us, poses):
    """A trajectory."""
    common, _, _ = generated()
    at = [
        common.PoseAtTime(pose=one, timestamp_us=time)
        for time, one in zip(times_us, poses, strict=True)
    ]
    return common.Trajectory(poses=at)


class Client:
    """The calls of a session, as AlpaSim's runtime makes them."""

    def __init__(self, port, uuid="session"):
        grpc = importlib.import_module("grpc")
        self.common, self.traffic, stubs = generated()
        self._channel = grpc.insecure_channel(f"localhost:{port}")
        self.stub, self.uuid = stubs.TrafficServiceStub(self._channel), uuid

    def start(self, scene, objects, handover_us, seed=0):
        """``objects``: trajectory, size, class and whether it is static, by id."""
        logged = [
            self.traffic.ObjectTrajectory(
                object_id=name, trajectory=one, is_static=static, label_class=label,
                aabb=self.common.AABB(size_x=size[0], size_y=size[1], size_z=size[2]),
            )
            for name, (one, size, label, static) in objects.items()
        ]  # fmt: skip
        request = self.traffic.TrafficSessionRequest(
            session_uuid=self.uuid, scene_id=scene, random_seed=seed,
            logged_object_trajectories=logged, handover_time_us=handover_us,
        )  # fmt: skip
        return self.stub.start_session(request)

    def simulate(self, time_us, ego):
        """x, y, z and heading of all objects, by id, where the ego has a pose at the time."""
        update = self.traffic.ObjectTrajectoryUpdate(
            object_id="EGO", trajectory=way([time_us], [ego])
        )
        request = self.traffic.TrafficRequest(
            session_uuid=self.uuid, time_query_us=time_us, object_trajectory_updates=[update]
        )
        found = {}
        for one in self.stub.simulate(request).object_trajectory_updates:
            (last,) = one.trajectory.poses
            assert last.timestamp_us == time_us
            at, turn = last.pose.vec, last.pose.quat
            assert abs(turn.w**2 + turn.x**2 + turn.y**2 + turn.z**2 - 1) < 1e-6
            found[one.object_id] = (at.x, at.y, at.z, 2 * np.arctan2(turn.z, turn.w))
        return found

    def close(self):
        """Close the session."""
        request = self.traffic.TrafficSessionCloseRequest(session_uuid=self.uuid)
        return self.stub.close_session(request)

    def leave(self):
        """Close the channel."""
        self._channel.close()
