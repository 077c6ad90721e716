"""Result folders -> the networks in them, each with the attacks on it.

A run -> the attacks in it: where each was decided and began, and how it went.

An attack was *decided* where the AV's centre was when it touched the opponent (or else another
vehicle), or, without a contact, when the gap to the opponent was least. It *began* where the AV was
when the attack took over; the movement that it began before is the next one on the AV's path. Where
opponents attack in turn, each turn is an attack.

``attacks.csv`` of a risk map has one row per attack, in the words of a conflict study. What
conflicts of plain traffic have too (`roadcheck.conflict_places`) has the same name there. An attack
has roles, so that its two road users are ``av`` and ``opponent`` and not first and second.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepmf_sumo import files
from deepmf_sumo.errors import UsageError
from deepmf_sumo.judge.conflict_types import ConflictType, Meeting
from deepmf_sumo.results import findings, frames, planned, statistics, stored, tracks
from deepmf_sumo.results.findings import Worth, cause_of
from deepmf_sumo.results.quantities import SPARE, criticality
from deepmf_sumo.results.reader import MISSING, Run
from deepmf_sumo.results.result import Result
from deepmf_sumo.results.risk import passing
from deepmf_sumo.results.risk import places as places_module
from deepmf_sumo.results.risk.driving import NOTHING, DrivenUnderAttack, driven
from deepmf_sumo.results.risk.passing import Traffic
from deepmf_sumo.results.risk.places import Places, Spot
from deepmf_sumo.results.risk.tracks import OFF, Spots, nearest_step, read_tracks
from deepmf_sumo.results.tracks import RecordedTracks
from deepmf_sumo.scene import DT_S, Floats, RoadMap
from deepmf_sumo.sumo.network.sumo_net import going_first
from deepmf_sumo.sumo.network.sumo_road import road_of_net

ATTACKED: Final = (
    "attack", "folder", "run_id", "turn", "scene", "seed", "kind", "contact", "other_contact",
    "finding", "rung", "ttc_s", "pet_s", "gap_m", "delta_v_mps", "criticality", "x_m", "y_m",
    "place_kind", "place", "title", "junction", "gives_way", "av", "av_lane", "av_speed_mps",
    "opponent", "opponent_lane", "opponent_title", "began_title",
)  # fmt: skip
"""Columns of ``attacks.csv``."""
_DECIMALS: Final = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Attacked:
    """One attack.

    Attributes:
        folder: its result folder, as given.
        turn: number of the turn in its run; None where one opponent attacked all the time.
        decided, began: where; an empty spot where the AV was on no lane and in no junction.
        place_m: (2,) of the AV's centre when it was decided.
        against: where the opponent was then.
        hit: the opponent touched the AV. other: the AV touched another vehicle.
        worth: what the hit is worth; None without a hit, or where that is not known.
        ttc_s: least; None off a collision course. gap_m: least. delta_v_mps: of the hit.
        criticality: see there; None in results of versions that did not measure it.
        kind: of conflict that it is, or would have been; None where the opponent was not there.
        pet_s: least time between the two at a common place; None without one.
        speed_mps: of the AV when the attack began.
        weight: what it counts for in rates: 1, but where moments were drawn by what others found
            the number of moments that it stands for, relative to the mean.
        driven: where the AV was and what it did, up to the contact.
        cause: who erred how, the kind of conflict and the smallest change of the AV that avoids it
            (`judge.causes`); None without a finding, or where it is not known.
        av, opponent: ids. opponent_kind: as in tracks, e.g. ``vehicle``; empty if it was not there.
        made: the opponent is not in the demand: it was put there.
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
    worth: Worth | None
    ttc_s: float | None
    gap_m: float | None
    delta_v_mps: float | None
    against: Spot = OFF
    criticality: float | None = None
    kind: ConflictType | None = None
    pet_s: float | None = None
    speed_mps: float = 0.0
    driven: DrivenUnderAttack = NOTHING
    cause: tuple[str, ...] | None = None
    av: str = ""
    opponent: str = ""
    weight: float = 1.0
    opponent_kind: str = ""
    made: bool = False

    @property
    def finding(self) -> bool:
        """Whether it hit, and the hit is known to be a finding."""
        return self.worth is not None and self.worth.finding

    @property
    def unit(self) -> tuple[str, int | None]:
        """The situation: runs of one spec and scene with other seeds repeat it, turn by turn."""
        return self.run_id.rsplit("--", 1)[0], self.turn


