"""Result folders -> the networks in them, each with the attacks on it."""

import csv
import hashlib
import io
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from deepmf_sumo import files
from deepmf_sumo.benchmark import stored
from deepmf_sumo.benchmark.result import Result, attacked
from deepmf_sumo.benchmark.risk import places
from deepmf_sumo.benchmark.risk.attacked import Attacked, of_run
from deepmf_sumo.benchmark.risk.places import Places
from deepmf_sumo.datatypes import RoadMap
from deepmf_sumo.errors import UsageError
from deepmf_sumo.network.sumo_road import road_of_net
from deepmf_sumo.texts import of_cell

Row = Mapping[str, str]

_LARGEST: Final = 2**26


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Network:
    """A network and the attacks on it.

    Attributes:
        name: of the .sumocfg, without suffix. net_file: a copy in one of the runs' folders.
        left_out: runs that are not counted, by reason.
    """

    name: str
    net_file: Path
    places: Places
    attacks: tuple[Attacked, ...]
    left_out: Mapping[str, int]


@dataclass(slots=True, eq=False)
class _Filling:
    """A network whose attacks are being read."""

    name: str
    net_file: Path
    places: Places
    road: RoadMap
    attacks: list[Attacked]
    left_out: Counter[str]


def read(folders: Sequence[Path]) -> list[Network]:
    """The networks of result folders, each with its attacks; by name, then by content.

    A folder may hold result folders instead, e.g. one a seed; one that is named twice counts once.
    Runs that went wrong or attacked nobody are counted under ``left_out``, those on recorded scenes
    or on networks without any attack that can be read with the first network.

    Raises UsageError where there is no result folder, or no attack on a SUMO network in them.
    """
    networks: dict[tuple[str, str], _Filling] = {}
    left_out: Counter[str] = Counter()
    once = {out.resolve(): out for folder in folders for out in result_folders(folder)}
    for out in once.values():
        _read(out, networks, left_out)
    found = [networks[key] for key in sorted(networks) if networks[key].attacks]
    for one in networks.values():
        if not one.attacks:
            left_out.update(one.left_out)
    if not found:
        why = ", ".join(f"{count} {reason}" for reason, count in left_out.items())
        named = " ".join(map(str, folders))
        raise UsageError(
            f"{named}: no vehicle was attacked on a SUMO network ({why or 'no runs'}), so there is"
            " no risk to map."
        )
    found[0].left_out.update(left_out)
    return [
        Network(
            name=one.name,
            net_file=one.net_file,
            places=one.places,
            attacks=tuple(one.attacks),
            left_out=dict(one.left_out),
        )
        for one in found
    ]


def result_folders(folder: Path) -> list[Path]:
    """The folder itself, or those in it that are result folders, by name.

    Raises UsageError where there is none.
    """
    if (folder / "manifest.json").is_file():
        return [folder]
    inside = sorted(file.parent for file in folder.glob("*/manifest.json"))
    if not inside:
        raise UsageError(
            f"{folder} is no result folder, and holds none: there is no manifest.json; give the"
            " --out of run, attack or benchmark."
        )
    return inside


def _read(out: Path, networks: dict[tuple[str, str], _Filling], left_out: Counter[str]) -> None:
    moments = _moments(out)
    for run_id, result in results(out).items():
        if result is None:
            left_out["without a result"] += 1
        elif result["status"] != "ok":
            left_out[result["status"]] += 1
        elif not result.get("network"):
            left_out["on recorded scenes"] += 1
        elif not attacked(result):
            left_out["with no vehicle to attack"] += 1
        else:
            network = _network(out / "runs" / run_id, str(result["network"]), networks)
            moment = moments.get(run_id, {})
            try:
                network.attacks += of_run(out, result, moment, network.places, network.road)
            except UsageError:
                network.left_out["without readable tracks"] += 1
            except (KeyError, TypeError) as error:
                raise UsageError(
                    f"{out / 'runs' / run_id / 'result.json'} is no result of this version of"
                    f" deepmf-sumo ({type(error).__name__}: {error}); run it anew."
                ) from None


def of_runs(folders: Sequence[Path]) -> dict[str, Result]:
    """The results of runs that went through, by ``OUT/runs/RUN``."""
    return {
        f"{out}/runs/{run_id}": result
        for out in folders
        for run_id, result in results(out).items()
        if result is not None and result["status"] == "ok"
    }


def results(out: Path) -> dict[str, Result | None]:
    """The result of each run of a folder's manifest, those of other budgets left out.

    None for a run that is not there yet. Raises UsageError where a file cannot be read.
    """
    found: dict[str, Result | None] = {}
    for run_id, key in stored.keys_of(out).items():
        file = out / "runs" / run_id / "result.json"
        result = stored.result_of(file) if file.is_file() else None
        if result is not None and result.get("key") != key:  # of an earlier batch
            result = None
        if result is None or result.get("part", "main") == "main":
            found[run_id] = result
    return found


def _moments(out: Path) -> dict[str, Row]:
    """Where each AV was and went, by run; empty where no moments were chosen."""
    file = out / "moments.csv"
    if not file.is_file():
        return {}
    try:
        lines = io.StringIO(files.text(file, _LARGEST), newline="")
        return {
            row["run_id"]: {name: of_cell(text) for name, text in row.items()}
            for row in csv.DictReader(lines)
        }
    except (OSError, KeyError, ValueError, TypeError, AttributeError, csv.Error):
        raise UsageError(
            f"{file} is no table of moments (column run_id); run it anew, or remove it: places"
            " then come from the tracks alone."
        ) from None


def _network(folder: Path, name: str, networks: dict[tuple[str, str], _Filling]) -> _Filling:
    """The network of a run, told from others by its content."""
    key = name, net_digest(folder)
    if key not in networks:
        file = _net_file(folder)
        networks[key] = _Filling(
            name=name,
            net_file=file,
            places=places.read(file),
            road=road_of_net(file),
            attacks=[],
            left_out=Counter(),
        )
    return networks[key]


def net_digest(folder: Path) -> str:
    """Of the network in a run's folder. Raises UsageError where there is none."""
    return hashlib.sha256(_net_file(folder).read_bytes()).hexdigest()


def _net_file(folder: Path) -> Path:
    nets = sorted((folder / "sumo").glob("net.net.xml*"))
    if not nets:
        raise UsageError(f"{folder / 'sumo'} holds no net.net.xml; run it anew.")
    return nets[0]


__all__ = ["Attacked", "Network", "net_digest", "of_runs", "read", "result_folders", "results"]
