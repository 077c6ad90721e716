"""Rules for lights: yellow, intergreen times, conflicting greens, left turns through gaps."""

import math
from collections import defaultdict
from collections.abc import Iterator
from typing import Final

from deepmf_sumo.roadcheck.screening.findings import Case, Judged, Severity
from deepmf_sumo.roadcheck.screening.guidelines import KMH, Clearing, Guideline
from deepmf_sumo.roadcheck.screening.roads import (
    Program,
    SignalledNetwork,
    Way,
    common_place,
    for_motors,
)
from deepmf_sumo.scene.signals import GREEN_LETTERS, YELLOW_LETTERS

_OFF: Final = "off"
_MIRRORED: Final = {"left": "right", "right": "left"}
_SLACK_S: Final = 0.05
_CLEAR_S: Final = 1.0
"""Times that are short by as much are errors, by less warnings."""
_OPPOSITE_RAD: Final = math.radians(120)


def judge(roads: SignalledNetwork, book: Guideline, found: Judged) -> None:
    """All rules for lights, on all programs."""
    by_light: dict[str, list[Way]] = defaultdict(list)
    for ways in roads.ways.values():
        for way in ways:
            if way.link.light:
                by_light[way.link.light].append(way)
    _count_others(roads, found)
    known = {one.light for one in roads.programs}
    for light in sorted(by_light.keys() - known):
        found.not_judged[f"light without a program ({light})"] += 1
    for program in roads.programs:
        ways = by_light.get(program.light, [])
        reason = _refused(program, ways)
        if reason:
            found.not_judged[reason] += 1
        elif ways:
            _Light(roads, book, program, ways, found).judge()


def _count_others(roads: SignalledNetwork, found: Judged) -> None:
    """Signals of links that are not for motor vehicles."""
    lanes = roads.places.lanes
    for link in roads.net.links:
        if not link.light:
            continue
        if link.starts_inside or link.target.startswith(":"):
            found.not_judged["signal of a pedestrian crossing"] += 1
        elif not (for_motors(lanes[link.origin]) and for_motors(lanes[link.target])):
            found.not_judged["signal of a movement that is not for motor vehicles"] += 1


def _refused(program: Program, ways: list[Way]) -> str:
    """Why a program cannot be judged; empty where it can."""
    if _OFF in {program.name, program.kind}:
        return "program that is switched off"
    if program.kind == "NEMA" or not program.in_turn:
        return "program whose phases do not follow each other as listed (NEMA, next)"
    longest = max((way.link.index for way in ways), default=0)
    if any(len(one.state) <= longest for one in program.phases):
        return "program with fewer signals than its light has"
    return "" if program.phases else "program without phases"


