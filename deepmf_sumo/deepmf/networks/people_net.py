"""A small network of people beside `people`: which motion, how far off, how sure.

For each of the N motions of `people` it gives a change of the log of its share, where it ends up
instead (residuals at 1, 2, 4, 6, 8 s), and how wide its kernels are. Its inputs are the last second
of the person, the road near it (nearest lane, crosswalk and road edge), the AV and the nearest
agents, each relative to the person, and of each motion its places and whether they are on the road
or near a crosswalk. Everything is in the person's frame; training mirrors half of the samples.

The network is a few matrices (`FILE`.safetensors), computed by numpy: installations without torch
have it, too. Nothing changes where its last layer is zero, which training starts from.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from deepmf_sumo.deepmf.networks.decode import KNOT_STEPS, KNOTS_S, Singles
from deepmf_sumo.deepmf.networks.people import PeoplePrediction, moving_pose
from deepmf_sumo.scene import DT_S, FUTURE_STEPS, Floats, RoadMap, View
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.geometry.frames import AgentFrame
from deepmf_sumo.scene.geometry.lane_map import per_road
from deepmf_sumo.scene.geometry.road import lanes_for_cars, on_road
from deepmf_sumo.scene.road_users import road_user

FILE: Final = "people"
INPUTS_VERSION: Final = 1
"""Of the inputs: increased when they change, since networks trained before read them wrongly."""
_PAST: Final = (-3, -5, -7, -9, -11)
"""Columns of the history whose positions are read."""
OWN: Final = (
    "cyclist", "speed", "moves", "faster",
    *(f"{name}_{-1 - column}" for column in _PAST for name in ("known", "ahead", "side")),
    "box_cos", "box_side_sin",
    "lane_there", "lane_ahead", "lane_side", "lane_far", "lane_cos", "lane_side_sin", "on_lane",
    "edge_there", "edge_ahead", "edge_side", "edge_far",
    "crosswalk_there", "crosswalk_ahead", "crosswalk_side", "crosswalk_far",
    "crosswalk_cos2", "crosswalk_side_sin2",
)  # fmt: skip
"""Columns of a person."""
AROUND: Final = (
    "there", "ahead", "side", "far", "velocity_ahead", "velocity_side",
    "cos", "side_sin", "av", "vehicle", "pedestrian", "cyclist",
)  # fmt: skip
"""Columns of an agent near the person."""
MOTION: Final = (
    "share", "standing",
    *(f"{name}_{second:g}" for second in KNOTS_S for name in ("ahead", "side")),
    "cos", "side_sin", "last_speed",
    *(f"{name}_{second:g}" for second in KNOTS_S[1::3] for name in ("on_lane", "crosswalk")),
)  # fmt: skip
"""Columns of a motion."""
ODD: Final[dict[str, NDArray[np.float32]]] = {
    name: np.array([-1.0 if "side" in column else 1.0 for column in columns], np.float32)
    for name, columns in (("own", OWN), ("around", AROUND), ("motion", MOTION))
}
"""Factor of each column in a mirrored world."""
AGENTS: Final = 8
"""The AV, if it is near, and the nearest others."""
MOTIONS: Final = 72
"""`people` has fewer."""
_REACH_M: Final = 40.0
_NEAR_M: Final = 10.0
"""Metres per unit of most columns."""
SECONDS: Final = np.array(KNOTS_S, np.float32)
OUTPUTS: Final = 1 + 4 * len(KNOTS_S)
"""Of each motion: log share, residuals ahead and to the left, log widths along and across."""
STRETCH_M: Final = 0.5
"""Residual of an output of 1, a second."""
WIDEST: Final = 3.0
"""The log of a width changes by less."""
LEAST_M: Final = 0.03
LAYERS: Final = ("own", "around", "motion", "mix", "last")
"""Names of the linear layers."""


class Inputs(NamedTuple):
    """What is known of a person: own (C), around (8, B), motion (N, D), single precision."""

    own: Singles
    around: Singles
    motion: Singles


class PeopleNet:
    """The network.

    Args:
        tensors: weight and bias of each of `LAYERS`, as ``own.weight`` (out, in).
    """

    def __init__(self, tensors: Mapping[str, Singles]) -> None:
        self.tensors = {name: np.asarray(value, np.float32) for name, value in tensors.items()}

    @classmethod
    def read(cls, content: bytes) -> "PeopleNet":
        """The network in a safetensors file.

        Raises ValueError where that is damaged, or tensors are missing, unlike or not finite.
        """
        tensors = _tensors_in(content)
        first = tensors.get("own.bias")
        wanted = shapes(0 if first is None else len(first))
        for name, shape in wanted.items():
            if name not in tensors or tensors[name].shape != shape:
                raise ValueError(f"'{name}' is missing or of another shape")
            if not np.isfinite(tensors[name]).all():
                raise ValueError(f"numbers in '{name}' are not finite")
        return cls(tensors)

    def __call__(self, inputs: Inputs) -> Singles:
        """(N, `OUTPUTS`)."""
        around = np.maximum(self._layer("around", inputs.around), 0.0)
        around = np.where(inputs.around[:, :1] > 0, around, 0.0).max(0)
        own = np.maximum(self._layer("own", np.concatenate([inputs.own, around])), 0.0)
        both = [np.broadcast_to(own, (len(inputs.motion), len(own))), inputs.motion]
        hidden = np.maximum(self._layer("motion", np.concatenate(both, axis=1)), 0.0)
        hidden = np.maximum(self._layer("mix", hidden), 0.0)
        return self._layer("last", hidden)

    def _layer(self, name: str, values: Singles) -> Singles:
        return values @ self.tensors[f"{name}.weight"].T + self.tensors[f"{name}.bias"]

    def refined(self, view: View, untrained: PeoplePrediction) -> PeoplePrediction:
        """The prediction with other shares, places and widths."""
        tracks = view.history
        row = tracks.row(untrained.agent_id)
        pose = moving_pose(view, untrained.agent_id)
        found = self(inputs(view, untrained, pose)).astype(float)
        knots = len(KNOTS_S)
        logits = np.log(untrained.share) + found[:, 0]
        share = np.exp(logits - logits.max())
        off = STRETCH_M * SECONDS[:, None] * found[:, 1 : 1 + 2 * knots].reshape(-1, knots, 2)
        wider = WIDEST * np.tanh(found[:, 1 + 2 * knots :].reshape(-1, knots, 2) / WIDEST)
        position, heading = _moved(
            untrained,
            frames.rotate(off, pose.heading_rad),
            pose,
            road_user(tracks.kinds[row], tracks.size_m[row]).motion.fastest_mps,
        )
        return replace(
            untrained,
            position_m=position,
            heading_rad=heading,
            share=share / share.sum(),
            width_m=np.maximum(untrained.width_m * np.exp(wider), LEAST_M),
        )


def _tensors_in(content: bytes) -> dict[str, Singles]:
    """The tensors of a safetensors file: eight bytes with the size of a JSON header, then data.

    Installations without torch have no reader of this format. Raises ValueError.
    """
    data = 8 + int.from_bytes(content[:8], "little")
    found = {}
    try:
        header: dict[str, Any] = json.loads(content[8:data])
        for name, each in header.items():
            if name != "__metadata__":
                begin, end = (data + int(offset) for offset in each["data_offsets"])
                values = np.frombuffer(content[begin:end], _STORED[each["dtype"]])
                found[name] = values.reshape(each["shape"]).astype(np.float32)
    except (AttributeError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"no safetensors: {error!r:.80}") from None
    return found


_STORED: Final = {"F16": "<f2", "F32": "<f4"}


def shapes(width: int = 64) -> dict[str, tuple[int, ...]]:
    """Of all tensors, for a width of the hidden layers."""
    half = width // 2
    sizes = {
        "own": (width, len(OWN) + half),
        "around": (half, len(AROUND)),
        "motion": (width, width + len(MOTION)),
        "mix": (width, width),
        "last": (OUTPUTS, width),
    }
    weights = {f"{name}.weight": size for name, size in sizes.items()}
    return weights | {f"{name}.bias": size[:1] for name, size in sizes.items()}


def _moved(
    base: PeoplePrediction, off_m: Floats, pose: AgentFrame, fastest_mps: float
) -> tuple[Floats, Floats]:
    """Positions (N, 80, 2) with residuals (N, 5, 2) at the knots, and headings (N, 80).

    Between the knots residuals follow cubics that begin without speed. Nobody becomes faster than
    its class.
    """
    position = base.position_m + np.einsum("tk,nkd->ntd", _BETWEEN, off_m)
    start = np.broadcast_to(pose.position_m, (len(position), 1, 2))
    step = np.diff(np.concatenate([start, position], axis=1), axis=1)
    length = np.hypot(step[..., 0], step[..., 1])
    short = np.minimum(1.0, fastest_mps * DT_S / np.maximum(length, 1e-9))
    position = start + np.cumsum(step * short[..., None], axis=1)
    goes = length > _STANDS_MPS * DT_S
    heading = np.where(goes, np.arctan2(step[..., 1], step[..., 0]), base.heading_rad)
    return position, frames.wrap(heading)


_STANDS_MPS: Final = 0.2


def _cubics() -> Floats:
    """(80, 5) share of each knot's residual at each step: Hermite cubics, finite differences."""
    time, at = np.array([0.0, *KNOTS_S]), DT_S * np.arange(1, FUTURE_STEPS + 1)
    value = np.eye(len(time))[:, 1:]
    slope = np.gradient(value, time, axis=0)
    slope[0] = 0.0
    part = np.clip(np.searchsorted(time, at) - 1, 0, len(time) - 2)
    long = np.diff(time)[part]
    x = ((at - time[part]) / long)[:, None]
    long = long[:, None]
    return np.asarray(
        (2 * x**3 - 3 * x**2 + 1) * value[part]
        + (x**3 - 2 * x**2 + x) * long * slope[part]
        + (3 * x**2 - 2 * x**3) * value[part + 1]
        + (x**3 - x**2) * long * slope[part + 1]
    )


