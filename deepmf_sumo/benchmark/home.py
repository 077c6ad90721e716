"""Where converted networks and indexes of recordings are kept between runs."""

import os
from pathlib import Path


def cache_folder() -> Path:
    """``$DEEPMF_SUMO_HOME/cache``, else ``~/.local/share/deepmf-sumo/cache``; may not exist yet."""
    data = Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share")
    return Path(os.environ.get("DEEPMF_SUMO_HOME") or data / "deepmf-sumo") / "cache"
