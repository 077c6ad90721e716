"""A run -> the attacks in it: where each was decided and began, and how it went.

An attack was *decided* where the AV's centre was when it touched the opponent (else anybody else),
or, without a contact, when the gap to the opponent was least. It *began* where the AV was when the
attack took over; the movement that it began before is the next one on the AV's way. Where opponents
attack in turn, each turn is an attack.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

from deepmf_sumo.benchmark.result import Result
from deepmf_sumo.benchmark.risk import driven
from deepmf_sumo.benchmark.risk.criticality import criticality
from deepmf_sumo.benchmark.risk.driven import Driven
from deepmf_sumo.benchmark.risk.places import Places, Spot
from deepmf_sumo.benchmark.risk.spots import OFF, Spots
from deepmf_sumo.datatypes import DT_S, Floats, RoadMap

_SPARE: Final = "time_to_spare"


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
        criticality: see there; None in results of versions that did not measure it.
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
    against: Spot = OFF
    criticality: float | None = None


class _Part(NamedTuple):
    """An attack of a run: by whom, from which step to which after the start, and its metrics."""

    opponent: str
    first: int
    last: int
    metrics: Mapping[str, float | None]
    turn: int | None = None


def of_run(
    out: Path, result: Result, moment: Mapping[str, str], every: Places, road: RoadMap
) -> list[Attacked]:
    """The attacks of a run: one, or one a turn where opponents attacked in turn.

    Args:
        out: the result folder.
        result: of a run in which somebody was attacked.
        moment: the run's row of ``moments.csv``, or empty.
        every: places of its network.
        road: map of its network.

    Raises UsageError where its tracks are missing or damaged.
    """
    parts = _parts(result)
    file = out / "runs" / result["run_id"] / "tracks.csv.gz"
    tracks = driven.read(file, [part.opponent for part in parts])
    av = Spots(tracks, tracks.lanes(road), every, moment)
    # those that left before the attack began have no tracks
    there = [part.opponent for part in parts if part.opponent in tracks.ids]
    opponents = {one: Spots(tracks, tracks.lanes(road, one), every, {}, one) for one in there}
    return [
        _attacked(str(out), result, part, tracks, av, opponents.get(part.opponent))
        for part in parts
    ]


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


def _attacked(
    folder: str,
    result: Result,
    part: _Part,
    tracks: Driven,
    spots: Spots,
    opponent: Spots | None,
) -> Attacked:
    last = min(tracks.now + part.last, tracks.valid.shape[1] - 1)
    first = min(tracks.now + part.first, last)
    hits = _contacts(result, "av_opponent", first, last, part.opponent)
    others = _contacts(result, "av_other", first, last)
    nearest = tracks.nearest_step(part.opponent, first, last)
    # of the opponent, else of another, else when the gap was least, else at the start
    step = next(iter((*hits, *others, first if nearest is None else nearest)))
    place_m: Floats = tracks.position_m[0, step]
    avoidable = part.metrics.get("avoidable")
    return Attacked(
        folder=folder,
        run_id=result["run_id"],
        turn=part.turn,
        scene=result["scene"],
        seed=result["seed"],
        decided=spots.at(step),
        began=spots.began(first),
        place_m=(float(place_m[0]), float(place_m[1])),
        hit=bool(hits),
        other=bool(others),
        avoidable=avoidable >= 1 if hits and avoidable is not None else None,
        ttc_s=part.metrics.get("ttc_min"),
        gap_m=part.metrics.get("min_gap"),
        delta_v_mps=part.metrics.get("delta_v"),
        against=opponent.at(step) if opponent else OFF,
        criticality=criticality(part.metrics[_SPARE]) if _SPARE in part.metrics else None,
    )


def _contacts(result: Result, kind: str, first: int, last: int, who: str = "") -> list[int]:
    """Steps of the AV's contacts of a kind within an attack, with anybody or with one.

    What happened at its first step belongs to the turn that ended there.
    """
    return [
        int(one["step"])
        for one in result["contacts"]
        if one["kind"] == kind
        and first < one["step"] <= last
        and who in {"", one["first_id"], one["second_id"]}
    ]