def of_run(
    run: Run, moment: Mapping[str, str], every: Places, road: RoadMap, weight: float = 1.0
) -> list[Attacked]:
    """The attacks of a run: one, or one per turn where opponents attacked in turn.

    Args:
        run: in which a vehicle was attacked.
        moment: the run's row of ``moments.csv``, or empty.
        every: places of its network.
        road: map of its network.
        weight: see `Attacked`.

    Raises UsageError where its tracks are missing or damaged.
    """
    rows = list(frames.attacks_of(run))
    found = read_tracks(run.folder / tracks.FILE)
    av = Spots(found, road, every, found.av_id, moment)
    # those that left before the attack began have no tracks
    there = [row["opponent"] for row in rows if row["opponent"] in found.tracks.ids]
    opponents = {one: Spots(found, road, every, one, {}) for one in there}
    attacks = (
        _attack_of(run.result, row, found, av, opponents.get(row["opponent"])) for row in rows
    )
    return [replace(one, weight=weight) for one in attacks]


def _attack_of(
    result: Result, row: Mapping[str, Any], found: RecordedTracks, spots: Spots,
    opponent: Spots | None,
) -> Attacked:  # fmt: skip
    """An attack; ``row``: of the frame of attacks."""
    foe = row["opponent"]
    last = min(found.now + round(row["end_s"] / DT_S), found.tracks.steps - 1)
    first = min(found.now + round(row["begin_s"] / DT_S), last)
    hits = _contacts(result, "av_opponent", first, last, foe)
    others = _contacts(result, "av_other", first, last)
    nearest = nearest_step(found, foe, first, last)
    # of the opponent, else of another, else when the gap was least, else at the start
    step = next(iter((*hits, *others, first if nearest is None else nearest)))
    place_m: Floats = found.tracks.position_m[found.tracks.row(found.av_id), step]
    decided, against = spots.at(step), opponent.at(step) if opponent else OFF
    kind = _kind(found, foe, step, spots.road)
    judged = row["turn"] in {None, _first_hit(result)}
    return Attacked(
        folder=row["folder"],
        run_id=row["run_id"],
        turn=row["turn"],
        scene=row["scene"],
        seed=row["seed"],
        decided=decided,
        began=spots.began(first),
        place_m=(float(place_m[0]), float(place_m[1])),
        hit=bool(hits),
        other=bool(others),
        worth=findings.worth(row) if hits else None,
        ttc_s=row.get("ttc_min"),
        gap_m=row.get("min_gap"),
        delta_v_mps=row.get("delta_v"),
        against=against,
        criticality=criticality(row[SPARE]) if SPARE in row else None,
        kind=kind,
        pet_s=row.get("pet"),
        speed_mps=float(found.tracks.speed_mps[found.tracks.row(found.av_id), first]),
        driven=_driven(found, spots, first, step if hits or others else last),
        cause=cause_of(result, kind) if hits and judged else None,
        av=found.av_id,
        opponent=foe,
        opponent_kind=_kind_of(found, foe),
        made=any(one["id"] == foe for one in result.get("made", [])),
    )


def _kind_of(found: RecordedTracks, agent: str) -> str:
    tracks = found.tracks
    return tracks.kinds[tracks.row(agent)] if agent in tracks.ids else ""


def _driven(found: RecordedTracks, spots: Spots, first: int, last: int) -> DrivenUnderAttack:
    """Where the AV was and what it did from the attack's begin to its contact, or its end."""
    row = found.tracks.row(found.av_id)
    there = found.tracks.valid[row, first : last + 1]
    if not there[0]:
        return NOTHING
    steps = len(there) if there.all() else int(there.argmin())  # it may leave the simulation
    where = [spots.at(step) for step in range(first, first + steps)]
    return driven(found.tracks, row, where, first, DT_S, spots.places, spots.road)


def _first_hit(result: Result) -> int | None:
    """Number of the turn that a run's verdict is of."""
    turns = enumerate(result["turns"] or [], start=1)
    return next((number for number, turn in turns if turn["ended"] == "contact"), None)


