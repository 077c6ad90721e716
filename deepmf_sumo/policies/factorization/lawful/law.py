"""Judges the candidates of one plan after the other."""

from dataclasses import dataclass, field

import numpy as np

from deepmf_sumo.datatypes import AgentId, Bools, Floats, Forecast, Futures, View
from deepmf_sumo.policies.factorization.lawful import rules
from deepmf_sumo.policies.factorization.lawful.driven import Driven
from deepmf_sumo.policies.factorization.lawful.lines import HALT, OVER_M, stop_lines


@dataclass(slots=True)
class Law:
    """Remembers who could have stopped at a line: until its light lets go, that is owed.

    Without that memory an opponent could approach a red light until it is too late to stop. And who
    stood before a sign: it may drive on, also where a plan is made before it is over the line. And
    how fast an opponent came into a junction: else it could halve its speed with each plan.
    """

    _owed: set[tuple[AgentId, str]] = field(default_factory=set)
    _stood: set[tuple[AgentId, str]] = field(default_factory=set)
    _inside_mps: dict[AgentId, float] = field(default_factory=dict)

    def lawful(
        self,
        view: View,
        futures: Futures,
        speed_mps: Floats,
        alone: Forecast,
        collision_step: Floats,
    ) -> Bools:
        """(N) futures that break no rule.

        Args:
            view: the present.
            futures: N of the opponent, as it would drive them.
            speed_mps: (N, F) of them.
            alone: the AV's futures if nobody attacks.
            collision_step: (N, M) at which each first touches the AV in each of its M reactions; F
                where it does not.
        """
        driven = Driven.of(view, futures, speed_mps, alone)
        if not driven.ways.begins.any():
            return np.ones(len(futures.position_m), bool)
        self._forget(view)
        touches = np.asarray((collision_step < speed_mps.shape[1]).any(axis=1))
        halts, over_line = self._lines(view, futures.agent_id, driven)
        return ~(
            over_line
            | rules.off_lanes(driven)
            | rules.speeds(driven)
            | rules.takes_way(view, driven)
            | rules.cuts_in(driven, collision_step)
            | self._blocks(view, futures.agent_id, driven)
            | rules.hinders(view, driven, touches, halts)
        )

    def _lines(self, view: View, agent_id: AgentId, driven: Driven) -> tuple[bool, Bools]:
        """Whether a line makes the opponent stop, and (N) futures that drive over one."""
        over, halts = np.zeros(len(driven.position_m), bool), False
        row = view.history.row(agent_id)
        slowest_mps = float(view.history.speed_mps[row, view.history.valid[row]].min())
        lines = [line for line in stop_lines(view, driven.ways) if line.before_m(driven) >= -OVER_M]
        self._stood &= {(agent_id, line.lane.id) for line in lines}
        for line in lines:
            key, before_m = (agent_id, line.lane.id), line.before_m(driven)
            if line.stood(driven, slowest_mps):
                self._stood.add(key)
            if max(before_m, 0.0) >= driven.start.speed_mps**2 / (2 * line.brake_mps2):
                self._owed.add(key)
            if key in self._owed:
                halts = True
                if key not in self._stood:
                    over |= line.crossed(driven)
        return halts, over

    def _blocks(self, view: View, agent_id: AgentId, driven: Driven) -> Bools:
        """(N) futures that slow down inside a junction without a cause."""
        free = rules.through(view, driven)
        fastest = 0.0
        if (free & driven.ways.begins).any():
            row = view.history.row(agent_id)
            now = float(view.history.speed_mps[row, view.history.valid[row]].max())
            fastest = max(self._inside_mps.get(agent_id, 0.0), now)
        self._inside_mps[agent_id] = fastest
        return rules.blocks(driven, free, fastest)

    def _forget(self, view: View) -> None:
        """Of lights that let go; signs stay."""
        self._owed = {
            (who, lane)
            for who, lane in self._owed
            if lane not in view.signals or view.signals[lane] in HALT
        }
