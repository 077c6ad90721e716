"""Groups of failures in the words of an engineer."""

from collections.abc import Iterable
from typing import Final

from deepmf_sumo.judge.conflict_types import ACROSS, ConflictType
from deepmf_sumo.report.table import counted
from deepmf_sumo.results.failures import Failure
from deepmf_sumo.results.findings import DRIVERS, by_whom
from deepmf_sumo.results.groups import FailureGroup, causes
from deepmf_sumo.texts import shown

HEADINGS: Final = (
    "runs", "failure", "worth", "opponent from", "AV", "smallest change", "avoided by",
    "last moment, s before the hit", "delta-v, m/s",
)  # fmt: skip
_CONTRIVED: Final = {
    "av_stood": "the AV stood or crept",
    "low_delta_v": "delta-v was below 5 km/h",
    "rammed": "the {other} drove into the AV's rear end",
    "against_traffic": "the {other} drove against the traffic",
    "off_road": "the {other} left the road",
    "infeasible": "no {other} moves like that",
    "touched_another": "one of the two had touched another road user before",
    "low_impact_speed": "the AV was slower than 5 km/h at the impact",
    "ran_into_side": "the {other} ran into the AV's side",
    "ran_into_rear": "the {other} ran into the AV's rear end",
    "supporter_touched": "the road user that supported it touched somebody",
}
"""Why a hit says little about the AV, by the reasons of `judge.ladder`."""
_ALSO: Final = {
    "ran_light": " The {other} ran a red light.",
    "sped": " The {other} drove far above the limit.",
    "braked_hard": " The {other} braked harder than drivers do.",
    "crossed_on_red": " The AV's light was green.",
    "rode_against": " The {other} came against the traffic.",
}
"""Errors of the opponent that the kind of conflict does not tell."""
_CAREFUL: Final[dict[ConflictType, str]] = {
    "rear-end": "kept its distance",
    "crossing": "braked in time",
    "left turn across path": "braked in time",
    "right turn across path": "braked in time",
    "merging": "made room",
    "lane change": "made room",
    "head-on": "braked in time",
}
"""What a careful driver would have done."""
_WAITING: Final = {
    "left turn across path",
    "right turn across path",
    "merging",
    "lane change",
}
"""Where it is the AV that turns, merges or changes lanes, a careful driver waits."""
_WAITED: Final = {"turn": "turn {turn}", "merging": "merge"}
"""What an AV that stood waited for."""
_BRAKES_MPS2: Final = 1.0
_WHO: Final = {"bicycle": "cyclist"}
"""Who rides what the opponent is called."""
_REACTS: Final = "0.75 s after the danger showed"
_DID: Final = {
    "stopped": "had stopped",
    "accelerated": "accelerated",
    "set off": "set off",
    "stood": "stood",
    "held speed": "held its speed",
    "steered": "steered",
}


def row(group: FailureGroup) -> tuple[str, ...]:
    """A group in the order of `HEADINGS`."""
    one = group.example
    return (
        f"{len(group.failures)} of {group.of}",
        title(one),
        group.worth,
        one.side or "",
        one.action or "",
        one.change,
        group.avoided_by,
        _last(one),
        "" if one.kind != "hit" else f"{group.delta_v_mps:.1f}",
    )


def facts(group: FailureGroup) -> list[list[str]]:
    """Names and values of what the failures of a group have in common."""
    one = group.example
    known = {
        "worth": group.worth,
        f"{one.opponent} from": one.side,
        "priority": one.priority,
        "AV": one.action,
        "smallest change": one.change,
        "avoided by": by_whom(one.worth, words=True),
        "last moment": _moments(one),
        "onset": _seconds(group),
        "delta-v": f"up to {group.delta_v_mps:.1f} m/s" if one.kind == "hit" else "",
    }
    return [[name, value] for name, value in known.items() if value]


def _seconds(group: FailureGroup) -> str:
    """Since when, where it is avoidable."""
    if group.onset_s is None or not (group.example.worth and group.example.worth.avoided_by):
        return ""
    return f"{group.onset_s:.1f} s before the hit (median)"


def title(failure: Failure) -> str:
    """The name of its kind."""
    return failure.conflict or failure.kind


def sentence(group: FailureGroup) -> str:
    """What an engineer would write about the group's example."""
    one = group.example
    if one.kind != "hit":
        return f"The {one.kind}: {shown(' '.join(one.reason.split()))}"
    also = " The AV ran a red light." * (one.av_error == "ran_light")
    error = "ran_light" if one.ran_red else one.opponent_error
    also += _ALSO.get(error, "").format(other=one.opponent)
    happened = _happened_with_person(one) if one.person else ""
    return f"{happened or _happened(one)}{_judged(one)}.{also}"


def summary(groups: Iterable[FailureGroup]) -> str:
    """How many distinct causes the findings have; empty where none has a known cause."""
    number, of = causes(groups)
    return f"{counted(number, 'distinct cause')} in {counted(of, 'finding')}" if number else ""


def _judged(one: Failure) -> str:
    """What would have avoided it, or why it does not count."""
    contrived = [_CONTRIVED[name] for name in one.reasons if name in _CONTRIVED]
    if contrived:
        return f". It is contrived: {' and '.join(contrived).format(other=one.opponent)}"
    if one.change == "none":
        return "; no change of the AV that was tried would have avoided it"
    if one.change:
        last = one.last_moment
        moment = f"; the last moment to act was {last[1]:.1f} s before the hit" if last else ""
        return f". It would have been enough {one.what}{moment}"
    danger = f". The danger showed {one.onset_s:.1f} s before the hit" if one.onset_s else ""
    return f"{danger}; {_advice(one)}"


