"""Results -> rows of the table that a terminal shows."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from deepmf_sumo.results import findings
from deepmf_sumo.results.result import Result, first_contact
from deepmf_sumo.scene.geometry import impact

HEADINGS: Final = ("run", "outcome", "contact", "speed", "opponent", "AV hit at", "generated in")

SECTORS: Final = tuple(name.replace("_", " ") for name in impact.SECTORS)
"""Names of the eight impact sectors, counter-clockwise."""

OUTCOMES: Final = {
    "av_opponent": "AV hit by opponent",
    "av_other": "AV hit another",
    "opponent_other": "opponent hit another",
    "supporter_other": "supporter hit another",
    "none": "no contact",
}


def rows(results: Sequence[Result]) -> list[tuple[str, ...]]:
    """One row per run, in the order of `HEADINGS`."""
    return [_row(result) for result in results]


def _row(result: Result) -> tuple[str, ...]:
    run_id = result["run_id"]
    if result["status"] != "ok":
        return (run_id, f"{result['status']}: {result['error']}", "", "", "", "", "")
    outcome = result["outcome"]
    contact = first_contact(result)
    opponent = result["opponent"] or "-"
    score = result["opponent_score"]
    opponent += ", made" if result["opponent"] in made_ids(result) else ""
    opponent += "".join(f", supported by {one}" for one in supporters(result))
    broken = "".join(f"; EXPECTATION BROKEN: {one}" for one in result["expectations_broken"])
    return (
        run_id,
        OUTCOMES.get(outcome, outcome) + broken,
        f"{contact['time_s']:.1f} s" if contact else "-",
        f"{contact['relative_mps']:.1f} m/s" if contact else "-",
        opponent if score is None else f"{opponent} ({score:.2f})",
        SECTORS[contact["sector"]] if contact and outcome.startswith("av") else "-",
        f"{result['timings']['generation_s']:.2f} s",
    )


def made_ids(result: Result) -> list[str]:
    """The people of a run who are not in the demand: they were put there."""
    return [one["id"] for one in result.get("made", [])]


def made_people(result: Result) -> list[str]:
    """Who was made in a run, and where, each in a few words."""
    return [f"{one['id']} ({one['place'].replace('_', ' ')})" for one in result.get("made", [])]


def made_note(results: Iterable[Result]) -> str:
    """A sentence on the runs with made people; empty without any."""
    runs = [one for one in results if one.get("made")]
    if not runs:
        return ""
    attacks = sum(one.get("opponent") in made_ids(one) for one in runs)
    people = sum(len(one["made"]) for one in runs)
    return (
        f"made people, who are not in the demand but put where people could be: {people} in"
        f" {counted(len(runs), 'run')}; {counted(attacks, 'attack')} by them"
    )


def nobody_note(results: Iterable[Result]) -> str:
    """What to do where only people may attack and nobody was there; empty elsewhere."""
    alone = [
        one
        for one in results
        if one["status"] == "ok"
        and one["settings"]["adversary"].get("attackers") == "people"
        and one["network"]
        and one["opponent"] is None
        and not one.get("made")
    ]
    if not alone:
        return ""
    return (
        f"nobody attacked in {counted(len(alone), 'run')}: no pedestrian and no cyclist could;"
        " source.people: made (--set source.people=made) puts people where they could be"
    )


def supporters(result: Result) -> dict[str, str]:
    """By supporter of the attack, which ways out it took from the AV: the mean over its plans."""
    plans = [one for one in result.get("support", []) if one["agent_id"] is not None]
    return {name: _ways(one for one in plans if one["agent_id"] == name) for name in _names(plans)}


def _names(plans: Sequence[Mapping[str, Any]]) -> list[str]:
    return list(dict.fromkeys(one["agent_id"] for one in plans))


def _ways(plans: Iterable[Mapping[str, Any]]) -> str:
    """``left 80 %, right 10 % of the ways out in 7 plans``."""
    found = list(plans)
    ways = dict.fromkeys(way for one in found for way in one["ways"])
    shares = {way: sum(one["ways"].get(way, 0.0) for one in found) / len(found) for way in ways}
    told = [f"{way} {share:.0%}" for way, share in shares.items() if share > 0]
    return f"{', '.join(told) or 'none'} of the ways out in {counted(len(found), 'plan')}"


def counted(number: int, one: str, many: str = "") -> str:
    """``1 run``, ``2 runs``; ``many`` is another plural."""
    return f"{number} {one if number == 1 else many or one + 's'}"


def meanings(summary: dict[str, Any]) -> list[str]:
    """What the letters and drivers in `totals` are, a sentence each."""
    return findings.legend(findings.Count(**summary["findings"]))


def totals(summary: dict[str, Any]) -> str:
    """The line under the table, from the content of ``summary.json``."""
    statuses = ", ".join(f"{count} {status}" for status, count in summary["status"].items())
    parts = [f"{counted(summary['runs'], 'run')}: {statuses or 'none'}"]
    rate = summary["collision_rate"]
    if rate:
        parts.append(
            f"AV hit by opponent in {summary['hits']} of {summary['attacked']} attacked,"
            f" {100 * rate['rate']:.0f} %"
            f" (95 % interval {100 * rate['low']:.0f}-{100 * rate['high']:.0f} %)"
        )
    if summary["hits"]:
        parts.append(findings.counted(findings.Count(**summary["findings"])))
    if summary["contact_speed_mps_mean"] is not None:
        parts.append(f"mean contact speed {summary['contact_speed_mps_mean']:.1f} m/s")
    if summary["expectations_broken"]:
        parts.append(f"{len(summary['expectations_broken'])} with broken expectations")
    if summary.get("out_of_time"):
        parts.append(
            f"{summary['out_of_time']} ended by their budget in seconds: they depend on the machine"
        )
    if summary.get("unrepeated"):
        parts.append(
            f"the planner is not repeatable: in {counted(summary['unrepeated'], 'run')} it drove"
            f" up to {summary['unrepeated_m']:.2g} m elsewhere than without the attack when all"
            " else was the same, so that tries and causes are of what was recorded"
        )
    return "; ".join(parts)
