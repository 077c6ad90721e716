"""Flaws that `plant.py` puts into a network of others: where each can be, and what it changes.

A flaw is planted into SUMO's own XML, read as a tree. A place is a junction with two conflicting
movements (from an edge to an edge) that both have traffic. A light's programmes may also lie in
additional files: all of them are judged and changed, whichever SUMO would run.
"""

# ruff: noqa: INP001 - a script beside data, not a package

import itertools
import statistics
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, Final, NamedTuple

Way = tuple[str, str]
"""From an edge to an edge."""
GREEN: Final = "Gg"
YELLOW: Final = "Yy"
FASTER: Final = 1.6
RUN_UP_M: Final = 60.0
"""On a shorter approach no vehicle gets to a higher speed."""
USUAL: Final = 1.3
"""An approach whose limit is above this multiple of the network's median is fast already."""
LONGEST_CYCLE_S: Final = 180.0
"""Lights that change less often are not seen changing in the time of attacks."""
SIGNED: Final = {"priority", "priority_stop", "allway_stop"}
WITH_LIGHT: Final = {"traffic_light", "traffic_light_right_on_red"}


class Light(NamedTuple):
    """Which signal a connection has; -1 and empty without one."""

    name: str
    index: int


class Link(NamedTuple):
    """A connection over a junction, in the order of the junction's requests."""

    element: ET.Element
    way: Way
    turn: str
    light: Light


class Junction(NamedTuple):
    """A junction with its connections; ``yields`` and ``foes``: the rows of others, by row."""

    element: ET.Element
    links: list[Link]
    yields: list[set[int]]
    foes: list[set[int]]

    @property
    def name(self) -> str:
        """Its id."""
        return self.element.get("id", "")

    def conflicts(self) -> Iterator[tuple[int, int]]:
        """Rows that meet and come from two edges, in both orders."""
        for row, others in enumerate(self.foes):
            for other in sorted(others):
                if self.links[row].way[0] != self.links[other].way[0]:
                    yield row, other


class Network:
    """Trees of a network and of additional files, with what flaws need to know of them."""

    def __init__(self, net: ET.Element, additional: Sequence[ET.Element] = ()) -> None:
        self.net = net
        self.programs: dict[str, list[ET.Element]] = defaultdict(list)
        for tree in (net, *additional):
            for program in tree.iter("tlLogic"):
                if "off" not in {program.get("programID"), program.get("type")}:
                    self.programs[program.get("id", "")].append(program)
        self.edges = {edge.get("id", ""): edge for edge in net.iter("edge")}

    @cached_property
    def junctions(self) -> list[Junction]:
        """Those with traffic of two edges and a request for each connection, by id."""
        links: dict[str, list[Link]] = defaultdict(list)
        walks = {name for name, one in self.edges.items() if one.get("function") == "walkingarea"}
        for one in self.net.iter("connection"):
            if one.get("to") in walks:  # pedestrians step aside without a request
                continue
            light = Light(one.get("tl", ""), int(one.get("linkIndex", "-1")))
            way = one.get("from", ""), one.get("to", "")
            links[f"{way[0]}_{one.get('fromLane')}"].append(
                Link(one, way, one.get("dir", ""), light)
            )
        found = []
        for element in self.net.iter("junction"):
            own = [link for lane in element.get("incLanes", "").split() for link in links[lane]]
            requests = sorted(element.iter("request"), key=lambda one: int(one.get("index", "0")))
            if element.get("type") != "internal" and len(own) == len(requests) > 1:
                bits = [
                    [_rows(one.get(key, "")) for one in requests] for key in ("response", "foes")
                ]
                found.append(Junction(element, own, *bits))
        return sorted(found, key=lambda one: one.name)

    def limit_mps(self, edge: str) -> float:
        """The highest of its lanes."""
        return max(float(lane.get("speed", "0")) for lane in self.edges[edge].iter("lane"))

    def length_m(self, edge: str) -> float:
        """Of its first lane."""
        return float(next(self.edges[edge].iter("lane")).get("length", "0"))

    def approaches(self, junction: Junction) -> list[str]:
        """Edges that lead to it, none that is inside a junction."""
        edges = {link.way[0] for link in junction.links}
        return sorted(edge for edge in edges if edge in self.edges and not edge.startswith(":"))

    @cached_property
    def usual_mps(self) -> float:
        """The median limit of approaches."""
        return statistics.median(
            self.limit_mps(edge) for one in self.junctions for edge in self.approaches(one)
        )

    def lights(self, junction: Junction) -> list[ET.Element]:
        """The programmes of its light; none where it has no light or shares it with another."""
        names = {link.light.name for link in junction.links if link.light.name}
        if junction.element.get("type") not in WITH_LIGHT or len(names) != 1:
            return []
        (name,) = names
        others = any(
            link.light.name == name
            for one in self.junctions
            for link in one.links
            if one.name != junction.name
        )
        return [] if others else self.programs[name]


