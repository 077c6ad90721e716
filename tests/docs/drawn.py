"""Which sources drew each picture of ``docs/pictures``: ``python -m tests.docs.drawn [--accept]``.

``drawn.json`` has a digest of these sources for each picture; ``make gallery`` writes it. Without
an option the command lists pictures whose sources have changed since. ``--accept`` writes the
digests of today for all pictures: only after a change that draws nothing otherwise. The figures of
``docs/figures`` are not among them: they need recordings.
"""

import hashlib
import json
import sys
from pathlib import Path

from tests.docs.pages import DOCS, ROOT

PICTURES = DOCS / "pictures"
KEPT = Path(__file__).with_name("drawn.json")
_REPORT = "deepmf_sumo/report"
_DRAWING = (f"{_REPORT}/drawing.py", f"{_REPORT}/palette.py")
_EPISODE = (*_DRAWING, f"{_REPORT}/figures/episode.py")
_PAGE = (f"{_REPORT}/page/**/*.*", f"{_REPORT}/palette.py", "tests/docs/browser.py")
SOURCES = {
    "finding.webp": (*_EPISODE, "tests/docs/front_page.py"),
    "risk_map.webp": (*_EPISODE, f"{_REPORT}/risk/sumo_files.py", "tests/docs/front_page.py"),
    "risk_page.webp": (*_PAGE, f"{_REPORT}/risk/folder.py", "tests/docs/front_page.py"),
    "report_page.webp": (*_PAGE, f"{_REPORT}/failures.py", "tests/docs/gallery.py"),
    "gallery": (*_DRAWING, f"{_REPORT}/picture.py", "tests/docs/gallery.py"),
}
"""Patterns below the repository's folder, by picture or folder of pictures."""


def digest(name: str) -> str:
    """Of the sources of a picture, as they are."""
    of = hashlib.sha256()
    for pattern in SOURCES[name]:
        files = sorted(file for file in ROOT.glob(pattern) if file.suffix != ".pyc")
        if not files:
            raise FileNotFoundError(pattern)
        for file in files:
            of.update(file.read_bytes())
    return of.hexdigest()[:16]


def kept() -> dict[str, str]:
    """Digests of the sources that drew the pictures."""
    return json.loads(KEPT.read_text("utf-8")) if KEPT.exists() else {}


def keep(*names: str) -> None:
    """These pictures were drawn by the sources as they are."""
    found = kept() | {name: digest(name) for name in names}
    KEPT.write_text(json.dumps(found, indent=2, sort_keys=True) + "\n", "utf-8")


def stale() -> list[str]:
    """Pictures that other sources drew."""
    return [name for name in SOURCES if kept().get(name) != digest(name)]


def main() -> int:
    """List what is stale, or accept it."""
    if sys.argv[1:] == ["--accept"]:
        keep(*SOURCES)
    print(*stale(), sep="\n")
    return bool(stale())


if __name__ == "__main__":
    sys.exit(main())
