"""The ten situations with people of Euro NCAP's protocol for crash avoidance, as numbers.

Distances and speeds are those of the protocol of 2026 (crash avoidance, frontal collisions; turning
cases: AEB for vulnerable road users, 2023), as the public OpenSCENARIO set of Vector lists them
(github.com/vectorgrp/OSC-NCAP-scenarios, read in November 2026). The roads are ours (`build`).
"""

from dataclasses import dataclass
from typing import Final, Literal

Road = Literal["street", "parked", "junction"]
Motion = Literal["across", "ahead", "turned_into", "oncoming"]
Who = Literal["adult", "child", "cyclist", "motorcyclist"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """A situation, and the AV's speeds in it.

    Attributes:
        motion: ``across`` the AV's straight way; ``ahead`` of it in its lane; across the road that
            it is ``turned_into``; ``oncoming`` while it turns left.
        from_left: the other comes from the far side (traffic drives on the right).
        speed_mps: of the other, once it moves.
        away_m: it stands so far from the middle of the AV's way before it starts.
        starts_m: it reaches its speed in this distance.
        shares: of the AV's width, from the side that the other comes from, at which it is hit.
        av_kmh: speeds of the AV.
        obstructed: parked cars hide it until it steps past them.
    """

    name: str
    title: str
    road: Road
    motion: Motion
    who: Who
    from_left: bool
    speed_mps: float
    away_m: float
    starts_m: float
    shares: tuple[float, ...]
    av_kmh: tuple[int, ...]
    obstructed: bool = False


_TENS: Final = (10, 20, 30, 40, 50, 60)
_TURNS: Final = (10, 15, 20)
_KMH: Final = 1 / 3.6

SITUATIONS: Final[tuple[Situation, ...]] = (
    Situation(
        name="CPFA", title="adult runs across from the far side", road="street", motion="across",
        who="adult", from_left=True, speed_mps=8 * _KMH, away_m=6.0, starts_m=1.5, shares=(0.5,),
        av_kmh=_TENS,
    ),
    Situation(
        name="CPNA", title="adult walks across from the near side", road="street", motion="across",
        who="adult", from_left=False, speed_mps=5 * _KMH, away_m=4.0, starts_m=1.0,
        shares=(0.25, 0.75), av_kmh=_TENS,
    ),
    Situation(
        name="CPNCO", title="child steps out from behind parked cars", road="parked",
        motion="across", who="child", from_left=False, speed_mps=5 * _KMH, away_m=4.0, starts_m=1.0,
        shares=(0.5,), av_kmh=_TENS, obstructed=True,
    ),
    Situation(
        name="CPLA", title="adult walks ahead in the lane", road="street", motion="ahead",
        who="adult", from_left=False, speed_mps=5 * _KMH, away_m=0.0, starts_m=1.0,
        shares=(0.25, 0.5), av_kmh=_TENS,
    ),
    Situation(
        name="CPTA", title="adult crosses the road that the AV turns into", road="junction",
        motion="turned_into", who="adult", from_left=True, speed_mps=5 * _KMH, away_m=6.75,
        starts_m=1.0, shares=(0.5,), av_kmh=_TURNS,
    ),
    Situation(
        name="CBNA", title="cyclist crosses from the near side", road="junction", motion="across",
        who="cyclist", from_left=False, speed_mps=15 * _KMH, away_m=17.0, starts_m=0.0,
        shares=(0.5,), av_kmh=_TENS,
    ),
    Situation(
        name="CBFA", title="cyclist crosses from the far side", road="junction", motion="across",
        who="cyclist", from_left=True, speed_mps=20 * _KMH, away_m=22.0, starts_m=0.0,
        shares=(0.5,), av_kmh=_TENS,
    ),
    Situation(
        name="CBLA", title="cyclist rides ahead in the lane", road="street", motion="ahead",
        who="cyclist", from_left=False, speed_mps=15 * _KMH, away_m=0.0, starts_m=0.0,
        shares=(0.25, 0.5), av_kmh=_TENS[1:],
    ),
    Situation(
        name="CBTA", title="oncoming cyclist, while the AV turns left", road="junction",
        motion="oncoming", who="cyclist", from_left=True, speed_mps=15 * _KMH, away_m=0.0,
        starts_m=0.0, shares=(0.5,), av_kmh=_TURNS,
    ),
    Situation(
        name="CMFtap", title="oncoming motorcycle, while the AV turns left", road="junction",
        motion="oncoming", who="motorcyclist", from_left=True, speed_mps=30 * _KMH, away_m=0.0,
        starts_m=0.0, shares=(0.5,), av_kmh=_TURNS,
    ),
)  # fmt: skip
