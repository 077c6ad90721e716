"""What the opponent network reads: the scene around the AV, and everybody's relation to it."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.datatypes import AgentId, Bools, Floats, Ints, View
from deepmf_sumo.predictors import motion_relations, raster
from deepmf_sumo.predictors.features import Features, agent_arrays, lane_arrays
from deepmf_sumo.predictors.lane_relations import LANES, MEETING, PLACE, lane_columns
from deepmf_sumo.predictors.lane_routes import on_lanes
from deepmf_sumo.predictors.motion_relations import CONSTANT, MOTION, Motion, rank
from deepmf_sumo.predictors.presets import Preset
from deepmf_sumo.predictors.road_index import road_index

OTHERS: Final = 63
"""Slots of agents around the AV."""
RANGE_M: Final = 80.0
PAIR: Final = MOTION + CONSTANT + LANES + 10
"""Columns of ``pair``, see `_pairs`."""

_MOVED_M = 0.5
_ON_LANE_M, _ALONG_LANE_RAD = 2.0, np.deg2rad(45.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surroundings:
    """Who is around the AV.

    Attributes:
        rows: rows of the view: the AV, the vehicles within 80 m, nearest first, then others.
        vehicles: how many vehicles there are.
        parked: (vehicles) who has not moved in the history and stands off the lanes, or across
            them. Who waits on a lane may well attack.
    """

    rows: Ints
    vehicles: int
    parked: Bools

    def ids(self, view: View) -> tuple[AgentId, ...]:
        """Ids of the vehicles."""
        return tuple(view.history.ids[row] for row in self.rows[1 : self.vehicles + 1])


def surroundings(view: View) -> Surroundings:
    """The AV's surroundings: at most 63 others."""
    tracks = view.history
    av = tracks.row(view.av_id)
    distance = np.hypot(*(tracks.position_m[:, -1] - tracks.position_m[av, -1]).T)
    vehicle = np.array([kind == "vehicle" for kind in tracks.kinds], bool) & (distance <= RANGE_M)
    vehicle[av] = False
    order = np.lexsort((distance, ~vehicle))
    order = order[order != av][:OTHERS]
    vehicles = int(vehicle[order].sum())
    return Surroundings(
        rows=np.concatenate([[av], order]),
        vehicles=vehicles,
        parked=_parked(view, order[:vehicles]),
    )


def opponent_features(
    view: View, preset: Preset, *, known_s: float = 8.0, stands_in: bool = False
) -> tuple[Features, Surroundings]:
    """Arrays around the AV, and whom they are about.

    Keys: pair (63, 112) and vehicle (63) 1 for slots that hold a vehicle, which come first. With
    the preset's vectors: agents (64, 11, 7), agent_info (64, 8), the AV first, then the slots;
    lanes (48, 10, 2), lane_info (48, 10); with its image: raster; all as in `features.Features`.

    Args:
        view: of the present.
        preset: of the network.
        known_s: time ahead that the labels look at, told to the network.
        stands_in: the AV of this view is another vehicle of the recording: it saw less.
    """
    around = surroundings(view)
    pair, vehicle = np.zeros((OTHERS, PAIR)), np.zeros(OTHERS)
    vehicle[: around.vehicles] = 1.0
    if around.vehicles:
        pair[: around.vehicles] = _pairs(view, around, known_s, stands_in)
    arrays: Features = {"pair": pair.astype(np.float32), "vehicle": vehicle.astype(np.float32)}
    index, av = road_index(view.road), int(around.rows[0])
    origin = view.history.position_m[av, -1]
    heading = float(view.history.heading_rad[av, -1])
    if preset.vectors:
        speed = float(view.history.speed_mps[av, -1])
        agents, info = agent_arrays(view, around.rows, OTHERS + 1, origin, heading)
        lanes, lane_info = lane_arrays(view, index, origin, heading, speed, 48)
        arrays["agents"], arrays["agent_info"] = agents.astype(np.float32), info.astype(np.float32)
        arrays["lanes"], arrays["lane_info"] = (
            lanes.astype(np.float32),
            lane_info.astype(np.float32),
        )
    if preset.raster:
        arrays["raster"] = raster.pack(raster.draw(view, index, av, preset, origin, heading))
    return arrays, around


def _parked(view: View, rows: Ints) -> Bools:
    """(A) see `Surroundings`."""
    tracks = view.history
    valid = tracks.valid[rows][..., None]
    high = np.where(valid, tracks.position_m[rows], -np.inf).max(1)
    low = np.where(valid, tracks.position_m[rows], np.inf).min(1)
    still = ((high - low).max(-1) <= _MOVED_M) & (
        tracks.speed_mps[rows, -1] <= motion_relations.STILL_MPS
    )
    pose = tracks.position_m[rows, -1], tracks.heading_rad[rows, -1]
    near = on_lanes(view.road, *pose, _ON_LANE_M, float(_ALONG_LANE_RAD), tracks.z_m[rows, -1])
    parked: Bools = still & ~near
    return parked


def _pairs(view: View, around: Surroundings, known_s: float, stands_in: bool) -> Floats:
    """(V, 112) by motion, at constant motion, along the lanes; ranks (7), parked, the rest (2)."""
    rows = around.rows[: around.vehicles + 1]
    motion = motion_relations.motion_of(view, rows)
    constant = motion_relations.constant_columns(motion)
    lanes = lane_columns(view, rows, motion)
    rest = np.broadcast_to([float(stands_in), known_s / 8.0], (around.vehicles, 2))
    return np.concatenate(
        [
            motion_relations.motion_columns(motion), constant, lanes,
            _ranks(motion, constant, lanes), around.parked[:, None], rest,
        ],
        axis=1,
    )  # fmt: skip


def _ranks(motion: Motion, constant: Floats, lanes: Floats) -> Floats:
    """(V, 7) each vehicle's place in the order by several measures of nearness."""
    distance = np.hypot(*motion.position_m[1:].T)
    meeting = lanes[:, MEETING]
    late = meeting[:, 0] + np.maximum(meeting[:, 3], meeting[:, 4])
    measures = [
        distance, distance + 1e3 * ~motion.moving[1:], constant[:, 2], constant[:, 8],
        lanes[:, PLACE], late, constant[:, 0],
    ]  # fmt: skip
    return np.stack([rank(measure) for measure in measures], axis=1)
