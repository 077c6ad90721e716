"""A run of a result folder -> its row and its details on the page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepmf_sumo.errors import UsageError
from deepmf_sumo.report.page.columns import run_row
from deepmf_sumo.report.page.replay import lights, main_places, packed, reasons, replay
from deepmf_sumo.report.page.roads import PageRoads, element
from deepmf_sumo.report.table import OUTCOMES, made_ids, made_people, supporters
from deepmf_sumo.results import artifacts, stored
from deepmf_sumo.results.failures import Failure, failure_of
from deepmf_sumo.results.findings import tried
from deepmf_sumo.results.reader import Run
from deepmf_sumo.results.result import Result, attacked
from deepmf_sumo.scene import RoadMap

_LOG_LINES: Final = 40
_FACTS: Final = (
    "weights", "seed", "version", "adversary", "profile", "constraints", "settings", "budget",
    "plans", "rules", "ended", "counterfactual", "error", "expectations_broken",
)  # fmt: skip
"""Keys of ``result.json`` that the page shows as they are."""
_BEFORE: Final = "an earlier version judged this run by its own plan"
_ENDED: Final = {
    "too_long": "longest time of a turn",
    "time": "end of the run",
    "other_hit": "another attacker hit the AV",
}
"""Names of `scene.plan.Turn` that do not explain themselves."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunPage:
    """One run of the page.

    Attributes:
        row: in the order of `columns.RUN_COLUMNS`.
        details: `replay.packed`.
        weights: name of the weights that it used, if known.
        network: of SUMO, on which the run attacked a vehicle; empty where it did not.
        missing: why it cannot be replayed; empty where it can, or where it has no result at all.
        failure: what went wrong in it; None where nothing did, or that is not known.
    """

    row: list[Any]
    details: str
    weights: str | None
    network: str
    missing: str
    failure: Failure | None


def run_page(out: Path, table: Mapping[str, str], roads: PageRoads) -> RunPage:
    """Read a run; what cannot be read is left out, and the page says so."""
    run = Run.of_row(out, table)
    result, missing = _result(run)
    shown: dict[str, Any] = {}
    place, failure, before = "", None, ""
    if result and table["status"] == "ok":
        try:
            shown, place, road = _shown(run, roads, result["turns"] or [])
            failure, missing = _failure(run, road)
            shown["onset"] = _onset(run, failure)
            before = _BEFORE if run.judged_by_plan else ""
        except stored.DAMAGE as error:
            missing = f"cannot be replayed: {type(error).__name__}: {error}"
    elif run.status != "ok":
        failure = failure_of(run)
    said = (table.get("error", ""), missing, before, _made(result), *_broken(result))
    note = "; ".join(part for part in said if part)
    return RunPage(
        row=run_row(run, result, place, note),
        details=packed({**_facts(run, result), **shown, "missing": missing}),
        weights=result["weights"] if result else None,
        network=(result["network"] or "") if result and attacked(result) else "",
        missing=missing,
        failure=failure,
    )


def _result(run: Run) -> tuple[Result | None, str]:
    if not run.has_result:
        return None, "" if run.status == "skipped" else "result.json is missing"
    try:
        return run.result, ""
    except UsageError as error:
        return None, f"cannot be shown: {error}".replace(f"{run.folder}/", "")


def _broken(result: Result | None) -> list[str]:
    broken = result["expectations_broken"] if result else []
    return [f"expectation broken: {one}" for one in broken]


def _shown(
    run: Run, roads: PageRoads, turns: Sequence[Mapping[str, Any]]
) -> tuple[dict[str, Any], str, RoadMap | None]:
    """What is drawn of a run, the element of the road on which the AV was hit, and the road."""
    rollout = run.rollout
    places = main_places(rollout)
    number, road, note = roads.add(run, places)
    origin = np.rint(places[0])
    shown = {
        "replay": replay(rollout, origin, turns, road),
        "lights": lights(rollout, road, origin) if road is not None else [],
        "reasons": reasons(run.folder / artifacts.PLANS, origin),
        "road": number,
        "road_note": note,
        "sees": run.av_sees,
        "gui": run.opens_in_sumo,
    }
    return shown, _element(run, road), road


def _onset(run: Run, failure: Failure | None) -> int | None:
    """The step from which on the danger of a hit shows; None where there is none."""
    if failure is None or failure.onset_s is None or run.contact is None:
        return None
    return run.contact.step - round(failure.onset_s / run.rollout.dt_s)


def _failure(run: Run, road: RoadMap | None) -> tuple[Failure | None, str]:
    """What went wrong, or why that cannot be said."""
    try:
        return failure_of(run, road), ""
    except stored.DAMAGE as error:
        return None, f"is in no group of failures: {type(error).__name__}: {error}"


def _element(run: Run, road: RoadMap | None) -> str:
    if run.contact is None or road is None:
        return ""
    pose, tracks = run.contact.pose_first, run.rollout.tracks
    z_m = tracks.z_m[tracks.row(run.contact.first_id), run.contact.step]
    return element(road, pose[:2], float(z_m), float(pose[2]))


def _made(result: Result | None) -> str:
    if result and result.get("opponent") in made_ids(result):
        return "the opponent was made: it is not in the demand"
    return ""


def _facts(run: Run, result: Result | None) -> dict[str, Any]:
    facts: dict[str, Any] = {"metrics": {}, "events": [], "turns": [], "repairs": [], "tries": ""}
    if result:
        facts |= {name: value for name, value in result.items() if name in _FACTS}
    if result and result["status"] == "ok":
        facts |= {
            "metrics": {
                name: [one["value"], one["unit"], one["reason"]]
                for name, one in result["metrics"].items()
            },
            "events": [
                [event["step"], event["agent_id"], event["kind"], event.get("detail", "")]
                for event in result["events"]
            ],
            "turns": _turns(result["turns"] or []),
            "repairs": result["repairs"],
            "tries": tried(result["search"]["tries"]),
        }
        supported = [f"{one}: {ways}" for one, ways in supporters(result).items()]
        facts |= {"supporters": supported} if supported else {}
        facts |= {"made": made} if (made := made_people(result)) else {}
    log = run.log_text.splitlines()[-_LOG_LINES:]
    return {**facts, "spec": run.spec_text, "log": "\n".join(log)}


def _turns(turns: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Which opponent attacked when, and how that ended, where several attacked."""
    gaps = [turn["metrics"].get("min_gap") for turn in turns]
    nearest = min((gap for gap in gaps if gap is not None), default=None)
    hits = [number for number, turn in enumerate(turns) if turn["ended"] == "contact"]
    # as in `scene.rollout.decisive`: the first that hits, else the one that came nearest
    decisive = hits[0] if hits else gaps.index(nearest) if nearest is not None else None
    return [
        {
            "opponent": turn["opponent"],
            "begin": turn["begin_s"],
            "end": turn["end_s"],
            "ended": _ENDED.get(turn["ended"], str(turn["ended"]).replace("_", " ")),
            "outcome": OUTCOMES.get(turn["outcome"], turn["outcome"]),
            "hit": turn["ended"] == "contact",
            "speed": turn["hit_speed_mps"],
            "gap": turn["metrics"].get("min_gap"),
            "ttc": turn["metrics"].get("ttc_min"),
            "decisive": number == decisive,
        }
        for number, turn in enumerate(turns)
    ]
