"""The opponent predictor: features of pairs of vehicles, and a score of interaction."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from deepmf_sumo.deepmf.networks import kinematics, raster
from deepmf_sumo.deepmf.networks.base import OpponentNetwork
from deepmf_sumo.deepmf.networks.config import Preset
from deepmf_sumo.deepmf.networks.features import Features, agent_arrays, lane_arrays
from deepmf_sumo.deepmf.networks.kinematics import CONSTANT, MOTION, Motion, rank
from deepmf_sumo.deepmf.networks.lanes import road_index
from deepmf_sumo.deepmf.networks.route_relations import LANES, MEETING, PLACE, lane_columns
from deepmf_sumo.deepmf.networks.routes import on_lanes
from deepmf_sumo.scene import AgentId, Bools, Floats, Ints, OpponentScores, View

OTHERS: Final = 63
"""Slots of agents around the AV."""
SLOTS: Final[tuple[str, ...]] = ("pair", "vehicle")
"""Features with a row for each of them."""
RANGE_M: Final = 80.0
PAIR: Final = MOTION + CONSTANT + LANES + 10
"""Columns of ``pair``, see `_pairs`."""

_MOVED_M = 0.5
_ON_LANE_M, _ALONG_LANE_RAD = 2.0, np.deg2rad(45.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surroundings:
    """The agents around the AV.

    Attributes:
        rows: rows of the view: the AV, the vehicles within 80 m, nearest first, then others.
        vehicles: number of these vehicles.
        parked: (vehicles) has not moved in the history and stands off the lanes, or across them. A
            vehicle that waits on a lane may well attack.
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
    """Arrays around the AV, and the agents in them.

    Keys: vehicle (63) 1 for slots that hold a vehicle, which come first. With the preset's pairs:
    pair (63, 112); with its vectors: agents (64, 11, 7), agent_info (64, 8), the AV first, then
    the slots; lanes (48, 10, 2), lane_info (48, 10); with its image: raster; all as in
    `features.Features`.

    Args:
        view: of the present.
        preset: of the network.
        known_s: time ahead from which the labels are made, a feature.
        stands_in: the AV of this view is another vehicle of the recording: it observed less.
    """
    around = surroundings(view)
    arrays: Features = {"vehicle": (np.arange(OTHERS) < around.vehicles).astype(np.float32)}
    if preset.pairs:
        pair = np.zeros((OTHERS, PAIR), np.float32)
        if around.vehicles:
            pair[: around.vehicles] = _pairs(view, around, known_s, stands_in)
        arrays["pair"] = pair
    index, pose = road_index(view.road), kinematics.pose_of(view, view.av_id)
    if preset.vectors:
        agents, info = agent_arrays(view, around.rows, OTHERS + 1, pose)
        lanes, lane_info = lane_arrays(view, index, 48, pose)
        arrays["agents"], arrays["agent_info"] = agents.astype(np.float32), info.astype(np.float32)
        arrays["lanes"] = lanes.astype(np.float32)
        arrays["lane_info"] = lane_info.astype(np.float32)
    if preset.raster:
        arrays["raster"] = raster.pack(raster.draw(view, index, preset, pose))
    return arrays, around


def _parked(view: View, rows: Ints) -> Bools:
    """(A) see `Surroundings`."""
    tracks = view.history
    valid = tracks.valid[rows][..., None]
    high = np.where(valid, tracks.position_m[rows], -np.inf).max(1)
    low = np.where(valid, tracks.position_m[rows], np.inf).min(1)
    still = ((high - low).max(-1) <= _MOVED_M) & (
        tracks.speed_mps[rows, -1] <= kinematics.STILL_MPS
    )
    pose = tracks.position_m[rows, -1], tracks.heading_rad[rows, -1]
    near = on_lanes(view.road, *pose, _ON_LANE_M, float(_ALONG_LANE_RAD), tracks.z_m[rows, -1])
    return still & ~near


def _pairs(view: View, around: Surroundings, known_s: float, stands_in: bool) -> Floats:
    """(V, 112) motion, constant motion, lanes, ranks (7), parked, stands in, known time."""
    rows = around.rows[: around.vehicles + 1]
    motion = kinematics.motion_of(view, rows)
    constant = kinematics.constant_columns(motion)
    lanes = lane_columns(view, rows, motion)
    rest = np.broadcast_to([float(stands_in), known_s / 8.0], (around.vehicles, 2))
    return np.concatenate(
        [
            kinematics.motion_columns(motion), constant, lanes,
            _ranks(motion, constant, lanes), around.parked[:, None], rest,
        ],
        axis=1,
    )  # fmt: skip


def _ranks(motion: Motion, constant: Floats, lanes: Floats) -> Floats:
    """(V, 7) each vehicle's rank by several measures of nearness."""
    distance = np.hypot(*motion.position_m[1:].T)
    meeting = lanes[:, MEETING]
    late = meeting[:, 0] + np.maximum(meeting[:, 3], meeting[:, 4])
    measures = [
        distance, distance + 1e3 * ~motion.moving[1:], constant[:, 2], constant[:, 8],
        lanes[:, PLACE], late, constant[:, 0],
    ]  # fmt: skip
    return np.stack([rank(measure) for measure in measures], axis=1)


class Opponent:
    """Scores of all candidates in a view.

    Args:
        net: in evaluation mode.
        temperature, partner_temperature: divide the logits, so that their sigmoid is calibrated.
        offset: added to those of the first head thereafter.
    """

    def __init__(
        self,
        net: OpponentNetwork,
        temperature: float,
        partner_temperature: float,
        offset: float = 0.0,
    ) -> None:
        self.net = net
        self.temperature = temperature
        self.partner_temperature = partner_temperature
        self.offset = offset

    def score(self, view: View, *, everyone: bool = False) -> OpponentScores:
        """Logits of both heads for vehicles within 80 m, nearest first.

        Parked vehicles, which cannot attack, are left out unless ``everyone`` is set.
        """
        arrays, around = opponent_features(view, self.net.preset)
        keep = np.flatnonzero(everyone | ~around.parked)
        logits = self.net.scored(arrays)[keep]
        ids = around.ids(view)
        return OpponentScores(
            ids=tuple(ids[row] for row in keep),
            logits=logits[:, 0] / self.temperature + self.offset,
            partner_logits=logits[:, 1] / self.partner_temperature,
        )