_BETWEEN: Final = _cubics()


def inputs(view: View, untrained: PeoplePrediction, pose: AgentFrame) -> Inputs:
    """What the network reads of a view."""
    return Inputs(
        own=np.asarray(_own(view, pose), np.float32),
        around=np.asarray(_around(view, pose), np.float32),
        motion=np.asarray(_motion(view.road, untrained, pose), np.float32),
    )


def _own(view: View, pose: AgentFrame) -> list[float]:
    tracks, row = view.history, view.history.row(pose.agent_id)
    past: list[float] = []
    for column in _PAST:
        known = -column <= tracks.valid.shape[1] and bool(tracks.valid[row, column])
        there = _local(tracks.position_m[row, column], pose) if known else np.zeros(2)
        past += [float(known), *(there / 2.0)]
    speed = tracks.speed_mps[row, tracks.valid[row]]
    turn = float(frames.difference(tracks.heading_rad[row, -1], pose.heading_rad))
    return [
        float(tracks.kinds[row] == "cyclist"),
        pose.speed_mps / 3.0,
        float(pose.speed_mps > 0.0),
        float(np.clip(speed[-1] - speed[0], -2.0, 2.0)),
        *past,
        np.cos(turn),
        np.sin(turn),
        *_lane(view.road, pose),
        *_nearest(_edges(view.road), pose),
        *_crosswalk(view.road, pose),
    ]