class _Light:
    """One program and the ways that it rules."""

    def __init__(
        self,
        roads: SignalledNetwork,
        book: Guideline,
        program: Program,
        ways: list[Way],
        found: Judged,
    ) -> None:
        self.roads, self.book, self.program, self.found = roads, book, program, found
        self.ways = [way for way in ways if way.link.index >= 0]
        several = sum(one.light == program.light for one in roads.programs) > 1
        self.of_program = f" of program '{program.name}'" if several else ""

    def judge(self) -> None:
        """All rules."""
        for way in self.ways:
            self._yellow(way)
        for junction in sorted({way.junction for way in self.ways}):
            mine = {id(way) for way in self.ways if way.junction == junction}
            for one, two in self.roads.pairs(junction):
                if id(one) in mine and id(two) in mine:
                    self._greens(one, two)
                    self._clears(one, two)
                    self._clears(two, one)
            for way in self.ways:
                if way.junction == junction:
                    self._left(way)

    def _shown(self, way: Way) -> str:
        """What it shows, a letter for each phase."""
        return "".join(one.state[way.link.index] for one in self.program.phases)

    def _turn(self, way: Way) -> str:
        """As guidelines for traffic that keeps right call it: across oncoming traffic is left."""
        return _MIRRORED.get(way.turn, way.turn) if self.roads.net.left_hand else way.turn

    def _ends(self, way: Way) -> Iterator[int]:
        """Phases at which its green has just ended."""
        shown = self._shown(way)
        for place, letter in enumerate(shown):
            if shown[place - 1] in GREEN_LETTERS and letter not in GREEN_LETTERS:
                yield place

    def _from(self, place: int) -> Iterator[int]:
        """All phases from one on, once."""
        count = len(self.program.phases)
        yield from ((place + step) % count for step in range(count))

    def _case(self, **named: object) -> None:
        self.found.cases.append(Case(**named))  # type: ignore[arg-type]

    def _yellow(self, way: Way) -> None:
        limit = way.lane.speed_mps
        if limit <= 0:
            self.found.not_judged["approach without a speed limit"] += 1
            return
        self._fast(way)
        need = self.book.yellow_s(limit, self._turn(way), own_signal=self._own_signal(way))
        shown = self._shown(way)
        for end in self._ends(way):
            phases = []
            for place in self._from(end):
                if shown[place] not in YELLOW_LETTERS:
                    break
                phases.append(self.program.phases[place])
            if not all(one.fixed for one in phases):
                self.found.not_judged["yellow without a fixed length"] += 1
                continue
            seconds = sum(one.duration_s for one in phases)
            if seconds < need.value - _SLACK_S:
                what = f"a yellow of {seconds:g} s" if seconds else "no yellow"
                said = f"{way.said} has {what}{self.of_program}, {need.value:.3g} s are required"
                self._case(
                    rule="yellow", severity=_severity(seconds, need.value), edges=way.edges,
                    junction=way.junction, said=f"{said} {need.why}", measured=seconds,
                    required=need.value, unit="s", source=need.source,
                )  # fmt: skip

    def _fast(self, way: Way) -> None:
        """A limit above that which the guideline allows at signals."""
        most, limit = self.book.signals_mps, way.lane.speed_mps
        if most is not None and round(limit / KMH / 10) > round(most / KMH / 10):
            said = (
                f"signals on {way.lane.edge} at a limit of {limit / KMH:.0f} km/h, at most"
                f" {most / KMH:.0f} km/h are allowed"
            )
            self._case(
                rule="signal_speed", severity="warning", junction=way.junction,
                edges=(way.lane.edge,), said=said, measured=limit / KMH, required=most / KMH,
                unit="km/h", source=self.book.title,
            )  # fmt: skip

    def _own_signal(self, way: Way) -> bool:
        """Whether a turn has other signals than the straight way of its approach."""
        mine = self._shown(way).lower()
        straight = [
            one for one in self.ways if one.lane.edge == way.lane.edge and one.turn == "straight"
        ]
        return bool(straight) and all(self._shown(one).lower() != mine for one in straight)

    def _greens(self, one: Way, two: Way) -> None:
        both = zip(self._shown(one), self._shown(two), strict=True)
        phases = [place for place, letters in enumerate(both) if letters == ("G", "G")]
        if phases:
            said = (
                f"{one.said} and {two.said} meet and have a protected green at the same time, in"
                f" phase {phases[0]}{self.of_program}"
            )
            self._case(
                rule="conflicting_greens", severity="error", junction=one.junction,
                edges=tuple(dict.fromkeys((*one.edges, *two.edges))), said=said,
                measured=sum(self.program.phases[place].duration_s for place in phases),
                required=0.0, unit="s", source="SUMO: G is a green with priority",
            )  # fmt: skip

    def _clears(self, one: Way, two: Way) -> None:
        """From the end of the first one's green to the begin of the other's."""
        times = [time for end in self._ends(one) if (time := self._until(one, two, end))]
        if not times:
            return
        met = common_place(one, two)
        if met is None:
            self.found.not_judged["intergreen of foes whose ways do not come near each other"] += 1
            return
        bend = one.bend_rad
        need = self.book.clearance_s(
            Clearing(
                over_m=met[0], to_m=met[1], straight=one.turn == "straight",
                limit_mps=one.lane.speed_mps,
                radius_m=one.inner_m / bend if bend > 0.05 else math.inf,
            )
        )  # fmt: skip
        seconds = min(all_s if self.book.yellow_counts else red_s for all_s, red_s in times)
        if seconds < need.value - _SLACK_S:
            said = (
                f"{self.book.clearance} of {seconds:g} s{self.of_program} from {one.said} to"
                f" {two.said}, {need.value:.1f} s are required ({need.why})"
            )
            self._case(
                rule="intergreen", severity=_severity(seconds, need.value), said=said,
                junction=one.junction, edges=tuple(dict.fromkeys((*one.edges, *two.edges))),
                measured=seconds, required=need.value, unit="s", source=need.source,
            )  # fmt: skip

    def _until(self, one: Way, two: Way, end: int) -> tuple[float, float] | None:
        """Least seconds from the end of a green to the other's, and those without yellow.

        None where the other one has green already, or the first one again before it.
        """
        mine, its = self._shown(one), self._shown(two)
        if its[end - 1] in GREEN_LETTERS:
            return None
        every = red = 0.0
        for place in self._from(end):
            if its[place] in GREEN_LETTERS:
                return every, red
            if mine[place] in GREEN_LETTERS:
                return None
            seconds = self.program.phases[place].least_s
            every += seconds
            red += 0.0 if mine[place] in YELLOW_LETTERS else seconds
        return None

    def _left(self, way: Way) -> None:
        """A turn across oncoming traffic that looks for gaps."""
        if self._turn(way) != "left":
            return
        towards = [one for one in self.ways if self._comes_towards(way, one)]
        lanes, fastest, where = 0, 0.0, 0
        for place, letter in enumerate(self._shown(way)):
            met = {
                one.lane.id: one.lane.speed_mps
                for one in towards
                if letter == "g" and self._shown(one)[place] in GREEN_LETTERS
            }
            if (len(met), max(met.values(), default=0.0)) > (lanes, fastest):
                lanes, fastest, where = len(met), max(met.values()), place
        most, mps = self.book.oncoming_lanes, self.book.oncoming_mps
        if lanes <= most and fastest <= mps + 2 * KMH:
            return
        count = "1 oncoming lane" if lanes == 1 else f"{lanes} oncoming lanes"
        said = (
            f"{way.said} turns through gaps (permissive green, phase {where}{self.of_program}) of"
            f" {count} at {fastest / KMH:.0f} km/h, without a green of its own at most {most} at"
            f" {mps / KMH:.0f} km/h"
        )
        wide = lanes > most
        self._case(
            rule="permissive_left", severity="warning", junction=way.junction, edges=way.edges,
            said=said, measured=float(lanes) if wide else fastest / KMH,
            required=float(most) if wide else mps / KMH, unit="lanes" if wide else "km/h",
            source=self.book.left_source,
        )  # fmt: skip

    def _comes_towards(self, way: Way, other: Way) -> bool:
        if other.junction != way.junction or other.turn != "straight":
            return False
        between = abs(
            self.roads.places.heading_rad(way.lane.edge)
            - self.roads.places.heading_rad(other.lane.edge)
        )
        apart = min(between, 2 * math.pi - between)
        return apart > _OPPOSITE_RAD and self.roads.waits(way, other)


def _severity(measured: float, required: float) -> Severity:
    return "error" if required - measured >= _CLEAR_S - _SLACK_S else "warning"