def _kind(found: RecordedTracks, opponent: str, step: int, road: RoadMap) -> ConflictType | None:
    """Of the conflict, where both were there; at the nearest such step where not at this one."""
    tracks = found.tracks
    if opponent not in tracks.ids:
        return None
    rows = [tracks.row(found.av_id), tracks.row(opponent)]
    both = np.flatnonzero(tracks.valid[rows].all(axis=0))
    if not len(both):
        return None
    at = int(both[abs(both - step).argmin()])
    return Meeting.of(tracks, (found.av_id, opponent), at, road).type


def _contacts(result: Result, kind: str, first: int, last: int, opponent: str = "") -> list[int]:
    """Steps of the AV's contacts of a kind within an attack, with any vehicle or with one.

    A contact at its first step belongs to the turn that ended there.
    """
    return [
        int(one["step"])
        for one in result["contacts"]
        if one["kind"] == kind
        and first < one["step"] <= last
        and opponent in {"", one["first_id"], one["second_id"]}
    ]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Network:
    """A network and the attacks on it.

    Attributes:
        name: of the .sumocfg, without suffix. net_file: a copy in one of the runs' folders.
        left_out: runs that are not counted, by reason.
        traffic: vehicles that pass without an attack; empty where no moments were chosen.
    """

    name: str
    net_file: Path
    places: Places
    attacks: tuple[Attacked, ...]
    left_out: Mapping[str, int]
    traffic: Traffic = field(default_factory=dict)


@dataclass(slots=True, eq=False)
class _Filling:
    """A network whose attacks are being read."""

    name: str
    net_file: Path
    places: Places
    road: RoadMap
    attacks: list[Attacked]
    left_out: Counter[str]
    traffic: Traffic = field(default_factory=dict)
    specs: set[tuple[Path, str]] = field(default_factory=set)

    def pass_by(self, out: Path, result: Result, flows: Sequence[Mapping[str, str]]) -> None:
        """Note the traffic of a run's spec, once."""
        rows = passing.of_result(flows, result)
        key = out, rows[0]["spec"] if rows else ""
        if rows and key not in self.specs:
            self.specs.add(key)
            passing.add(self.traffic, rows, self.places)


def read(folders: Sequence[Path]) -> list[Network]:
    """The networks of result folders, each with its attacks; by name, then by content.

    A folder may contain result folders instead, e.g. one per seed; one named twice counts once.
    Failed runs and those without an opponent are counted under ``left_out``, those on recorded
    scenes or on networks without any readable attack with the first network.

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
            traffic=one.traffic,
        )
        for one in found
    ]


def _read(out: Path, networks: dict[tuple[str, str], _Filling], left_out: Counter[str]) -> None:
    moments, flows = stored.moments_of(out), stored.flows_of(out)
    runs = planned.read(out).runs
    weights = _weights({run.run_id: run.result for run in runs if run.has_result}, moments)
    for run in runs:
        if run.status != "ok":
            left_out["without a result" if run.status == MISSING else run.status] += 1
        elif not run.network:
            left_out["on recorded scenes"] += 1
        elif not run.attacked:
            left_out["with no vehicle to attack"] += 1
        else:
            network = _network(run.folder, run.network, networks)
            network.pass_by(out, run.result, flows)
            moment, weight = moments.get(run.run_id, {}), weights.get(run.run_id, 1.0)
            try:
                network.attacks += of_run(run, moment, network.places, network.road, weight)
            except UsageError:
                network.left_out["without readable tracks"] += 1


def _weights(
    results: Mapping[str, Result], moments: Mapping[str, Mapping[str, str]]
) -> dict[str, float]:
    """Of the runs whose moments were drawn by what others found, see `statistics.drawn`.

    Runs that failed were drawn, too: what those after them stand for depends on their place.
    """
    draws: dict[tuple[str, int, int], list[tuple[int, float, str]]] = defaultdict(list)
    counted = set()
    for run_id, result in results.items():
        row = moments.get(run_id, {})
        if row.get("probability"):
            one = int(row["draw"]), float(row["probability"]), run_id
            draws[result["spec"], result["seed"], int(row["pool"])].append(one)
            if result["status"] == "ok":
                counted.add(run_id)
    weights: dict[str, float] = {}
    for (*_, pool), found in draws.items():
        group = sorted(found)
        every = statistics.drawn([chance for _, chance, _ in group], pool)
        stands_for = {one[2]: each for one, each in zip(group, every, strict=True)}
        known = {run_id: each for run_id, each in stands_for.items() if run_id in counted}
        weights |= {
            run_id: each * len(known) / sum(known.values()) for run_id, each in known.items()
        }
    return weights


def _network(folder: Path, name: str, networks: dict[tuple[str, str], _Filling]) -> _Filling:
    """The network of a run, identified by its content."""
    key = name, net_digest(folder)
    if key not in networks:
        file = _net_file(folder)
        networks[key] = _Filling(
            name=name,
            net_file=file,
            places=places_module.read(file),
            road=road_of_net(file),
            attacks=[],
            left_out=Counter(),
        )
    return networks[key]


def net_digest(folder: Path) -> str:
    """Digest of the network in a run's folder. Raises UsageError where there is none."""
    return files.sha256(_net_file(folder))


