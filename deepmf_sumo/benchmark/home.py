"""Where converted networks and indexes of recordings are kept between runs."""

import os
from pathlib import Path

from platformdirs import user_data_path


def cache_folder() -> Path:
    """``$DEEPMF_SUMO_HOME/cache``, else ``cache`` in the user's data folder; may not exist yet.

    On Linux that is ``~/.local/share/deepmf-sumo/cache``, or in ``$XDG_DATA_HOME``.
    """
    home = os.environ.get("DEEPMF_SUMO_HOME")
    return (Path(home) if home else user_data_path("deepmf-sumo", appauthor=False)) / "cache"