def _rows(bits: str) -> set[int]:
    """SUMO writes the bit of link 0 last."""
    return {row for row, bit in enumerate(reversed(bits)) if bit == "1"}


def _states(program: ET.Element) -> list[str]:
    return [phase.get("state", "") for phase in program.iter("phase")]


def _changes(program: ET.Element) -> bool:
    """Whether it is a plain cycle of known length that vehicles see more than once."""
    phases = list(program.iter("phase"))
    cycle_s = sum(float(phase.get("duration", "inf")) for phase in phases)
    plain = program.get("type", "static") in {"static", "actuated", "delay_based"}
    return plain and cycle_s <= LONGEST_CYCLE_S and not any(one.get("next") for one in phases)


Pairs = Iterator[tuple[int, int]]


def _no_yellow_at(network: Network, junction: Junction) -> Pairs:
    """Rows of which the one's green ends with a yellow before the other's begins."""
    programs = network.lights(junction)
    if not programs or not all(_changes(one) and _yellow(one) for one in programs):
        return
    kept = [[state for state in _states(one) if _stays(state)] for one in programs]
    for row, other in junction.conflicts():
        mine, its = (junction.links[one].light.index for one in (row, other))
        if min(mine, its) >= 0 and all(_hands_over(states, mine, its) for states in kept):
            yield row, other


def _yellow(program: ET.Element) -> bool:
    return any(set(state) & set(YELLOW) for state in _states(program))


def _stays(state: str) -> bool:
    """Whether a phase is left when yellow and all-red are taken out."""
    return bool(set(state) & set(GREEN)) and not set(state) & set(YELLOW)


def _hands_over(states: list[str], mine: int, its: int) -> bool:
    """Whether one green follows the other at once, in a cycle of these phases."""
    return any(
        now[mine] in GREEN and now[its] not in GREEN and then[its] in GREEN
        and then[mine] not in GREEN
        for now, then in itertools.pairwise([*states, *states[:1]])
    )  # fmt: skip


def _no_yellow(network: Network, junction: Junction, _pair: tuple[int, int]) -> dict[str, Any]:
    changed = {}
    for program in network.lights(junction):
        before = _cycle(program)
        phases = list(program.iter("phase"))
        first = next(place for place, one in enumerate(phases) if _stays(one.get("state", "")))
        lead_s = sum(float(one.get("duration", "0")) for one in phases[:first])
        last = None
        for phase in phases[first:] + phases[:first]:
            if _stays(phase.get("state", "")):
                last = phase
            elif last is not None:
                _lengthen(last, float(phase.get("duration", "0")))
                program.remove(phase)
        if lead_s:  # the cycle begins later by what was before its first green
            program.set("offset", f"{float(program.get('offset', '0')) + lead_s:g}")
        changed[program.get("programID", "")] = {"before": before, "after": _cycle(program)}
    return {"programs": changed}


def _lengthen(phase: ET.Element, seconds: float) -> None:
    for key in ("duration", "minDur", "maxDur"):
        if phase.get(key) is not None:
            phase.set(key, f"{float(phase.get(key, '0')) + seconds:g}")


def _cycle(program: ET.Element) -> list[str]:
    """Its phases, ``seconds:state``."""
    return [f"{one.get('duration')}:{one.get('state')}" for one in program.iter("phase")]


def _fast_approach_at(network: Network, junction: Junction) -> Pairs:
    limits = {edge: network.limit_mps(edge) for edge in network.approaches(junction)}
    if not limits or max(limits.values()) > USUAL * network.usual_mps:
        return
    for row, other in junction.conflicts():
        edge, straight = junction.links[row].way[0], junction.links[row].turn == "s"
        if straight and edge in limits and network.length_m(edge) >= RUN_UP_M:
            yield row, other


def _fast_approach(network: Network, junction: Junction, _pair: tuple[int, int]) -> dict[str, Any]:
    """Straight ways over the junction count to their approach: SUMO's vehicles brake for a lane."""
    over = [link.element.get("via", "") for link in junction.links if link.turn == "s"]
    inner = {lane for lane in over if lane}
    changed = {}
    for edge in network.edges.values():
        approach = edge.get("id") in network.approaches(junction)
        for lane in edge.iter("lane"):
            if approach or lane.get("id") in inner:
                old = lane.get("speed", "0")
                lane.set("speed", f"{float(old) * FASTER:.2f}")
                changed[lane.get("id", "")] = [old, lane.get("speed")]
    return {"lanes": changed}


def _no_priority_at(_network: Network, junction: Junction) -> Pairs:
    if junction.element.get("type") not in SIGNED:
        return
    for row, other in junction.conflicts():
        if other in junction.yields[row] and junction.links[row].element.get("state") in {*"msw"}:
            yield row, other