def _net_file(folder: Path) -> Path:
    file = stored.net_file(folder)
    if file is None:
        raise UsageError(f"{folder / 'sumo'} holds no net.net.xml; run it again.")
    return file


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacePair:
    """Attacks on an AV at one movement or edge by an opponent at another, or at the same.

    Attributes:
        place, against: titles of the AV's and the opponent's; empty off the lanes.
        findings: of the hits that were ``judged``.
    """

    place: str
    against: str
    attacks: int
    hits: int
    findings: int
    judged: int


def conflicts(network: Network) -> list[PlacePair]:
    """All pairs of places, those with most hits first."""
    groups: dict[tuple[str, str], list[Attacked]] = {}
    for one in network.attacks:
        ends = network.places.site(one.decided), network.places.site(one.against)
        groups.setdefault(ends, []).append(one)
    found = [_conflict(*ends, group) for ends, group in groups.items()]
    return sorted(found, key=lambda one: (-one.hits, -one.attacks, one.place, one.against))


def _conflict(place: str, against: str, group: Iterable[Attacked]) -> PlacePair:
    attacks = list(group)
    return PlacePair(
        place=place,
        against=against,
        attacks=len(attacks),
        hits=sum(one.hit for one in attacks),
        findings=sum(one.finding for one in attacks),
        judged=sum(one.worth is not None for one in attacks),
    )


def attack_rows(network: Network) -> list[dict[str, Any]]:
    """The attacks in the order of their runs; None where something is not known."""
    first_at = going_first(network.places.net)
    return [
        dict(
            zip(
                ATTACKED,
                (number, *map(_rounded, _values(one, network.places, first_at))),
                strict=True,
            )
        )
        for number, one in enumerate(network.attacks, start=1)
    ]


def _rounded(value: Any) -> Any:
    """Coordinates far from the origin keep their decimals, which six digits would not hold."""
    return round(value, _DECIMALS) if isinstance(value, float) else value


def _values(
    one: Attacked, places: Places, first_at: Mapping[str, tuple[str, ...]]
) -> tuple[Any, ...]:
    """The columns after ``attack``."""
    at = one.decided
    where = places.located(at) if at.movement or at.edge or at.junction else ("", "", "")
    return (
        Path(one.folder).resolve().name, one.run_id, one.turn, one.scene, one.seed, one.kind,
        one.hit, one.other, one.finding if one.worth else None,
        one.worth.rung if one.worth else None, one.ttc_s, one.pet_s, one.gap_m, one.delta_v_mps,
        one.criticality,
        *one.place_m, *where, at.junction, _gives_way(one, places, first_at),
        one.av, at.lane, one.speed_mps, one.opponent, one.against.lane,
        places.site(one.against), places.site(one.began),
    )  # fmt: skip


def _gives_way(one: Attacked, places: Places, first_at: Mapping[str, tuple[str, ...]]) -> str:
    """Which of the two the network tells to give way; empty where it does not, or tells both."""
    av, opponent = _lanes(one.decided, places), _lanes(one.against, places)
    waits = [
        any(not first.isdisjoint(first_at.get(lane, ())) for lane in mine)
        for mine, first in ((av, opponent), (opponent, av))
    ]
    if waits[0] == waits[1]:
        return ""
    return "av" if waits[0] else "opponent"


def _lanes(spot: Spot, places: Places) -> frozenset[str]:
    """Those of the spot's movement, else its own."""
    if spot.movement:
        return frozenset(places.movements[spot.movement].lanes)
    return frozenset({spot.lane} - {""})
