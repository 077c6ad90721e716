"""Changes of a signal program: yellow, all-red, and left turns with a green of their own.

A program is a cycle of phases; each has a duration and one letter for each link (``G``, ``g``:
green, ``y``, ``Y``: yellow, the rest: none of both), as in SUMO's ``tlLogic``.
"""

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from deepmf_sumo.errors import UsageError
from deepmf_sumo.roadcheck.countermeasures.document import Change
from deepmf_sumo.scene.signals import GREEN_LETTERS, YELLOW_LETTERS

LEAST_GREEN_S: Final = 5.0
"""Less is not left of a green that gives time to a change."""
_TIMES: Final = ("duration", "minDur", "maxDur")
Foes = Callable[[int, int], bool]
"""Whether the ways of two links meet."""


@dataclass(frozen=True, slots=True)
class NewPhase:
    """A phase.

    Attributes:
        added_s: on top of the times that its element, if it has one, names.
        actuated: the light chooses its length; a static program ignores ``minDur``.
    """

    state: str
    duration_s: float
    element: ET.Element | None = None
    added_s: float = 0.0
    actuated: bool = False

    def green(self, link: int) -> bool:
        """Whether a link may go."""
        return self.state[link] in GREEN_LETTERS

    @property
    def least_s(self) -> float:
        """How long it is whatever an actuated light chooses."""
        if self.element is None or not self.actuated:
            return self.duration_s
        return min(self.duration_s, float(self.element.get("minDur", "0")) + self.added_s)

    def longer(self, seconds: float) -> "NewPhase":
        """The phase with more time, or with less."""
        return replace(self, duration_s=self.duration_s + seconds, added_s=self.added_s + seconds)

    def __str__(self) -> str:
        """``seconds:state``."""
        return f"{self.duration_s:g}:{self.state}"


def changed(
    name: str, program: ET.Element, change: Change, lefts: Iterable[int], foes: Foes
) -> tuple[list[NewPhase], list[NewPhase]]:
    """The phases of a program before and after a change.

    Args:
        name: of the signal, for messages.
        program: a ``tlLogic``.
        change: of a signal.
        lefts: links that turn left.
        foes: which links meet.

    Raises UsageError where the program is not a plain cycle, or a green is too short.
    """
    before = phases(name, program)
    after = list(before)
    if change.protected_left_s is not None:
        after = _protected(name, after, change, lefts, foes)
    if change.yellow_s is not None:
        after = _with_yellow(name, after, change.yellow_s, keep=change.cycle == "keep")
    if change.all_red_s is not None:
        after = _with_all_red(name, after, change.all_red_s, keep=change.cycle == "keep")
    return before, after


NEMA: Final = "NEMA"
"""SUMO's controller with two rings of phases: each phase has its yellow and red as attributes, and
further phases are ignored."""


def change_nema(name: str, program: ET.Element, change: Change) -> tuple[str, str]:
    """Make yellow and red of each phase at least as long as the change says.

    Returns the times before and after, for a message. Raises UsageError for a protected left turn,
    which needs other rings.
    """
    if change.protected_left_s is not None:
        raise UsageError(
            f"signal '{name}': program '{program.get('programID')}' is a NEMA controller, whose"
            " left turns are protected by its rings; change it in netedit."
        )
    phases = list(program.iter("phase"))
    before = _times(phases)
    for key, least_s in (("yellow", change.yellow_s), ("red", change.all_red_s)):
        for phase in phases:
            if least_s is not None and float(phase.get(key, "0")) < least_s:
                phase.set(key, f"{least_s:g}")
    return before, _times(phases)


def _times(phases: Iterable[ET.Element]) -> str:
    return " ".join(
        f"{one.get('name', '')}:{one.get('yellow', '0')}+{one.get('red', '0')}" for one in phases
    )


def phases(name: str, program: ET.Element) -> list[NewPhase]:
    """The cycle. Raises UsageError for a program that is not one."""
    elements = list(program.iter("phase"))
    kind = program.get("type", "static")
    if not elements or any(one.get("next") for one in elements):
        raise UsageError(
            f"signal '{name}': program '{program.get('programID')}' ({kind}) is not a plain cycle"
            " of phases, which is what can be changed; change it in netedit."
        )
    return [
        NewPhase(
            one.get("state", ""), float(one.get("duration", "0")), one,
            actuated=kind != "static" and one.get("minDur") is not None,
        )
        for one in elements
    ]  # fmt: skip


