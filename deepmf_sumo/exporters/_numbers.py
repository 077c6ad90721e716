"""Numbers for ids, in formats that know no others."""

from collections.abc import Iterable
from typing import Final, Literal

_MOST: Final = 2**31 - 1
"""Largest number of a track in WOMD."""
Sort = Literal["track", "lane", "line", "edge", "polygon", "stop_sign"]


class Numbers:
    """A number for each id: its own where it is one and free, else the least free one.

    No two of the given ids have the same number, of whatever sort they are.
    """

    def __init__(self, ids: Iterable[tuple[Sort, str]]) -> None:
        self.of: dict[tuple[Sort, str], int] = {}
        listed = list(dict.fromkeys(ids))
        taken: set[int] = set()
        for key in listed:
            number = _own_number(key[1])
            if number is not None and number not in taken:
                self.of[key] = number
                taken.add(number)
        free = (number for number in range(1, _MOST) if number not in taken)
        self.of |= {key: next(free) for key in listed if key not in self.of}

    def __call__(self, sort: Sort, name: str) -> int:
        return self.of[sort, name]

    def known(self, sort: Sort, names: Iterable[str]) -> list[int]:
        """The numbers of those that there are."""
        return [self.of[sort, name] for name in names if (sort, name) in self.of]


def _own_number(name: str) -> int | None:
    """The number that an id is written as, in the one way that numbers are written."""
    number = int(name) if name.isascii() and name.isdecimal() and len(name) <= 10 else -1
    return number if 0 <= number <= _MOST and str(number) == name else None