def _no_priority(network: Network, junction: Junction, _pair: tuple[int, int]) -> dict[str, Any]:
    """``foes`` stay: vehicles still brake for one inside the junction."""
    requests, links, waits = {}, {}, []
    for one in junction.element.iter("request"):
        old = one.get("response", "")
        one.set("response", "0" * len(old))
        requests[one.get("index", "")] = [old, one.get("response")]
    inner = f":{junction.name}_"
    for link in network.net.iter("connection"):
        own = any(link is one.element for one in junction.links)
        if (own or _inside(link.get("from", ""), inner)) and link.get("state") in {*"msw"}:
            old = link.get("state")
            link.set("state", "M")
            name = f"{link.get('from')}_{link.get('fromLane')} -> {link.get('to')}"
            links[f"{name}_{link.get('toLane')}"] = [old, "M"]
    for node in network.net.iter("junction"):
        # where left turns wait in the middle for vehicles that come
        if node.get("type") == "internal" and _inside(node.get("id", "").rpartition("_")[0], inner):
            node.set("incLanes", node.get("incLanes", "").partition(" ")[0])
            node.set("intLanes", "")
            waits.append(node.get("id", ""))
    return {"requests": requests, "links": links, "waiting_places": waits}


def _inside(edge: str, prefix: str) -> bool:
    """Whether an edge is inside the junction of ``:NAME_``; other names may begin alike."""
    return edge.startswith(prefix) and edge[len(prefix) :].isdigit()


def _permissive_left_at(network: Network, junction: Junction) -> Pairs:
    """Left turns that are red while all that comes towards them has green, and oncoming ways."""
    programs = network.lights(junction)
    if not programs or not all(map(_changes, programs)):
        return
    for left, oncoming in junction.conflicts():
        towards = junction.links[left].turn == "l" and oncoming in _oncoming(junction, left)
        if towards and all(_protected(junction, _states(one), left, oncoming) for one in programs):
            yield left, oncoming


def _oncoming(junction: Junction, left: int) -> set[int]:
    """Straight ways that a left turn gives way to, and that do not cross its own road."""
    own = junction.links[left].way[0]
    straight = {
        row for row, one in enumerate(junction.links) if one.way[0] == own and one.turn == "s"
    }
    return {
        row
        for row in junction.yields[left] & junction.foes[left]
        if straight and junction.links[row].turn == "s" and not straight & junction.foes[row]
    }


def _protected(junction: Junction, states: list[str], left: int, oncoming: int) -> bool:
    """Whether the turn has a green of its own, and yields to all others that a new one meets."""
    signals = [link.light.index for link in junction.links]
    mine, its = signals[left], signals[oncoming]
    if min(mine, its) < 0 or any(one[mine] in GREEN and one[its] in GREEN for one in states):
        return False
    planted = [one for one in states if one[mine] == "r" and one[its] == "G"]
    rivals = junction.foes[left] - junction.yields[left]
    free = not any(one[signals[row]] in GREEN for one in planted for row in rivals)
    return bool(planted) and free and any(one[mine] == "G" for one in states)


def _permissive_left(network: Network, junction: Junction, pair: tuple[int, int]) -> dict[str, Any]:
    way, its = junction.links[pair[0]].way, junction.links[pair[1]].light.index
    mine = sorted({link.light.index for link in junction.links if link.way == way})
    changed = {}
    for program in network.lights(junction):
        before = _cycle(program)
        for phase in program.iter("phase"):
            state = list(phase.get("state", ""))
            for one in mine:
                if state[one] == "r" and state[its] in {"G", *YELLOW}:
                    state[one] = "g" if state[its] == "G" else "y"
            phase.set("state", "".join(state))
        changed[program.get("programID", "")] = {"before": before, "after": _cycle(program)}
    return {"signals": mine, "programs": changed}


class Flaw(NamedTuple):
    """``where`` yields the conflicts that it needs, ``plant`` changes the trees and tells what."""

    where: Callable[[Network, Junction], Pairs]
    plant: Callable[[Network, Junction, tuple[int, int]], dict[str, Any]]
    needs: str


FLAWS: Final[Mapping[str, Flaw]] = {
    "no_yellow": Flaw(
        _no_yellow_at, _no_yellow, "a light of its own with a yellow between conflicting greens"
    ),
    "fast_approach": Flaw(
        _fast_approach_at, _fast_approach,
        f"an approach of {RUN_UP_M:g} m, not fast yet, straight into a conflict",
    ),
    "no_priority": Flaw(
        _no_priority_at, _no_priority, "no light, and a sign by which one movement gives way"
    ),
    "permissive_left": Flaw(
        _permissive_left_at, _permissive_left, "a light of its own that protects a left turn"
    ),
}  # fmt: skip
