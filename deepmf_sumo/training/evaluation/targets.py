"""Whom the trajectory predictors are measured on, and what is known of them."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from deepmf_sumo.datatypes import ROLLOUT, AgentId, Scene, View
from deepmf_sumo.training import windows
from deepmf_sumo.training.windows import Future

NEAR_M: Final = 50.0
"""Where a scene has no labels, vehicles that move within this distance of the AV are targets."""

Role = Literal["av", "partner"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Target:
    """An object to predict.

    Attributes:
        future: what it did. partner: whose future may be given, if there is anyone near.
        row: its row in the view. speed_mps: now.
        role: ``av``, or ``partner`` for whoever is not.
    """

    scene: Scene
    view: View
    future: Future
    partner: Future | None
    row: int
    speed_mps: float
    role: Role

    @property
    def agent_id(self) -> AgentId:
        """Its id."""
        return self.future.agent_id

    @property
    def planner(self) -> bool:
        """Whether an automated planner drives it: the AV of an attack."""
        return self.scene.source.dataset == ROLLOUT and self.role == "av"


def targets(scene: Scene, view: View) -> Iterator[Target]:
    """The labelled vehicles of a scene; without labels, the AV and what moves near it."""
    tracks = view.history
    origin = tracks.position_m[tracks.row(scene.av_id), -1]
    for future in windows.targets(scene, scene.now):
        row = tracks.row(future.agent_id)
        near = np.hypot(*(tracks.position_m[row, -1] - origin)) < NEAR_M
        if future.agent_id in scene.interest or (near and not scene.interest):
            yield Target(
                scene=scene,
                view=view,
                future=future,
                partner=windows.partner_of(scene, future.agent_id, scene.now),
                row=row,
                speed_mps=float(tracks.speed_mps[row, -1]),
                role="av" if future.agent_id == scene.av_id else "partner",
            )
