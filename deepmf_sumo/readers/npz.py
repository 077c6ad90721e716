"""The native format: one scene in one .npz file, without pickled objects; it loses nothing."""

import io
import math
import os
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepmf_sumo import files
from deepmf_sumo.datatypes import Scene
from deepmf_sumo.errors import ReaderError
from deepmf_sumo.readers import checks, native
from deepmf_sumo.readers.base import Refusal

LARGEST_FILE: Final = 2**27
"""Bytes that a file may unpack to. The largest scene seen has 8 MB."""

_NAME = "npz"
_DAMAGES: Final = (
    *(OSError, EOFError, ValueError, KeyError, RuntimeError, struct.error),
    *(zlib.error, zipfile.BadZipFile),
)
"""What damaged archives and arrays raise; NotImplementedError is a RuntimeError."""


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
    """Whether the file is a zip archive with a scene's description, or named as a native file."""
    try:
        with files.opened(path) as file:
            if file.read(4) != b"PK\x03\x04":
                return False
            with zipfile.ZipFile(file) as archive:
                return {"format_version.npy", "description.npy"} <= set(archive.namelist())
    except Exception:  # noqa: BLE001 - a damaged archive can raise anything
        return path.suffix == ".npz"


def scenes(path: Path) -> Iterator[Scene | Refusal]:
    """The file's one scene, as it was written (its source is the original recording)."""
    try:
        yield _scene(path)
    except ReaderError as error:
        yield Refusal(file=str(path), record=0, name=path.stem, reason=str(error), dataset=_NAME)


def _scene(path: Path) -> Scene:
    try:
        arrays = _arrays(path)
    except _DAMAGES as error:
        why = files.reason(error) if isinstance(error, OSError) else str(error)
        raise ReaderError(
            f"{path} is damaged ({why}); write it again from the recording."
        ) from None
    version = arrays["format_version"]
    if version.tolist() != native.FORMAT_VERSION:
        raise ReaderError(
            f"{path} is of format version {str(version)[:40]}; this program reads "
            f"{native.FORMAT_VERSION}. Write it again from the recording."
        )
    try:
        return checks.confirmed(native.from_arrays(arrays))
    except ReaderError as error:
        raise ReaderError(f"{path} is not a scene: {error}.") from None


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """All arrays. Raises ReaderError where they are too large, and any of `_DAMAGES`."""
    with files.opened(path) as file, zipfile.ZipFile(file) as archive:
        size = sum(member.file_size for member in archive.infolist())
        if size > LARGEST_FILE:
            raise ReaderError(
                f"{path} unpacks to {size} bytes, more than the {LARGEST_FILE} allowed."
            )
        return {name: _array(archive, f"{name}.npy") for name in native.NAMES}


def _array(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """One array, whose items are as many as it says."""
    if archive.getinfo(name).compress_type not in {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}:
        raise ValueError(f"{name} is packed in another way than with deflate")
    content = io.BytesIO(archive.read(name))
    try:
        version = np.lib.format.read_magic(content)
        shape, _, dtype = np.lib.format.read_array_header_1_0(content)
    except Exception as error:  # noqa: BLE001 - numpy reads the header as Python text
        raise ValueError(f"the header of {name} cannot be read: {error}") from None
    if version != (1, 0):
        raise ValueError(f"{name} is of npy version {version}")
    needed = math.prod(shape) * dtype.itemsize
    there = len(content.getbuffer()) - content.tell()
    if dtype.hasobject or min(shape, default=0) < 0 or needed != there:
        raise ValueError(f"{name} says {dtype} of shape {shape}, but has {there} bytes")
    content.seek(0)
    array: np.ndarray = np.lib.format.read_array(content, allow_pickle=False)
    return array
