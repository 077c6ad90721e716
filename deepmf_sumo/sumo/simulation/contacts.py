"""Contacts: which boxes overlap and did not before, which vehicle struck, and how hard."""

from collections.abc import Iterator

import numpy as np

from deepmf_sumo.scene import AgentId, Contact, Event, Floats, agent_ids
from deepmf_sumo.scene.geometry import boxes, frames, impact
from deepmf_sumo.scene.geometry.ground import clear
from deepmf_sumo.scene.rollout import ContactKind
from deepmf_sumo.sumo.simulation.frame import Frame

Pair = frozenset[AgentId]


def overlapping(
    row: int, centre_m: Floats, heading_rad: Floats, size_m: Floats, z_m: Floats
) -> list[int]:
    """Rows of the other boxes that overlap the box of a row.

    Boxes overlap if they do so seen from above and their heights differ by less than 2.5 m.

    Args:
        row: of one of the N boxes.
        centre_m: (N, 2).
        heading_rad: (N).
        size_m: (N, 2) length and width.
        z_m: (N).
    """
    hit = boxes.overlap(centre_m[row], heading_rad[row], size_m[row], centre_m, heading_rad, size_m)
    hit &= ~clear(z_m[row], z_m)
    hit[row] = False
    return np.flatnonzero(hit).tolist()


_APART_M = 0.25
"""Recorded boxes jitter: a pair has come apart once its gap is larger than this."""


