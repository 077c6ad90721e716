"""What is known of a command before a simulation: names, vehicles, times, earlier moments."""

import csv
import io
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

from deepmf_sumo import files
from deepmf_sumo.benchmark.moments.moment import VehicleTime, Wish
from deepmf_sumo.benchmark.moments.suitable import check_times
from deepmf_sumo.benchmark.stored import MOMENTS
from deepmf_sumo.benchmark.tasks import slug
from deepmf_sumo.errors import UsageError
from deepmf_sumo.simulation import demand
from deepmf_sumo.simulation.sumo_config import Configuration
from deepmf_sumo.texts import of_cell

_LARGEST: Final = 2**26


def names_of(configs: Sequence[Path]) -> list[str]:
    """What the runs of each configuration are called after: no two alike, even as file names.

    That is the file's name; where several have it, the folders that tell them apart. Raises
    UsageError where a configuration is given twice.
    """
    places = [config.resolve() for config in configs]
    for place, times in Counter(places).items():
        if times > 1:
            raise UsageError(f"{place} is given {times} times; give each configuration once.")
    names = [config.stem for config in configs]
    for depth in range(1, max((len(place.parts) for place in places), default=0)):
        taken = Counter(map(slug, names))
        if max(taken.values()) == 1:
            return names
        names = [
            name if taken[slug(name)] == 1 else _by_folder(place, depth)
            for name, place in zip(names, places, strict=True)
        ]
    return [" ".join(place.parts[1:]) for place in places]  # e.g. a.cfg and a.sumocfg in one folder


def _by_folder(place: Path, depth: int) -> str:
    return " ".join(place.parts[1:-1][-depth:]) or place.name


def check(configuration: Configuration, wish: Wish) -> None:
    """Raise UsageError for a vehicle, type or time that cannot be in a configuration's traffic.

    What only the simulation shows is left to it.
    """
    end_s = configuration.end_s
    check_times(wish, configuration.begin_s, math.inf if end_s is None else end_s)
    if wish.av is None and wish.av_type is None:
        return
    known = demand.read(configuration)
    if known is None:
        return
    place = f"in the demand of {configuration.file}"
    if wish.av is not None and not known.has_vehicle(wish.av):
        there = ", ".join(known.like_vehicle(wish.av)) or "none"
        raise UsageError(f"--av {wish.av}: no such vehicle is {place}; there are {there}.")
    if wish.av_type is not None and not known.has_type(wish.av_type):
        there = ", ".join(known.like_type(wish.av_type)) or "none"
        raise UsageError(f"--av-type {wish.av_type}: no such type is {place}; there are {there}.")


__all__ = ["check", "names_of"]


def read(path: Path) -> tuple[VehicleTime, ...]:
    """Vehicles and times of a result folder of `attack`, or of its moments.csv; each once.

    Raises UsageError where there is no such table, or it holds none.
    """
    file = path / MOMENTS if path.is_dir() else path
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