def write(program: ET.Element, cycle: Sequence[NewPhase]) -> None:
    """Put a cycle into its element in place of the phases there."""
    for one in program.findall("phase"):
        program.remove(one)
    for phase in cycle:
        element = ET.Element(
            "phase", dict(phase.element.attrib) if phase.element is not None else {}
        )
        element.set("state", phase.state)
        if phase.element is None:
            element.set("duration", f"{phase.duration_s:g}")
        elif phase.added_s:
            for key in _TIMES:
                if element.get(key) is not None:
                    element.set(key, f"{float(element.get(key, '0')) + phase.added_s:g}")
        program.append(element)


def _with_yellow(
    name: str, cycle: list[NewPhase], yellow_s: float, *, keep: bool
) -> list[NewPhase]:
    """Each green ends with at least ``yellow_s`` of yellow."""
    found: list[NewPhase] = []
    for place, phase in enumerate(cycle):
        behind = cycle[(place + 1) % len(cycle)]
        ending = [link for link in _links(cycle) if phase.green(link) and not behind.green(link)]
        found.append(phase)
        if any(behind.state[link] not in YELLOW_LETTERS for link in ending):
            state = _between(phase, behind, ending, "y")
            found.append(NewPhase(state, yellow_s))
            found[-2] = _shorter(name, phase, yellow_s, keep=keep)
    return _longer_runs(name, found, _is_yellow, yellow_s, keep=keep)


def _with_all_red(name: str, cycle: list[NewPhase], red_s: float, *, keep: bool) -> list[NewPhase]:
    """At least ``red_s`` lie between the end of a yellow and the next green."""
    found: list[NewPhase] = []
    for place, phase in enumerate(cycle):
        behind = cycle[(place + 1) % len(cycle)]
        gone = [
            link for link in _links(cycle)
            if phase.state[link] in YELLOW_LETTERS and behind.state[link] not in YELLOW_LETTERS
        ]  # fmt: skip
        found.append(phase)
        if gone and _begins(phase, behind):
            found.append(NewPhase(_between(phase, behind, gone, "r"), red_s))
            place_of_green = _green_before(found, len(found) - 1)
            found[place_of_green] = _shorter(name, found[place_of_green], red_s, keep=keep)
    return _longer_runs(name, found, _is_pause, red_s, keep=keep)


def _links(cycle: Sequence[NewPhase]) -> range:
    return range(len(cycle[0].state))


def _begins(phase: NewPhase, behind: NewPhase) -> bool:
    """Whether a link gets green."""
    return any(behind.green(link) and not phase.green(link) for link in range(len(phase.state)))


def _between(phase: NewPhase, behind: NewPhase, ending: Sequence[int], letter: str) -> str:
    """The state of a phase between two: what goes on stays, what ends has the letter."""
    state = [
        "r" if new in GREEN_LETTERS and old not in GREEN_LETTERS else old
        for old, new in zip(phase.state, behind.state, strict=True)
    ]
    for link in ending:
        state[link] = letter
    return "".join(state)


def _is_yellow(cycle: Sequence[NewPhase], place: int) -> bool:
    return bool(set(cycle[place].state) & set(YELLOW_LETTERS))


def _is_pause(cycle: Sequence[NewPhase], place: int) -> bool:
    """Whether a phase comes behind a yellow, without a yellow or a new green itself."""
    before = cycle[place - 1]
    after_yellow = _is_yellow(cycle, place - 1)
    return after_yellow and not _is_yellow(cycle, place) and not _begins(before, cycle[place])