def _local(points_m: Floats, pose: AgentFrame) -> Floats:
    return frames.to_local(points_m, pose.position_m, pose.heading_rad)


def _lane(road: RoadMap, pose: AgentFrame) -> list[float]:
    """The nearest lane within 15 m."""
    lanes = lanes_for_cars(road)
    feet = lanes.feet(pose.position_m[None], 15.0) if lanes.lanes else None
    if feet is None or not len(feet.segment):
        return [0.0] * 7
    far = np.hypot(*feet.away_m.T)
    best = int(far.argmin())
    segment = feet.segment[best]
    ahead, side = frames.rotate(-feet.away_m[best], -pose.heading_rad)
    turn = float(np.arctan2(*lanes.vector_m[segment][::-1])) - pose.heading_rad
    return [
        1.0, ahead / _NEAR_M, side / _NEAR_M, float(far[best]) / _NEAR_M, np.cos(turn),
        np.sin(turn), float(far[best] <= lanes.reach_m[lanes.lane[segment]]),
    ]  # fmt: skip


@per_road
def _edges(road: RoadMap) -> shapely.Geometry:
    lines = [shapely.LineString(one.points_m) for one in road.edges if len(one.points_m) > 1]
    return shapely.geometrycollections(lines)


@per_road
def _crosswalks(road: RoadMap) -> shapely.Geometry:
    found = [one.points_m for one in road.polygons if one.kind == "crosswalk"]
    areas = [shapely.Polygon(one) for one in found if len(one) > 2]
    return shapely.union_all(shapely.make_valid(np.array(areas, object)))


