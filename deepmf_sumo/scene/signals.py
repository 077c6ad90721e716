"""What the states of signals ask of vehicles, their colours, and SUMO's letters for them.

A flashing red is a stop sign: a vehicle stops, and then may go on. So it is red to see, but does
not forbid to pass.
"""

from collections.abc import Mapping
from typing import Final, Literal

from deepmf_sumo.scene.scene import SignalState

FORBIDS: Final = frozenset({SignalState.STOP, SignalState.ARROW_STOP})
"""No vehicle may pass."""
HALTS: Final = FORBIDS | {SignalState.CAUTION, SignalState.ARROW_CAUTION}
"""A vehicle that can still stop stops, and waits for green."""
STOP_FIRST: Final = frozenset({SignalState.FLASHING_STOP})
"""A vehicle stops, gives way, and goes on."""
GOES: Final = frozenset({SignalState.GO, SignalState.ARROW_GO})

Colour = Literal["red", "yellow", "green"]
_COLOUR: Final[Mapping[SignalState, Colour]] = {
    **dict.fromkeys(FORBIDS | STOP_FIRST, "red"),
    **dict.fromkeys((HALTS - FORBIDS) | {SignalState.FLASHING_CAUTION}, "yellow"),
    **dict.fromkeys(GOES, "green"),
}


def colour(state: SignalState) -> Colour | None:
    """Of the lamp, steady or flashing; None where no lamp is known."""
    return _COLOUR.get(state)


def steady(state: SignalState) -> Colour | None:
    """Of a lamp that does not flash; None for other states."""
    return _COLOUR.get(state) if state in HALTS | GOES else None


GREEN_LETTERS: Final = "Gg"
YELLOW_LETTERS: Final = "Yy"
STATE_OF: Final[Mapping[str, SignalState]] = {
    "r": SignalState.STOP,
    "s": SignalState.FLASHING_STOP,
    "u": SignalState.STOP,
    **dict.fromkeys(YELLOW_LETTERS, SignalState.CAUTION),
    **dict.fromkeys(GREEN_LETTERS, SignalState.GO),
    "o": SignalState.FLASHING_CAUTION,
    "O": SignalState.UNKNOWN,
}
"""By SUMO's letters."""
LETTER_OF: Final[Mapping[SignalState, str]] = {
    **dict.fromkeys(FORBIDS, "r"),
    **dict.fromkeys(HALTS - FORBIDS, "y"),
    **dict.fromkeys(GOES, "G"),
    # `o` is off and blinking: yield; `O` would end all right of way
    SignalState.UNKNOWN: "o",
    SignalState.FLASHING_STOP: "o",  # at SUMO's letter for it vehicles never go on
    SignalState.FLASHING_CAUTION: "o",
}
"""How SUMO shows a recorded state."""
