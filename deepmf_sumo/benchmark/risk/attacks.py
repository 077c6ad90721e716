"""Result folders -> attacks on the AV and where on the network each was decided.

An attack was *decided* where the AV's centre was when it touched the opponent (else anybody else),
or, without a contact, when the gap to the opponent was least. It *began* where the AV was when the
attack took over; the movement that it began before is the next one on the AV's way. Where opponents
attack in turn, each turn is an attack.
"""

import csv
import hashlib
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from deepmf_sumo.benchmark.result import Result
from deepmf_sumo.benchmark.risk import driven, places
from deepmf_sumo.benchmark.risk.driven import Driven
from deepmf_sumo.benchmark.risk.places import Places, Spot
from deepmf_sumo.benchmark.risk.spots import Spots
from deepmf_sumo.benchmark.study.columns import attacked
from deepmf_sumo.datatypes import DT_S, Floats, RoadMap
from deepmf_sumo.errors import UsageError
from deepmf_sumo.network.sumo_road import road_of_net

Row = Mapping[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Attacked:
    """One attack.

    Attributes:
        folder: result folder that it stands in, as given.
        turn: number of the turn in its run; None where one opponent attacked all the time.
        decided, began: where; an empty spot where the AV was on no lane and in no junction.
        place_m: (2,) of the AV's centre when it was decided.
        against: where the opponent was then.
        hit: the opponent touched the AV. other: the AV touched somebody else.
        avoidable: whether a reference driver would have avoided the hit; None without one.
        ttc_s: least; None off a collision course. gap_m: least. delta_v_mps: of the hit.
    """

    folder: str
    run_id: str
    turn: int | None
    scene: str
    seed: int
    decided: Spot
    began: Spot
    place_m: tuple[float, float]
    hit: bool
    other: bool
    avoidable: bool | None
    ttc_s: float | None
    gap_m: float | None
    delta_v_mps: float | None
    against: Spot = Spot()


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


class _Part(NamedTuple):
    """An attack of a run: by whom, from which step to which after the start, and its metrics."""

    opponent: str
    first: int
    last: int
    metrics: Mapping[str, float | None]
    turn: int | None = None


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

    A folder may hold result folders instead, e.g. one a seed. Runs that went wrong or attacked
    nobody are counted under ``left_out``, those on recorded scenes with the first network.

    Raises UsageError where there is no result folder, or no attack on a SUMO network in them.
    """
    networks: dict[tuple[str, str], _Filling] = {}
    left_out: Counter[str] = Counter()
    for folder in folders:
        for out in result_folders(folder):
            _read(out, networks, left_out)
    found = [networks[key] for key in sorted(networks)]
    if not found:
        why = ", ".join(f"{count} {reason}" for reason, count in left_out.items())
        named = " ".join(map(str, folders))
        raise UsageError(
            f"{named}: nobody was attacked on a SUMO network ({why or 'no runs'}), so there is no"
            " risk to map."
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
            left_out["missing"] += 1
        elif result["status"] != "ok":
            left_out[result["status"]] += 1
        elif not result.get("network"):
            left_out["on recorded scenes"] += 1
        elif not attacked(result):
            left_out["with nobody to attack"] += 1
        else:
            folder = out / "runs" / run_id
            network = _network(folder, str(result["network"]), networks)
            try:
                network.attacks += _attacks(out, folder, result, moments.get(run_id, {}), network)
            except UsageError:
                network.left_out["without readable tracks"] += 1


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
    keys = _json(out / "manifest.json").get("runs")
    if not isinstance(keys, dict):
        raise UsageError(f"{out / 'manifest.json'} names no runs: it is damaged; run it anew.")
    for run_id, key in keys.items():
        file = out / "runs" / run_id / "result.json"
        result = _json(file) if file.is_file() else None
        if result is not None and result.get("key") != key:  # of an earlier batch
            result = None
        if result is None or result.get("part", "main") == "main":
            found[run_id] = result
    return found


def _json(file: Path) -> dict[str, Any]:
    try:
        values: dict[str, Any] = json.loads(file.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"{file} cannot be read ({error}); run it anew.") from None
    return values


def _moments(out: Path) -> dict[str, Row]:
    """Where each AV was and went, by run; empty where no moments were chosen."""
    file = out / "moments.csv"
    if not file.is_file():
        return {}
    with file.open(newline="", encoding="utf-8") as lines:
        return {row["run_id"]: row for row in csv.DictReader(lines)}


def _network(folder: Path, name: str, networks: dict[tuple[str, str], _Filling]) -> _Filling:
    """The network of a run, told from others by its content."""
    files = sorted((folder / "sumo").glob("net.net.xml*"))
    if not files:
        raise UsageError(f"{folder / 'sumo'} holds no net.net.xml; run it anew.")
    key = name, hashlib.sha256(files[0].read_bytes()).hexdigest()
    if key not in networks:
        networks[key] = _Filling(
            name=name,
            net_file=files[0],
            places=places.read(files[0]),
            road=road_of_net(files[0]),
            attacks=[],
            left_out=Counter(),
        )
    return networks[key]


def _attacks(
    out: Path, folder: Path, result: Result, moment: Row, network: _Filling
) -> list[Attacked]:
    """The attacks of a run: one, or one a turn where opponents attacked in turn."""
    parts = _parts(result)
    tracks = driven.read(folder / "tracks.csv.gz", [part.opponent for part in parts])
    spots = Spots(tracks, tracks.lanes(network.road), network.places, moment)
    attacks = []
    for part in parts:
        there = part.opponent in tracks.ids
        lanes = tracks.lanes(network.road, part.opponent) if there else ()
        opponent = Spots(tracks, lanes, network.places, {}, part.opponent) if there else None
        attacks.append(_attacked(out, result, part, tracks, spots, opponent))
    return attacks


def _parts(result: Result) -> list[_Part]:
    turns: list[dict[str, Any]] | None = result.get("turns")
    if turns is None:
        values = {name: one["value"] for name, one in result["metrics"].items()}
        return [_Part(str(result["opponent"]), 0, result["steps"], values)]
    return [
        _Part(
            one["opponent"],
            round(one["begin_s"] / DT_S),
            round(one["end_s"] / DT_S),
            one["metrics"],
            number,
        )
        for number, one in enumerate(turns, start=1)
    ]


def _attacked(out: Path, result: Result, part: _Part, tracks: Driven, spots: Spots) -> Attacked:
    last = min(tracks.now + part.last, tracks.valid.shape[1] - 1)
    first = min(tracks.now + part.first, last)
    touched = {
        kind: [
            one["step"]
            for one in result["contacts"]
            if one["kind"] == kind
            and first <= one["step"] <= last
            and (kind == "av_other" or part.opponent in {one["first_id"], one["second_id"]})
        ]
        for kind in ("av_opponent", "av_other")
    }
    nearest = tracks.nearest_step(part.opponent, first, last)
    # of the opponent, else of another, else when the gap was least, else at the start
    step = int((touched["av_opponent"] + touched["av_other"] + [nearest or first])[0])
    place_m: Floats = tracks.position_m[0, step]
    hit, avoidable = bool(touched["av_opponent"]), part.metrics.get("avoidable")
    return Attacked(
        folder=str(out),
        run_id=result["run_id"],
        turn=part.turn,
        scene=result["scene"],
        seed=result["seed"],
        decided=spots.at(step),
        began=spots.began(first),
        place_m=(float(place_m[0]), float(place_m[1])),
        hit=hit,
        other=bool(touched["av_other"]),
        avoidable=avoidable >= 1 if hit and avoidable is not None else None,
        ttc_s=part.metrics.get("ttc_min"),
        gap_m=part.metrics.get("min_gap"),
        delta_v_mps=part.metrics.get("delta_v"),
        against=opponent.at(step) if opponent else Spot(),
    )


__all__ = ["Attacked", "Network", "of_runs", "read", "result_folders", "results"]
