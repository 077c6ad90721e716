"""Ways to change an input; every choice comes from the generator that is given."""

import math
import random
import string
from pathlib import Path
from typing import Any

NUMBERS = (0, 1, -1, 7, 2**31 - 1, -(2**31), 2**63, 10**400, 1e308, -0.0, math.inf, math.nan, 1e-9)
TEXTS = (
    *("", "x", "0", "-1", "nan", "\x00", "\ud800x", "a\x1b[2J", "[/x]", "[red]", "../../../x"),
    *("/dev/zero", "=1+1", "<script>", "'", '"', "\u202ex", "a" * 5000, "\n", "{{x}}", "%s"),
)
VALUES = (*NUMBERS, *TEXTS, None, True, False, [], {}, [[]], {"a": {}}, [0], ["x"], {"0": 0})
_PIECES = (
    b"\x00",
    b"\xff" * 8,
    b"[" * 50,
    b"{",
    b"9" * 30,
    b"\x1b[2J",
    b"..",
    b"\x80",
    b'"',
    b"NaN",
)


def damage(rng: random.Random, content: bytes, most: int = 4) -> bytes:
    """Bytes changed, dropped, doubled, moved, put in, or cut off."""
    data = bytearray(content)
    for _ in range(rng.randint(1, most)):
        at = rng.randrange(len(data) + 1)
        span = min(rng.choice((1, 1, 2, 4, 8, 64, 1024)), len(data) - at)
        match rng.randrange(7):
            case 0 | 1:
                for place in range(at, at + span):
                    data[place] ^= 1 << rng.randrange(8)
            case 2:
                del data[at : at + span]
            case 3:
                data[at:at] = data[at : at + span] * rng.randint(1, 8)
            case 4:
                data[at:at] = rng.choice(_PIECES)
            case 5:
                data[at : at + span] = rng.randbytes(span)
            case _ if rng.random() < 0.2:
                del data[at:]
    return bytes(data)


def bent(rng: random.Random, tree: Any, most: int = 3) -> Any:
    """Plain containers with some of their parts replaced, dropped, doubled or renamed, in place."""
    for _ in range(rng.randint(1, most)):
        spots = list(_spots(tree))
        if not spots:
            return rng.choice(VALUES)
        # A part at any depth, as likely as one of another depth: leaves are many.
        depth = rng.choice(sorted({deep for deep, _, _ in spots}))
        _, holder, key = rng.choice([spot for spot in spots if spot[0] == depth])
        _bend(rng, holder, key)
    return tree


def file(rng: random.Random, path: Path) -> None:
    """The bytes of a file damaged."""
    path.write_bytes(damage(rng, path.read_bytes()))


def any_file(rng: random.Random, folder: Path) -> None:
    """One file of a folder damaged or taken away."""
    path = rng.choice(sorted(one for one in folder.rglob("*") if one.is_file()))
    if rng.random() < 0.1:
        path.unlink()
    else:
        file(rng, path)


def _spots(tree: Any, deep: int = 0) -> Any:
    items = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, value in list(items):
        yield deep, tree, key
        if isinstance(value, dict | list):
            yield from _spots(value, deep + 1)


def _bend(rng: random.Random, holder: Any, key: Any) -> None:
    match rng.randrange(6):
        case 0:
            del holder[key]
        case 1 if isinstance(holder, list):
            holder.insert(key, holder[key])
        case 1:
            holder["".join(rng.choices(string.printable, k=3))] = holder.pop(key)
        case 2 if isinstance(holder[key], int | float) and not isinstance(holder[key], bool):
            holder[key] = rng.choice(NUMBERS)
        case 2 if isinstance(holder[key], str):
            holder[key] = rng.choice(TEXTS)
        case 3:
            holder[key] = [holder[key]]
        case _:
            holder[key] = rng.choice(VALUES)
