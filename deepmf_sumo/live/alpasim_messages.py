"""Messages of AlpaSim's traffic service, made from their field numbers without generated code.

Names, types and numbers are those of ``common.proto`` and ``traffic.proto`` of AlpaSim's
``alpasim_grpc`` (v0, NVIDIA, Apache-2.0), as far as the service needs them. They are in a pool of
their own, so that a process may have AlpaSim's own messages as well. The test's client has those.
"""

from typing import Any, Final

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

_PACKAGE: Final = "deepmf_sumo_alpasim"
_FIELDS: Final = {
    "Empty": "",
    "Quat": "w float 1, x float 2, y float 3, z float 4",
    "Vec3": "x float 1, y float 2, z float 3",
    "Pose": "vec Vec3 1, quat Quat 2",
    "AABB": "size_x float 1, size_y float 2, size_z float 3",
    "PoseAtTime": "pose Pose 1, timestamp_us fixed64 2",
    "Trajectory": "poses PoseAtTime* 1",
    "APIVersion": "major uint32 1, minor uint32 2, patch uint32 3",
    "VersionId": "version_id string 1, git_hash string 2, grpc_api_version APIVersion 3",
    "AvailableScenesReturn": "scene_ids string* 1",
    "ObjectTrajectory": "aabb AABB 1, trajectory Trajectory 2, object_id string 3,"
    " is_static bool 4, label_class string 5",
    "ObjectTrajectoryUpdate": "object_id string 1, trajectory Trajectory 2",
    "TrafficSessionRequest": "session_uuid string 1, scene_id string 2, random_seed fixed64 3,"
    " logged_object_trajectories ObjectTrajectory* 4, handover_time_us fixed64 5",
    "TrafficSessionCloseRequest": "session_uuid string 1",
    "TrafficRequest": "session_uuid string 1, time_query_us fixed64 2,"
    " object_trajectory_updates ObjectTrajectoryUpdate* 3",
    "TrafficReturn": "object_trajectory_updates ObjectTrajectoryUpdate* 1",
    "TrafficModuleMetadata": "version_id VersionId 1, minimum_history_length_us fixed64 2",
}
"""By message: name, type and number of each field; a star: repeated."""
SERVICE: Final = "traffic.TrafficService"
CALLS: Final = {
    "start_session": ("TrafficSessionRequest", "Empty"),
    "close_session": ("TrafficSessionCloseRequest", "Empty"),
    "simulate": ("TrafficRequest", "TrafficReturn"),
    "get_metadata": ("Empty", "TrafficModuleMetadata"),
    "get_available_scenes": ("Empty", "AvailableScenesReturn"),
}
"""Request and answer of each call."""


def _made() -> dict[str, Any]:
    """The classes by name."""
    kinds = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(
        name=f"{_PACKAGE}.proto", package=_PACKAGE, syntax="proto3"
    )
    for name, fields in _FIELDS.items():
        message = file.message_type.add(name=name)
        for field in filter(None, fields.split(", ")):
            key, kind, number = field.split()
            one = message.field.add(name=key, number=int(number))
            one.label = kinds.LABEL_REPEATED if kind.endswith("*") else kinds.LABEL_OPTIONAL
            kind = kind.rstrip("*")
            if kind in _FIELDS:
                one.type, one.type_name = kinds.TYPE_MESSAGE, f".{_PACKAGE}.{kind}"
            else:
                one.type = kinds.Type.Value(f"TYPE_{kind.upper()}")
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    found = (pool.FindMessageTypeByName(f"{_PACKAGE}.{name}") for name in _FIELDS)
    return dict(zip(_FIELDS, map(message_factory.GetMessageClass, found), strict=True))


MESSAGES: Final = _made()
