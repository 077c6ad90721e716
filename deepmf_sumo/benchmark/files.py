"""Files that appear whole, with the same bytes for the same content."""

import gzip
import io
import json
import os
import zipfile
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

_LEAST_EFFORT: Final = 1


def write(path: Path, content: str | bytes) -> None:
    """Write beside, flush to the disk, rename."""
    beside = path.with_name(f".{path.name}.part")
    with beside.open("wb") as file:
        file.write(content.encode() if isinstance(content, str) else content)
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)


def write_json(path: Path, values: Any) -> None:
    """JSON with sorted keys. Raises ValueError for NaN, which JSON does not know."""
    text = json.dumps(values, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False)
    write(path, f"{text}\n")


def gzipped(text: str) -> bytes:
    """Without a time stamp and a file name."""
    return gzip.compress(text.encode(), compresslevel=6, mtime=0)


def npz(arrays: dict[str, NDArray[Any]]) -> bytes:
    """A compressed .npz with the time stamps of its members fixed; no objects."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            member = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            member.compress_type = zipfile.ZIP_DEFLATED
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asarray(array), allow_pickle=False)
            # More effort shrinks coordinates by little.
            archive.writestr(member, content.getvalue(), compresslevel=_LEAST_EFFORT)
    return buffer.getvalue()
