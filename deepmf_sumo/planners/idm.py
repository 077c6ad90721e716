"""SUMO's Intelligent Driver Model drives the AV, with one of two kinds of perception.

``lane``: the AV sees what SUMO's model sees: vehicles matched to its lane, lights, right of way. It
sees a car that cuts in as soon as the car's front crosses the lane's border. Where the recording
leaves the lanes, the AV drives on a separate lane from which SUMO's model sees no other vehicle:
there ``lane`` means ``corridor``. It stops for an opponent that stands in its way, too, whatever
lane SUMO counts that on.
``corridor``: in addition, the AV follows the nearest box (vehicle, pedestrian or cyclist, on a lane
or off the lanes) that reaches into the corridor that it is going to sweep.
"""

from dataclasses import fields, replace
from typing import Literal

import numpy as np
from pydantic import Field

from deepmf_sumo.planners.perception import nearest_in_corridor
from deepmf_sumo.plugins import Settings as PluginSettings
from deepmf_sumo.scene import Case, Command, RecordedCase, VehicleModel, View
from deepmf_sumo.scene.car_following import TREIBER

METADRIVE = VehicleModel(
    accel_mps2=1.0,
    decel_mps2=5.0,
    emergency_mps2=8.0,
    headway_s=1.5,
    gap_m=10.0,
    exponent=10.0,
    desired_mps=40 / 3.6,
)
"""The parameters of MetaDrive's TrajectoryIDMPolicy, in SUMO's IDM. Left out: its look-ahead of
20 m, its decisions at every fifth step, its mixture of km/h and m/s."""


class Settings(PluginSettings):
    """Single parameters override those of the set ``parameters``.

    Attributes:
        perception: ``lane`` or ``corridor``.
        parameters: ``treiber`` or ``metadrive``.
        margin_m: the corridor is wider than the AV by this on both sides.
        accel_mps2: largest acceleration; null: of ``parameters``.
        decel_mps2: usual braking; null: of ``parameters``.
        emergency_mps2: hardest braking; null: of ``parameters``.
        headway_s: time gap to the vehicle ahead; null: of ``parameters``.
        gap_m: least gap to the vehicle ahead; null: of ``parameters``.
        exponent: of the speed over the desired speed; null: of ``parameters``.
        desired_mps: if null, the larger of the speed limit and the recorded maximum.
    """

    perception: Literal["lane", "corridor"] = "lane"
    parameters: Literal["treiber", "metadrive"] = "treiber"
    margin_m: float = Field(default=0.2, ge=0.0, le=2.0)
    accel_mps2: float | None = Field(default=None, gt=0.0)
    decel_mps2: float | None = Field(default=None, gt=0.0)
    emergency_mps2: float | None = Field(default=None, gt=0.0)
    headway_s: float | None = Field(default=None, gt=0.0)
    gap_m: float | None = Field(default=None, ge=0.0)
    exponent: float | None = Field(default=None, gt=0.0)
    desired_mps: float | None = Field(default=None, gt=0.0)


class IdmPlanner:
    """Leaves the AV to SUMO's model; with corridor perception it also names the leader."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._model = _model(settings)
        self._corridor = settings.perception == "corridor"

    @property
    def model(self) -> VehicleModel | None:
        """Parameters of the AV's IDM."""
        return self._model

    def reset(self, case: Case, rng: np.random.Generator) -> None:
        """Choose the perception: on the off-lane (ghost) edge SUMO sees no other vehicle."""
        ghost = isinstance(case, RecordedCase) and case.net.ghost_edge is not None
        self._corridor = ghost or self._settings.perception == "corridor"

    def act(self, view: View) -> Command:
        """SUMO's own decision, or the leader in the corridor."""
        if not self._corridor or view.av_path_m is None:
            return Command(kind="sumo")
        leader = nearest_in_corridor(view, view.av_path_m, self._settings.margin_m)
        if leader is None:
            return Command(kind="sumo")
        return Command(
            kind="leader",
            gap_m=leader.gap_m,
            leader_mps=leader.speed_mps,
            leader_id=leader.agent_id,
        )


def build(settings: Settings) -> IdmPlanner:
    """The planner."""
    return IdmPlanner(settings)


def _model(settings: Settings) -> VehicleModel:
    base = METADRIVE if settings.parameters == "metadrive" else TREIBER
    names = {field.name for field in fields(VehicleModel)}
    model = replace(base, **settings.model_dump(include=names, exclude_none=True))
    # SUMO refuses an emergency deceleration below the comfortable one
    return replace(model, emergency_mps2=max(model.emergency_mps2, model.decel_mps2))
