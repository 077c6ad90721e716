"""Text of files that others wrote: ids and names, and what of them a terminal may be given."""

import re
from typing import Final

LONGEST_ID: Final = 256
"""Characters of an id or a name; the longest seen has 60."""

# Control characters and escape sequences, halves of surrogate pairs, what turns the direction of
# writing, and what XML does not allow.
_HIDDEN: Final = re.compile(
    "[\x00-\x1f\x7f-\x9f\ud800-\udfff\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufffe\uffff]"
)

_FORMULA: Final = re.compile("'*[=+@\t\r-]")
_REVERSE_EDGE: Final = re.compile(r"-\d+(#\d+)?(_\d+)?", re.ASCII)
"""Edges and lanes of the other direction, as netconvert names them in networks of OpenStreetMap."""


def is_plain(text: str) -> bool:
    """Whether nothing in the text acts on a terminal or breaks a file that it is written to."""
    return _HIDDEN.search(text) is None


def shown(text: str) -> str:
    """The text with `\N{REPLACEMENT CHARACTER}` for each character that is not plain."""
    return _HIDDEN.sub("\N{REPLACEMENT CHARACTER}", text)


def cell(text: str) -> str:
    """The text as a cell of a CSV table, in which no spreadsheet takes it for a formula.

    Numbers, ids such as ``-123#0``, and what cannot be a formula, stay as they are. `of_cell` gives
    the text back.
    """
    safe = not _FORMULA.match(text) or _REVERSE_EDGE.fullmatch(text) or _is_number(text)
    return text if safe else f"'{text}"


def of_cell(text: str) -> str:
    """The text that `cell` was given."""
    return text[1:] if text.startswith("'") and _FORMULA.match(text) else text


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


__all__ = ["LONGEST_ID", "cell", "is_plain", "of_cell", "shown"]
