"""What a planner sees where the AV sees no more than is in its line of sight."""

from dataclasses import replace

import numpy as np

from deepmf_sumo.scene import AgentId, View
from deepmf_sumo.scene.geometry import sight

_BY_STEP = ("position_m", "z_m", "heading_rad", "velocity_mps")


class InSight:
    """Takes from the views of one episode whom the AV cannot see (`scene.geometry.sight`).

    Who is hidden now is not in the view. Who was hidden in the last second, and no longer is, has
    no state at those steps: a planner that sees somebody for the first time does not know how he
    came there.
    """

    def __init__(self) -> None:
        self._hidden: dict[int, frozenset[AgentId]] = {}

    def limited(self, view: View) -> View:
        """The view without who is hidden. To be called for each step."""
        tracks = view.history
        first = view.step + 1 - tracks.steps
        av = tracks.row(view.av_id)
        hidden = np.zeros((tracks.agents, tracks.steps), bool)
        for at in range(tracks.steps):
            step = first + at
            if step not in self._hidden:
                seen = sight.visible(tracks, at, av, view.road)
                unseen = np.flatnonzero(tracks.valid[:, at] & ~seen).tolist()
                self._hidden[step] = frozenset(tracks.ids[row] for row in unseen)
            hidden[:, at] = [one in self._hidden[step] for one in tracks.ids]
        self._hidden = {step: ids for step, ids in self._hidden.items() if step >= first}
        if not hidden.any():
            return view
        shown = {name: getattr(tracks, name).copy() for name in _BY_STEP}
        for values in shown.values():
            values[hidden] = 0.0
        rest = replace(tracks, valid=tracks.valid & ~hidden, **shown)
        kept = np.flatnonzero(rest.valid[:, -1]).tolist()
        return replace(view, history=rest.select(kept))
