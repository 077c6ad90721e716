"""The native format: one scene in one .npz file, without pickled objects; it loses nothing."""

import os
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepmf_sumo.datatypes import Scene
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.readers import checks, native
from deepmf_sumo.readers.base import Refusal

LARGEST_FILE: Final = 2**30
"""Bytes that a file may unpack to. The largest scene seen has 8 MB."""

_NAME = "npz"


def write(scene: Scene, path: Path) -> None:
    """Write a scene; the file appears whole or not at all. Raises OSError."""
    arrays: dict[str, Any] = native.to_arrays(scene)
    with tempfile.NamedTemporaryFile(
        dir=path.parent, prefix=f".{path.name}", suffix=".part", delete=False
    ) as file:
        part = Path(file.name)
        try:
            np.savez_compressed(file, **arrays)
            file.flush()
            os.fsync(file.fileno())
        except BaseException:
            part.unlink()
            raise
    part.chmod(0o644)
    part.replace(path)


def accepts(path: Path) -> bool:
    """Whether the file is a zip archive with a scene's description."""
    try:
        with path.open("rb") as file:
            if file.read(4) != b"PK\x03\x04":
                return False
        with zipfile.ZipFile(path) as archive:
            return {"format_version.npy", "description.npy"} <= set(archive.namelist())
    except Exception:  # noqa: BLE001 - a damaged archive can raise anything
        return path.suffix == ".npz"


def scenes(path: Path) -> Iterator[Scene | Refusal]:
    """The file's one scene, as it was written (its source is the original recording)."""
    try:
        yield checks.confirmed(_scene(path))
    except ReaderError as error:
        yield Refusal(file=str(path), record=0, name=path.stem, reason=str(error), dataset=_NAME)


def _scene(path: Path) -> Scene:
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > LARGEST_FILE:
            raise ReaderError(f"{path} unpacks to {size} bytes, more than a scene can have.")
        with np.load(path, allow_pickle=False) as arrays:
            version = int(arrays["format_version"])
            if version != native.FORMAT_VERSION:
                raise ReaderError(
                    f"{path} is of format version {version}; this program reads "
                    f"{native.FORMAT_VERSION}. Write it again from the recording."
                )
            return native.from_arrays(arrays)
    except ReaderError:
        raise
    except Exception as error:  # noqa: BLE001 - so can damaged arrays
        raise ReaderError(
            f"{path} is damaged ({type(error).__name__}: {error}); write it again from the "
            "recording."
        ) from None