def _last(one: Failure) -> str:
    """The last moment to act, and for whom."""
    return f"{one.last_moment[1]:.1f} ({one.last_moment[0]})" if one.last_moment else ""


def _moments(one: Failure) -> str:
    """The last moments of each driver."""
    known = {name: at for name, at in one.last_moment_s.items() if at is not None}
    said = ", ".join(f"{name} {at:.1f} s" for name, at in known.items())
    return f"{said} before the hit" if said else ""


def _happened(one: Failure) -> str:
    """What both did."""
    assert one.conflict is not None
    other, did = one.opponent, _did(one)
    turn = one.conflict.partition(" ")[0]
    across = f"across the way of a {other} {_beside(one)}"
    by_turn = f"A {other} {_beside(one)} turned {turn} across the way of the AV"
    if one.side == "ahead":
        across = f"in front of an oncoming {other}"
        by_turn = f"An oncoming {other} turned {turn} in front of the AV"
    stood = ", which stood" * one.stood
    had = ", which had priority" * (one.priority == "opponent")
    by_av: dict[str, str] = {
        "rear-end": f"A {other} behind ran into the AV, which {did}",
        "turn": f"The AV turned {turn} {across}{had}",
        "merging": f"The AV merged into the way of a {other} from {_from(one)}{had}",
        "lane change": f"The AV moved over into the way of a {other} {_beside(one)}",
    }
    by_other: dict[str, str] = {
        "rear-end": f"The AV {did} and ran into the {other} ahead{stood}",
        "turn": by_turn,
        "merging": f"A {other} from {_from(one)} merged into the way of the AV",
        "lane change": f"A {other} {_beside(one)} moved over into the way of the AV",
        "head-on": f"An oncoming {other} came into the way of the AV",
        "crossing": f"A {other} from {_from(one)}{_right_of_way(one)} crossed in front of the AV",
    }
    if one.av_error == "struck_standing":
        return f"The AV {did} and ran into a {other} that stood"
    name = "turn" if one.conflict in ACROSS else one.conflict
    came = f"n oncoming {other}" if one.side == "ahead" else f" {other} from {_from(one)}"
    if one.turned == "AV" and one.action == "stood" and name in _WAITED:
        return f"The AV waited to {_WAITED[name].format(turn=turn)}, and a{came} came into its way"
    if _left_its_lane(one) and one.turned == "AV" and name == "turn":
        return f"The AV turned {turn}, and a{came} left its lane and came into its way"
    if _left_its_lane(one):
        return f"A{came} left its lane and came into the way of the AV, and the AV {did}"
    if one.turned == "AV" and name in by_av:
        stopped = " and stopped" if one.action == "stopped" and name != "rear-end" else ""
        return by_av[name] + stopped
    return by_other[name] if name == "rear-end" else f"{by_other[name]}, and the AV {did}"


def _happened_with_person(one: Failure) -> str:
    """Of a person who did not ride along the road as vehicles do; else empty."""
    other, did = _WHO.get(one.opponent, one.opponent), _did(one)
    behind = f" from behind {one.emerged}" * bool(one.emerged)
    if one.av_error == "struck_standing":
        return f"The AV {did} and ran into a {other} who stood on the road"
    if one.av_error == "left_road":
        return f"The AV {did}, left the road and hit a {other} there"
    if one.on_crossing:
        came = f"crossed on a pedestrian crossing from {_from(one)}"
    elif one.opponent_error in {"stepped_out", "rode_out"}:
        verb = "stepped" if one.opponent_error == "stepped_out" else "rode"
        came = f"{verb} onto the road" if behind else f"{verb} onto the road from {_from(one)}"
    elif one.av_error or one.opponent_error:
        return ""
    else:
        came = f"came from {_from(one)}"
    if {"ran_into_side", "ran_into_rear"} & {*one.reasons}:
        return f"A {other} who {came}{behind} ran into the AV; it {did}"
    return f"The AV hit a {other} who {came}{behind}; it {did}"


def _did(one: Failure) -> str:
    if one.action == "steered" and one.braking_mps2 >= _BRAKES_MPS2:
        return f"steered and braked with up to {one.braking_mps2:.0f} m/s2"
    if one.action != "braked":
        return _DID[one.action or "held speed"]
    return f"braked{' late' * one.late} with up to {max(one.braking_mps2, 1.0):.0f} m/s2"


def _left_its_lane(one: Failure) -> bool:
    """A vehicle that turns across is told as turning, on its lanes or not."""
    return one.strayed and not (one.conflict in ACROSS and one.turned == "opponent")


def _from(one: Failure) -> str:
    return f"the {one.side}" if one.side in {"left", "right"} else f"{one.side}"


def _beside(one: Failure) -> str:
    return f"on the {one.side}" if one.side in {"left", "right"} else f"{one.side}"


def _right_of_way(one: Failure) -> str:
    if not one.priority:
        return ""
    return ", which had priority," if one.priority == "opponent" else " without priority"


def _advice(one: Failure) -> str:
    by = one.worth.avoided_by if one.worth else None
    if by is None:
        return "it is not known whether it was avoidable"
    if not by:
        return "no driver could have avoided it"
    if by == ("search",):
        return "only braking or steering immediately would have avoided it"
    if "vru" in by:
        return f"a driver who brakes {_REACTS} would not have hit the {one.opponent}"
    assert one.conflict is not None
    moves = one.turned == "AV" and one.action != "stood" and not one.strayed
    did = "waited" if moves and one.conflict in _WAITING else _CAREFUL[one.conflict]
    if "cc" in by:
        return f"a careful driver would have {did}"
    named = " and ".join(DRIVERS[name] for name in by if name != "search")
    return f"{named} would have {did}, a careful driver would not"
