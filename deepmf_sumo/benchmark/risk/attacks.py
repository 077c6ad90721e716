"""Result folders -> the networks in them, each with the attacks on it."""

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from deepmf_sumo.benchmark import stored
from deepmf_sumo.benchmark.result import Result, attacked
from deepmf_sumo.benchmark.results import planned
from deepmf_sumo.benchmark.risk import places
from deepmf_sumo.benchmark.risk.attacked import Attacked, of_run
from deepmf_sumo.benchmark.risk.places import Places
from deepmf_sumo.datatypes import RoadMap
from deepmf_sumo.errors import UsageError
from deepmf_sumo.network.sumo_road import road_of_net


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
    once = {out.resolve(): out for folder in folders for out in stored.result_folders(folder)}
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


def _read(out: Path, networks: dict[tuple[str, str], _Filling], left_out: Counter[str]) -> None:
    moments = stored.moments_of(out)
    for run_id, result in planned(out).items():
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
        for run_id, result in planned(out).items()
        if result is not None and result["status"] == "ok"
    }


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
    file = stored.net_file(folder)
    if file is None:
        raise UsageError(f"{folder / 'sumo'} holds no net.net.xml; run it anew.")
    return file


__all__ = ["Attacked", "Network", "net_digest", "of_runs", "read"]