def _nearest(shape: shapely.Geometry, pose: AgentFrame) -> list[float]:
    """There, ahead, to the left and far: the nearest point of a shape within 40 m."""
    if shapely.is_empty(shape):
        return [0.0] * 4
    line = shapely.shortest_line(shapely.points(pose.position_m), shape)
    ahead, side = _local(shapely.get_coordinates(line)[-1], pose)
    far = float(np.hypot(ahead, side))
    if far > _REACH_M:
        return [0.0] * 4
    return [1.0, ahead / _NEAR_M, side / _NEAR_M, far / _NEAR_M]


def _crosswalk(road: RoadMap, pose: AgentFrame) -> list[float]:
    """The nearest crosswalk, and twice the angle of its longer side."""
    shape = _crosswalks(road)
    found = _nearest(shape, pose)
    if not found[0]:
        return [*found, 0.0, 0.0]
    here = shapely.points(pose.position_m)
    parts = [one for one in shapely.get_parts(shape) if one.geom_type == "Polygon"]
    if not parts:
        return [*found, 0.0, 0.0]
    nearest = parts[int(shapely.distance(here, parts).argmin())]
    box = shapely.get_coordinates(shapely.minimum_rotated_rectangle(nearest))
    sides = np.diff(box[:3], axis=0)
    longer = sides[int(np.hypot(*sides.T).argmax())]
    twice = 2 * (float(np.arctan2(longer[1], longer[0])) - pose.heading_rad)
    return [*found, np.cos(twice), np.sin(twice)]


def _around(view: View, pose: AgentFrame) -> Floats:
    """(8, B) the nearest agents within 40 m; the AV is the first, if it is there."""
    tracks, own = view.history, view.history.row(pose.agent_id)
    found = np.zeros((AGENTS, len(AROUND)))
    away = _local(tracks.position_m[:, -1], pose)
    far = np.hypot(*away.T)
    far[own] = np.inf
    av = np.array([agent_id == view.av_id for agent_id in tracks.ids])
    order = np.lexsort((far, ~av))
    order = order[far[order] < _REACH_M][:AGENTS]
    velocity = frames.rotate(tracks.velocity_mps[order, -1], -pose.heading_rad)
    turn = tracks.heading_rad[order, -1] - pose.heading_rad
    kinds = np.array([tracks.kinds[row] for row in order])
    found[: len(order)] = np.column_stack([
        np.ones(len(order)), away[order] / _NEAR_M, far[order] / _NEAR_M, velocity / 5.0,
        np.cos(turn), np.sin(turn), av[order],
        *(kinds == kind for kind in ("vehicle", "pedestrian", "cyclist")),
    ]) if len(order) else 0.0  # fmt: skip
    return found


def _motion(road: RoadMap, untrained: PeoplePrediction, pose: AgentFrame) -> Floats:
    """(N, D)."""
    place = untrained.position_m[:, list(KNOT_STEPS)]
    count = len(place)
    local = _local(place, pose)
    turn = untrained.heading_rad[:, -1] - pose.heading_rad
    last = np.diff(untrained.position_m[:, -2:], axis=1)[:, 0]
    looked = place[:, 1::3].reshape(-1, 2)
    lane = on_road(road, looked).reshape(count, -1)
    shape = _crosswalks(road)
    far = np.full(len(looked), 20.0)
    if not shapely.is_empty(shape):
        far = np.minimum(shapely.distance(shapely.points(looked), shape), 20.0)
    marks = np.stack([lane, far.reshape(count, -1) / _NEAR_M], axis=-1).reshape(count, -1)
    return np.column_stack([
        np.log(untrained.share), (np.hypot(*local[:, -1].T) < 1e-6),
        (local / (_NEAR_M * SECONDS[:, None] / 8.0)).reshape(count, -1),
        np.cos(turn), np.sin(turn), np.hypot(*last.T) / DT_S / 3.0, marks,
    ])  # fmt: skip
