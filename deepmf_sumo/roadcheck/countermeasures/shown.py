"""What a changed signal shows in SUMO: controllers may ignore what a file says.

SUMO runs the changed configuration for four minutes and notes the signal's states. Each yellow,
and each time from the end of a yellow to the green of a way that meets it, must be as long as asked
for.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple
from xml.sax.saxutils import quoteattr

from deepmf_sumo.errors import ConversionError, SimulationError, UsageError
from deepmf_sumo.roadcheck.countermeasures.document import Change
from deepmf_sumo.roadcheck.countermeasures.signals import Foes
from deepmf_sumo.sumo.network import sumo_tools
from deepmf_sumo.sumo.simulation.sumo_config import Traffic, command_line, read_configuration

_SECONDS: Final = 240.0
_SLACK_S: Final = 0.11
"""A step of SUMO, and rounding."""
_STATES: Final = "signal-states.xml"
_GREEN, _YELLOW = "Gg", "yY"

State = tuple[float, str]
"""From when on a signal shows which letters."""


class Short(NamedTuple):
    """A time that is too short: which (``yellow``, ``all-red``), how long, of which link, when."""

    kind: str
    seconds: float
    link: int
    time_s: float


def check(config: Path, change: Change, foes: Foes) -> str:
    """A sentence on what SUMO shows of a changed signal.

    Raises UsageError where that is not what was asked for, SimulationError if SUMO cannot be run.
    """
    states = list(_states(config, change.signal or ""))
    wanted = {"yellow": change.yellow_s, "all-red": change.all_red_s}
    found = list(too_short(states, foes, wanted))
    if found:
        one = min(found, key=lambda short: short.time_s)
        raise UsageError(
            f"signal '{change.signal}': SUMO shows {one.seconds:.1f} s of {one.kind} at"
            f" {one.time_s:.1f} s (link {one.link}), and {wanted[one.kind]:g} s were asked for: its"
            " controller does not take the change; change it in netedit."
        )
    if len({state for _, state in states}) < 2:
        return f"signal '{change.signal}': it shows one state for {_SECONDS:g} s in SUMO"
    return f"signal '{change.signal}': SUMO shows what was asked for"


def too_short(
    states: Sequence[State], foes: Foes, wanted: dict[str, float | None]
) -> Iterator[Short]:
    """Times of yellow and of all-red that are below what is wanted."""
    if not states:
        return
    yellow_s, red_s = wanted.get("yellow"), wanted.get("all-red")
    ended: dict[int, float] = {}
    since: dict[int, float] = {}
    last = states[0][1]
    for time_s, state in states[1:]:
        for link, (old, new) in enumerate(zip(last, state, strict=True)):
            if old in _GREEN and new not in _GREEN:
                since[link] = time_s
            if new not in _YELLOW and new not in _GREEN and link in since:
                shown_s = time_s - since.pop(link)
                ended[link] = time_s
                if yellow_s is not None and shown_s < yellow_s - _SLACK_S:
                    yield Short("yellow", shown_s, link, time_s - shown_s)
        for link, (old, new) in enumerate(zip(last, state, strict=True)):
            if red_s is None or old in _GREEN or new not in _GREEN:
                continue
            for other, end_s in ended.items():
                if other != link and foes(link, other) and time_s - end_s < red_s - _SLACK_S:
                    yield Short("all-red", time_s - end_s, link, end_s)
        last = state


def _states(config: Path, signal: str) -> Iterable[State]:
    configuration = read_configuration(config)
    event = f'<timedEvent type="SaveTLSSwitchStates" source={quoteattr(signal)} dest="{_STATES}"/>'
    traffic = Traffic(configuration=configuration, seed=configuration.seed)
    with command_line(traffic, event) as (arguments, folder):
        end_s = configuration.begin_s + _SECONDS
        try:
            sumo_tools.run("sumo", *arguments, "--end", f"{end_s:g}", timeout_s=600.0)
        except ConversionError as error:
            raise SimulationError(f"SUMO cannot run '{config}': {error}") from None
        events = ET.parse(folder / _STATES).iter("tlsState")  # noqa: S314 - SUMO wrote it
        return [(float(one.get("time", "0")), one.get("state", "")) for one in events]
