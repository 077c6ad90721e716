"""Converted nets by the content of their scene: each is built once."""

import hashlib
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import deepmf_sumo
from deepmf_sumo.datatypes import Scene, SumoNet
from deepmf_sumo.errors import ConversionError
from deepmf_sumo.network import mapping, programs
from deepmf_sumo.network.conversion import convert


def cached(scene: Scene, cache: Path) -> SumoNet:
    """The scene's net from the cache, built there if need be.

    The key is a hash of what the net is made of (road, signalled lanes, the AV's path) and of the
    versions that make it. Several processes may ask for the same net at the same time.

    Raises ConversionError as `convert` does.
    """
    folder = cache / key(scene)
    try:
        return mapping.read(folder)
    except ConversionError:
        pass
    cache.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".building-", dir=cache) as beside:
        built = Path(beside) / folder.name
        convert(scene, built)
        _move(built, folder)
    return mapping.read(folder)


def _move(built: Path, folder: Path) -> None:
    """Put a net in its place, unless another process was first; a broken one is replaced."""
    try:
        built.replace(folder)
    except OSError:
        try:
            mapping.read(folder)
        except ConversionError:
            shutil.rmtree(folder, ignore_errors=True)
            built.replace(folder)


def key(scene: Scene) -> str:
    """Hex digest of what the net of a scene depends on."""
    digest = hashlib.sha256()
    for part in _parts(scene):
        digest.update(part)
        digest.update(b"\0")
    return digest.hexdigest()[:32]


def _parts(scene: Scene) -> Iterator[bytes]:
    yield f"{deepmf_sumo.__version__} {programs.version()} {mapping.FORMAT}".encode()
    for lane in scene.road.lanes.values():
        facts = (
            lane.id,
            lane.kind,
            lane.interpolating,
            lane.width_m,
            lane.speed_limit_mps,
            lane.next,
            lane.previous,
            [neighbour.lane_id for neighbour in (*lane.right, *lane.left)],
        )
        yield repr(facts).encode()
        yield lane.centre_m.tobytes()
        yield lane.z_m.tobytes()
    for shape in scene.road.polygons:
        yield f"{shape.kind} {shape.id}".encode()
        yield shape.points_m.tobytes()
    for sign in scene.road.stop_signs:
        yield f"{sign.lane_ids} {sign.position_m.tolist()}".encode()
    yield repr(sorted(scene.signals.lane_ids)).encode()
    row = scene.tracks.row(scene.av_id)
    yield str(scene.now).encode()
    for array in (scene.tracks.position_m, scene.tracks.heading_rad, scene.tracks.valid):
        yield np.ascontiguousarray(array[row]).tobytes()
    yield np.ascontiguousarray(scene.tracks.velocity_mps[row]).tobytes()
