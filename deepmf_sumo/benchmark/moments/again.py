"""The moments of another attack, so that two designs or two planners are compared in pairs."""

import csv
import io
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from deepmf_sumo import files
from deepmf_sumo.benchmark.moments.moment import VehicleTime
from deepmf_sumo.benchmark.moments.plan import TABLE
from deepmf_sumo.errors import UsageError
from deepmf_sumo.texts import of_cell

_LARGEST: Final = 2**26


def read(path: Path) -> tuple[VehicleTime, ...]:
    """Vehicles and times of a result folder of `attack`, or of its moments.csv; each once.

    Raises UsageError where there is no such table, or it holds none.
    """
    file = path / TABLE if path.is_dir() else path
    try:
        table = io.StringIO(files.text(file, _LARGEST), newline="")
        found = tuple(dict.fromkeys(_rows(csv.DictReader(table))))
    except OSError as error:
        raise UsageError(
            f"--moments-of {path}: {file} cannot be read ({files.reason(error)}); give a result"
            " folder of `deepmf-sumo attack`."
        ) from None
    except (KeyError, TypeError, ValueError, csv.Error):
        raise UsageError(
            f"--moments-of {path}: {file} is no table of moments (columns av and start_s)."
        ) from None
    if not found:
        raise UsageError(f"--moments-of {path}: {file} holds no moments.")
    return found


def _rows(table: Iterable[dict[str, str]]) -> Iterable[VehicleTime]:
    for row in table:
        start_s = float(row["start_s"])
        if not math.isfinite(start_s):
            raise ValueError(f"start_s {start_s}")
        yield of_cell(row["av"]), round(start_s, 1)