def _longer_runs(
    name: str, cycle: list[NewPhase], chosen: Callable[[Sequence[NewPhase], int], bool],
    least_s: float, *, keep: bool,
) -> list[NewPhase]:  # fmt: skip
    """The last phase of each run of chosen ones is as long as makes the run ``least_s``."""
    found = list(cycle)
    for place in range(len(cycle)):
        if not chosen(cycle, place) or chosen(cycle, (place + 1) % len(cycle)):
            continue
        run_s, first = 0.0, place
        while chosen(cycle, first) and place - first < len(cycle):
            run_s += cycle[first].duration_s
            first -= 1
        lack = least_s - run_s
        if lack > 1e-9:
            found[place] = found[place].longer(lack)
            green = _green_before(found, place)
            found[green] = _shorter(name, found[green], lack, keep=keep)
    return found


def _green_before(cycle: Sequence[NewPhase], place: int) -> int:
    """The phase before a change from which it takes time: the nearest with green, no yellow."""
    for back in range(1, len(cycle) + 1):
        one = (place - back) % len(cycle)
        if set(cycle[one].state) & set(GREEN_LETTERS) and not _is_yellow(cycle, one):
            return one
    return place


def _shorter(name: str, phase: NewPhase, seconds: float, *, keep: bool) -> NewPhase:
    """A green that has given time. Raises UsageError where too little is left."""
    if not keep or phase.actuated:
        return phase
    left = phase.duration_s - seconds
    if left < LEAST_GREEN_S:
        raise UsageError(
            f"signal '{name}': its green of {phase.duration_s:g} s ({phase.state}) would leave"
            f" {left:g} s, and {LEAST_GREEN_S:g} s are the least; write 'cycle: longer', or less."
        )
    return phase.longer(-seconds)


def _protected(
    name: str, cycle: list[NewPhase], change: Change, lefts: Iterable[int], foes: Foes
) -> list[NewPhase]:
    """Permissive left turns are red while what they meet has green; they have their own green.

    Many programs have such a green behind or before the permissive one: that becomes long enough.
    """
    met = {one: [other for other in _links(cycle) if foes(one, other)] for one in lefts}
    met = {
        one: others for one, others in met.items()
        if any(_permissive(phase, one, others) for phase in cycle)
    }  # fmt: skip
    if not met:
        raise UsageError(
            f"signal '{name}': no left turn has green together with oncoming traffic, so none can"
            " be protected; leave protected_left_s out."
        )
    served = {
        one: others for one, others in met.items()
        if any(_alone(phase, one, others) for phase in cycle)
    }  # fmt: skip
    found = [
        replace(phase, state=_only_alone(cycle, place, served)) for place, phase in enumerate(cycle)
    ]
    for link, others in served.items():
        _lengthen_green(name, found, change, link, _giving(cycle, link, others))
    found = _cleared(name, found, list(served), change)
    return _put_in(name, found, change, met, foes)


def _permissive(phase: NewPhase, link: int, others: Sequence[int]) -> bool:
    """Whether a link gives way to others that have green."""
    return phase.state[link] == "g" and any(phase.green(other) for other in others)


def _alone(phase: NewPhase, link: int, others: Sequence[int]) -> bool:
    """Whether a link has a green in which it gives way to none of the others."""
    going = GREEN_LETTERS + YELLOW_LETTERS
    return phase.state[link] == "G" or (
        phase.green(link) and not any(phase.state[other] in going for other in others)
    )


def _giving(cycle: Sequence[NewPhase], link: int, others: Sequence[int]) -> int:
    """The longest permissive green of a link, which gives time to its own."""
    places = [at for at, phase in enumerate(cycle) if _permissive(phase, link, others)]
    return max(places, key=lambda at: cycle[at].duration_s)


def _only_alone(cycle: Sequence[NewPhase], place: int, served: Mapping[int, Sequence[int]]) -> str:
    """The state of a phase with links red where they give way; ``served``: what each meets."""
    state = list(cycle[place].state)
    for link, others in served.items():
        back = place  # a yellow belongs to the green before it
        while cycle[back].state[link] in YELLOW_LETTERS:
            back -= 1
        if cycle[back].green(link) and not _alone(cycle[back], link, others):
            state[link] = "r"
    return "".join(state)


