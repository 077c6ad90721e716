"""Which faults a search may be built on, and which are held out until it is finished.

The faults in the order of the SHA-256 of their names: of every two the second is held out. The list
is frozen in `held_out.txt`: a name a line, then the digest of all faults and their halves.
"""

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import Final, Literal

from studies.planner_faults.faults import FAULTS

FROZEN: Final = Path(__file__).with_name("held_out.txt")
Half = Literal["open", "held out"]


def halves(names: Iterable[str]) -> dict[str, Half]:
    """The half of each name."""
    ordered = sorted(names, key=lambda name: hashlib.sha256(name.encode()).hexdigest())
    return {name: "held out" if place % 2 else "open" for place, name in enumerate(ordered)}


def digest(drawn: dict[str, Half]) -> str:
    """SHA-256 of all names with their halves, sorted."""
    lines = "".join(f"{name} {half}\n" for name, half in sorted(drawn.items()))
    return hashlib.sha256(lines.encode()).hexdigest()


def frozen_text() -> str:
    """What `held_out.txt` contains for the present faults."""
    drawn = halves(FAULTS)
    held = sorted(name for name, half in drawn.items() if half == "held out")
    return "".join(f"{name}\n" for name in held) + f"sha256 {digest(drawn)}\n"