class ContactFinder:
    """Finds the first contact of AV, attackers and supporters with every other agent.

    A contact is an overlap into which a pair has driven. A pair that begins to overlap at the first
    frame, in the frame in which one of the two appears, or in the step in which one of the two
    changes its owner (`ownership`) has not driven into each other: that is not counted, an event
    says so, and the pair may come into contact once it has come apart. A vehicle of several boxes
    counts once.
    """

    def __init__(self, av_id: AgentId, attackers: tuple[AgentId, ...]) -> None:
        self.contacts: list[Contact] = []
        self.events: list[Event] = []
        self._av, self.attackers = av_id, attackers
        self.supporters: tuple[AgentId, ...] = ()
        self._counted: set[Pair] = set()
        self._excused: set[Pair] = set()
        self._before: Frame | None = None

    def look(self, step: int, frame: Frame, size_m: Floats) -> None:
        """Judge one frame; ``size_m`` (N, 2) are the lengths and widths of its agents."""
        if self._excused:
            self._excused &= {pair for *_, pair in self._overlapping(frame, size_m + 2 * _APART_M)}
        for me, other, pair in self._overlapping(frame, size_m):
            if pair not in self._counted | self._excused:
                self._settle(step, frame, size_m, me, other, pair)
        self._before = frame

    @property
    def excuses(self) -> bool:
        """Whether a pair overlaps, or nearly does, without a contact."""
        return bool(self._excused)

    def hits(self, step: int) -> list[AgentId]:
        """The attackers that came into contact with the AV at a step."""
        return [
            one.second_id for one in self.contacts if one.kind == "av_opponent" and one.step == step
        ]

    def turn_to(
        self, attackers: tuple[AgentId, ...], step: int, frame: Frame, size_m: Floats
    ) -> None:
        """Judge for other attackers from here on, as if the episode began with this frame.

        Pairs that are apart by now may come into contact again.
        """
        self.attackers = attackers
        self._excused |= self._counted & {pair for *_, pair in self._overlapping(frame, size_m)}
        self._counted.clear()
        self._before = None
        self.look(step, frame, size_m)

    def watch(
        self, supporters: tuple[AgentId, ...], step: int, frame: Frame, size_m: Floats
    ) -> None:
        """Judge for other supporters from here on; what they overlap in this frame is excused."""
        self.supporters, self._before = supporters, None
        self.look(step, frame, size_m)

    def _overlapping(self, frame: Frame, size_m: Floats) -> Iterator[tuple[int, int, Pair]]:
        """Row of one that is watched, row of the other agent, and the ids of the pair."""
        for mine in (self._av, *self.attackers, *self.supporters):
            if mine not in frame.ids:
                continue
            me = frame.ids.index(mine)
            for other in overlapping(me, frame.position_m, frame.heading_rad, size_m, frame.z_m):
                yield me, other, frozenset((mine, agent_ids.whole_of(frame.ids[other])))

    def _settle(
        self, step: int, frame: Frame, size_m: Floats, me: int, other: int, pair: Pair
    ) -> None:
        mine, theirs = frame.ids[me], frame.ids[other]
        kind = self._excuse(frame, mine, theirs)
        if kind is not None:
            self._excused.add(pair)
            detail = f"with {theirs}; not counted as a contact"
            self.events.append(Event(step=step, agent_id=mine, kind=kind, detail=detail))
            return
        assert self._before is not None
        self._counted.add(pair)
        self.contacts.append(self._contact(step, frame, self._before, size_m, me, other))

    def _excuse(self, frame: Frame, mine: AgentId, theirs: AgentId) -> str | None:
        """The event of an overlap that begins in a frame and is no contact; None if it is one."""
        before = self._before
        if before is None:
            return "overlap_at_start"
        if mine not in before.ids or theirs not in before.ids:
            return "appeared_in_overlap"
        owners = [
            [one.driver[one.ids.index(agent)] for agent in (mine, theirs)]
            for one in (before, frame)
        ]
        return None if owners[0] == owners[1] else "overlap_at_hand_over"

    def _kind(self, mine: AgentId, theirs: AgentId) -> ContactKind:
        if mine in self.supporters:
            return "supporter_other"
        if mine != self._av:
            return "opponent_other"
        return "av_opponent" if theirs in self.attackers else "av_other"

    def _contact(
        self, step: int, frame: Frame, before: Frame, size_m: Floats, me: int, other: int
    ) -> Contact:
        mine, theirs = frame.ids[me], frame.ids[other]
        pair = [before.ids.index(mine), before.ids.index(theirs)]
        centre, heading = before.position_m[pair], before.heading_rad[pair]
        velocity, size = before.velocity_mps[pair], size_m[[me, other]]
        towards = np.stack(
            [
                _direction(centre[0], _nearest_point(centre[0], centre[1], heading[1], size[1])),
                _direction(centre[1], _nearest_point(centre[1], centre[0], heading[0], size[0])),
            ]
        )
        approach = (velocity * towards).sum(-1)
        relative = velocity[1] - velocity[0]
        area = np.array([_area_m2(frame, size_m, row) for row in (me, other)])
        poses = np.column_stack([frame.position_m, frame.heading_rad])
        return Contact(
            kind=self._kind(mine, theirs),
            step=step,
            first_id=mine,
            second_id=theirs,
            striker_id=mine if approach[0] >= approach[1] else theirs,
            pose_first=poses[me],
            pose_second=poses[other],
            relative_mps=float(np.hypot(*relative)),
            closing_mps=float(-relative @ _direction(centre[0], centre[1])),
            sector=int(
                impact.sectors(
                    poses[me, :2], poses[me, 2], size[0], poses[other, :2], poses[other, 2], size[1]
                )
            ),
            delta_v_mps=float(impact.delta_v(np.hypot(*relative), area[0], area[1])),
        )


def _area_m2(frame: Frame, size_m: Floats, row: int) -> float:
    """Area of a road user, with all its boxes."""
    whole = agent_ids.whole_of(frame.ids[row])
    rows = [row for row, one in enumerate(frame.ids) if agent_ids.whole_of(one) == whole]
    return float(size_m[rows].prod(axis=1).sum())


def _nearest_point(of: Floats, centre: Floats, heading: float, size: Floats) -> Floats:
    """The point of a box that is nearest to a point."""
    local = np.clip(frames.to_local(of, centre, heading), -size / 2, size / 2)
    return frames.to_scene(local, centre, heading)


def _direction(start: Floats, end: Floats) -> Floats:
    offset = np.asarray(end) - start
    return offset / max(float(np.hypot(*offset)), 1e-9)