def _lengthen_green(
    name: str, cycle: list[NewPhase], change: Change, link: int, giving: int
) -> None:
    """Make the longest green of a link as long as asked for, with time of another phase."""
    runs: list[list[int]] = [[]]
    for place, phase in enumerate(cycle):
        if phase.green(link):
            runs[-1].append(place)
        elif runs[-1]:
            runs.append([])
    if cycle[0].green(link) and cycle[-1].green(link) and len(runs) > 1:
        runs[0] = runs.pop() + runs[0]  # it goes on from the end of the cycle to its beginning
    longest_s, last = max((sum(cycle[at].least_s for at in run), run[-1]) for run in runs if run)
    lack_s = (change.protected_left_s or 0.0) - longest_s
    if lack_s > 1e-9:
        cycle[last] = cycle[last].longer(lack_s)
        cycle[giving] = _shorter(name, cycle[giving], lack_s, keep=change.cycle == "keep")


def _cleared(
    name: str, cycle: list[NewPhase], links: Sequence[int], change: Change
) -> list[NewPhase]:
    """Yellow and all-red behind each green of the links that ends where others go on."""
    found = list(cycle)
    put_in: dict[int, list[NewPhase]] = {}
    for place, phase in enumerate(cycle):
        after = (place + 1) % len(cycle)
        ending = [link for link in links if phase.green(link) and cycle[after].state[link] == "r"]
        if ending and set(cycle[after].state) & set(GREEN_LETTERS):
            put_in[place] = [
                NewPhase(_between(phase, cycle[after], ending, letter), seconds)
                for letter, seconds in _clearing(cycle, change)
            ]
            added_s = sum(one.duration_s for one in put_in[place])
            found[after] = _shorter(name, found[after], added_s, keep=change.cycle == "keep")
    return [one for place, phase in enumerate(found) for one in (phase, *put_in.get(place, ()))]


def _put_in(
    name: str, cycle: list[NewPhase], change: Change, met: Mapping[int, Sequence[int]], foes: Foes
) -> list[NewPhase]:
    """Left turns that still give way get a green of their own; ``met``: what each meets."""
    found: list[NewPhase] = []
    waiting: set[int] = set()
    giving: list[int] = []
    for place, phase in enumerate(cycle):
        permissive = {link for link, others in met.items() if _permissive(phase, link, others)}
        if permissive:
            giving.append(len(found))
        waiting |= permissive
        state = "".join("r" if link in waiting else one for link, one in enumerate(phase.state))
        found.append(replace(phase, state=state))
        if waiting and (_begins(phase, cycle[(place + 1) % len(cycle)]) or place == len(cycle) - 1):
            own = _own_green(name, cycle, sorted(waiting), change, foes)
            most = max(giving, key=lambda at: found[at].duration_s)
            added_s = sum(one.duration_s for one in own)
            found[most] = _shorter(name, found[most], added_s, keep=change.cycle == "keep")
            found += own
            waiting, giving = set(), []
    return found


def _own_green(
    name: str, cycle: Sequence[NewPhase], lefts: Sequence[int], change: Change, foes: Foes
) -> list[NewPhase]:
    """Green, yellow and all-red of left turns; the others are red."""
    for one in lefts:
        meets = [other for other in lefts if other != one and foes(one, other)]
        if meets:
            raise UsageError(
                f"signal '{name}': the left turns of links {one} and {meets[0]} meet, so they"
                " cannot have green together; give them phases in netedit."
            )
    rows = [("G", change.protected_left_s or 0.0), *_clearing(cycle, change)]
    return [
        NewPhase("".join(letter if link in lefts else "r" for link in _links(cycle)), seconds)
        for letter, seconds in rows
    ]


def _clearing(cycle: Sequence[NewPhase], change: Change) -> list[tuple[str, float]]:
    """Letters and times behind a green: those asked for, or else those of the program."""
    yellow_s = change.yellow_s or _usual_s(cycle, _is_yellow) or 3.0
    red_s = change.all_red_s or _usual_s(cycle, _is_pause)
    return [("y", yellow_s), ("r", red_s)] if red_s else [("y", yellow_s)]


def _usual_s(cycle: Sequence[NewPhase], chosen: Callable[[Sequence[NewPhase], int], bool]) -> float:
    """The longest of the chosen phases; 0 without one."""
    return max(
        (phase.duration_s for place, phase in enumerate(cycle) if chosen(cycle, place)), default=0.0
    )
