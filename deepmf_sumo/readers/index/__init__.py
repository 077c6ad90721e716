"""Where scenes lie in a file, kept in a cache folder so that a scene is found without a search."""

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Final

from deepmf_sumo.readers.base import Place

FORMAT_VERSION: Final = 2


def cached(path: Path, cache: Path | None, look: Callable[[], Iterable[Place]]) -> list[Place]:
    """The places of the file's scenes: from the cache, or by looking, and then cached.

    The entry belongs to the file's path, size and time of change, so that a changed file is
    looked at again. A damaged entry is written anew.
    """
    if cache is None:
        return list(look())
    entry = cache / "index" / f"{_key(path)}.json"
    places = _read(entry)
    if places is None:
        places = list(look())
        _write(entry, places)
    return places


def _key(path: Path) -> str:
    state = path.stat()
    text = f"{FORMAT_VERSION}|{path.resolve()}|{state.st_size}|{state.st_mtime_ns}"
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _read(entry: Path) -> list[Place] | None:
    try:
        content = json.loads(entry.read_text(encoding="utf-8"))
        return [
            Place(name=str(one["name"]), record=int(one["record"]), offset=int(one["offset"]))
            for one in content["places"]
        ]
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _write(entry: Path, places: list[Place]) -> None:
    entry.parent.mkdir(parents=True, exist_ok=True)
    content = {"format_version": FORMAT_VERSION, "places": [asdict(place) for place in places]}
    with tempfile.NamedTemporaryFile(
        "w", dir=entry.parent, prefix=entry.name, suffix=".part", delete=False, encoding="utf-8"
    ) as file:
        json.dump(content, file)
    os.replace(file.name, entry)  # noqa: PTH105 - `file.name` is text
