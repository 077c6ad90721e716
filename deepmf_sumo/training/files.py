"""Files that appear whole."""

import os
from pathlib import Path


def write(file: Path, content: bytes) -> None:
    """Write beside, flush to the disk, rename; creates folders. Raises OSError, leaving nothing.

    Two processes may write the same file: the last one stays.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    beside = file.with_name(f"{file.name}.{os.getpid()}")
    try:
        with beside.open("wb") as opened:
            opened.write(content)
            opened.flush()
            os.fsync(opened.fileno())
        beside.replace(file)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise
