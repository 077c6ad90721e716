"""What is known of one run: the content of ``result.json``, and its row in ``runs.csv``.

All values that differ between two equal runs are under ``timings``.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any, Final, Literal, Required, TypedDict

import numpy as np

from deepmf_sumo import plugins, tables
from deepmf_sumo.errors import PlannerFault
from deepmf_sumo.judge.avoidability.counterfactual import (
    unrepeated_m,
)
from deepmf_sumo.judge.causes import cause_of
from deepmf_sumo.judge.ladder import RUNGS, verdict
from deepmf_sumo.judge.metrics import Episode, NotMeasurable, naturalness
from deepmf_sumo.results.turns import compared_with, decisive_part, hits
from deepmf_sumo.scene import (
    Attack,
    Case,
    Contact,
    ConversionReport,
    Event,
    MadeRoadUser,
    MetricValue,
    RecordedCase,
    Rollout,
    Support,
    Trial,
)
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.spec import VERSIONS, FromNetwork, profiles
from deepmf_sumo.spec.tasks import Label, Task

Status = Literal["ok", "failed", "timeout", "skipped"]


class ContactValues(TypedDict, total=False):
    """A contact, see `scene.Contact`.

    Attributes:
        kind: ``av_opponent``, ``av_other``, ``opponent_other`` or ``supporter_other``.
        striker_id: the vehicle that moved faster towards the other one.
        time_s: since the simulation took over.
        relative_mps: length of the difference of the velocities at the step before.
        closing_mps: speed at which the centres approached.
        delta_v_mps: change of the AV's velocity in a plastic impact.
        sector: where the first vehicle was hit, 0 (front) to 7, counter-clockwise.
        pose_first, pose_second: x, y and heading at the contact.
    """

    kind: str
    first_id: str
    second_id: str
    striker_id: str
    step: int
    time_s: float
    relative_mps: float
    closing_mps: float
    delta_v_mps: float
    sector: int
    pose_first: list[float]
    pose_second: list[float]


class MetricValues(TypedDict):
    """A metric, see `scene.MetricValue`.

    Attributes:
        value: None where it is not defined.
        better: which values are better for the attacker.
        reason: why there is no value.
    """

    value: float | None
    unit: str
    better: str
    reason: str


class Result(TypedDict, total=False):
    """The content of ``result.json``, see docs/reference/results-folder.md.

    Keys from ``outcome`` on are those of successful runs. `stored.result_of` checks the shape of
    what it reads; results of earlier versions may lack keys that are not required.

    Attributes:
        key: digest of the spec, the version and the input files; ``--resume`` compares it.
        network: the configuration; None for recordings.
        parameters: of the planner's car-following model.
        version: the paper's name for the period between plans.
        method: its name, in a plan the plan's. planner_label: the planner's name in tables.
        base_method: the method without the budget.
        part: of a plan: ``main``, ``budgets`` or ``figures``.
        profile: the kind of attack (`spec.profiles`); empty of an adversary that knows none.
        constraints: what held for every candidate of the opponent.
        settings: of planner and adversary, with all defaults.
        setup: the spec of this run alone, of files the names alone.
        inputs: digests of what the run reads: ``source``, ``weights``, ``planner``,
            ``adversary``, ``others`` (code of metrics and readers that is not of this package).
        draw: how its moment was drawn (`spec.tasks.Draw`); missing where all moments are spread.
        error: why the run failed.
        planner_fault: of a run that failed, what the planner did wrong: ``crashed``, ``hung`` or
            ``nonsense``; empty where it is not the planner's.
        refused: a record that cannot be used.
        expectations_broken: sentences of the spec's ``expect``.
        timings: wall times; the only values that differ between equal runs.
        outcome: ``av_opponent`` (a hit), else the earliest other contact, else ``none``.
        ended: ``contact``, ``time`` or ``av_gone``; of a turn or a live attack also ``other_hit``,
            ``out_of_reach``, ``gone``, ``too_long``, ``plan_ended`` or ``harmless``.
        steps: simulated steps. duration_steps: the steps that the spec asks for.
        counterfactual: what tells where the opponent would have been without the attack: ``log``
            (the recording), ``episode`` (the same episode without attack), or ``lane`` (it keeps
            lane and speed, where the episode cannot be repeated). None without an opponent, and in
            results of earlier versions.
        opponent_score: softmax of the scores.
        metrics: by name.
        finding: of a hit, its rung and what decided (`judge.ladder.Verdict`); None for a miss.
        cause: of a finding, the smallest change of the AV that avoids it (`judge.causes.Cause`);
            None for other hits and misses.
        samples: the opponent's accelerations, for pooled naturalness.
        plans: their number.
        rules: of all plans: the rule that chose, or why there is no attack.
        search: simulated episodes, and each trial of a search or of several tries; ``tries``: of
            those for a finding, what each was: ``miss`` or the rung of its hit.
        conversion: what was lost when a recording became a network.
        repairs: of the recorded scene.
        turns: the attack of each vehicle, where several attack together or in turn.
        support: of each plan of an attack with ``supporting``, its first step, the supporter and
            what it blocks (`scene.plan.Support`); missing of other attacks.
        made: people who are not in the demand, see `scene.MadeRoadUser`; missing where nobody was
            made.
    """

    run_id: Required[str]
    key: Required[str]
    spec: Required[str]
    scene: Required[str]
    network: Required[str | None]
    planner: Required[str]
    perception: str | None
    parameters: str | None
    adversary: Required[str]
    version: str | None
    profile: str
    constraints: list[str]
    method: Required[str]
    planner_label: Required[str]
    base_method: Required[str]
    part: Required[str]
    budget: Required[dict[str, Any]]
    weights: Required[str | None]
    seed: Required[int]
    settings: Required[dict[str, Any]]
    setup: dict[str, Any]
    inputs: dict[str, str]
    draw: dict[str, Any]
    status: Required[Status]
    error: Required[str]
    planner_fault: str
    refused: bool
    expectations_broken: list[str]
    timings: Required[dict[str, Any]]

    outcome: str
    ended: str
    steps: int
    duration_steps: int
    opponent: str | None
    counterfactual: str | None
    opponent_score: float | None
    contacts: list[ContactValues]
    events: list[dict[str, Any]]
    metrics: dict[str, MetricValues]
    finding: dict[str, Any] | None
    cause: dict[str, Any] | None
    plain: dict[str, MetricValues]
    samples: dict[str, Any] | None
    plans: int
    rules: list[str]
    search: dict[str, Any]
    conversion: dict[str, Any] | None
    repairs: list[str]
    turns: list[dict[str, Any]] | None
    support: list[dict[str, Any]]
    made: list[dict[str, Any]]


COLUMNS: Final = (
    "run_id",
    "spec",
    "scene",
    "planner",
    "perception",
    "adversary",
    "version",
    "seed",
    "status",
    "outcome",
    "contact_time_s",
    "contact_speed_mps",
    "impact_sector",
    "opponent",
    "opponent_score",
    "feasible",
    "on_road",
    "generation_s",
    "cycle_ms_median",
    "simulation_s",
    "error",
    "method",
    "planner_label",
    "parameters",
    "part",
    "budget_simulations",
    "budget_seconds",
    "simulations",
    "turns",
    "turn_hits",
    "profile",
    "constraints",
)
_LOOKED_FOR: Final = "finding"
UNREPEATED: Final = "not_repeatable"
"""Kind of the event that says that two equal episodes of the planner differ."""
"""Trials that have this value looked for findings."""
IDENTITY: Final = ("spec", "scene", "network", "seed", "method", "planner_label", "part")
TIMINGS: Final = ("generation_s", "cycle_ms_median", "simulation_s")
"""Columns that differ between equal runs."""


def unfinished(
    task: Task,
    status: Status,
    error: str,
    wall_s: float = 0.0,
    fault: PlannerFault | Literal[""] = "",
) -> Result:
    """The result of a run without one, and the reason; ``fault``: what the planner did wrong."""
    said = error.encode("utf-8", "backslashreplace").decode()  # a file's name need not be UTF-8
    return {
        **_identity(task, status, " ".join(said.split())),
        "planner_fault": fault,
        "timings": {"wall_s": wall_s},
    }


def finished(
    task: Task,
    case: Case,
    attack: Attack,
    metrics: list[MetricValue],
    wall_s: float,
    by_turn: list[dict[str, Any]] | None = None,
    decided: Episode | None = None,
) -> Result:
    """The result of a successful run.

    ``metrics`` are of the decisive turn where several vehicles attack, ``by_turn`` of all turns.
    ``decided``: the decisive part with what is known of it already.
    """
    rollout = attack.rollout
    decisive = decisive_part(rollout, case)
    decided = decided or Episode(*decisive)
    told = verdict(decided)
    result: Result = {
        **_identity(task, "ok"),
        "outcome": rollout.outcome,
        "ended": rollout.ended,
        "steps": rollout.tracks.steps - 1 - rollout.now,
        "duration_steps": case.duration_steps,
        "opponent": rollout.opponent_id,
        "counterfactual": compared_with(*decisive),
        "opponent_score": _opponent_score(decisive[0], task.spec.adversary.settings),
        "contacts": [_contact(contact, rollout) for contact in rollout.contacts],
        "events": [*map(asdict, rollout.events), *_unrepeated(rollout, case)],
        "metrics": values_of(metrics),
        "finding": None if told is None else asdict(told),
        "cause": _cause(decided),
        "plain": {},
        "samples": _samples(*decisive),
        "plans": len(rollout.plans),
        "rules": [plan.reason.rule for plan in rollout.plans if plan.reason],
        "search": {
            "simulations": attack.simulations,
            "trials": [asdict(trial) for trial in attack.trials],
            "tries": [_tried(trial) for trial in attack.trials if _LOOKED_FOR in trial.values],
            "out_of_time": attack.out_of_time,
        },
        "conversion": _conversion(_report(case)),
        "repairs": list(case.scene.repairs) if isinstance(case, RecordedCase) else [],
        "timings": _timings(attack, case, wall_s),
    }
    if by_turn is not None:
        result["turns"] = by_turn
    if support := _support(rollout):
        result["support"] = support
    if case.made:
        result["made"] = [_made(one) for one in case.made]
    return result


def _support(rollout: Rollout) -> list[dict[str, Any]]:
    """Of each plan who supports it, or why nobody does; also of policies without reasons."""
    told = {plan.first_step: plan.reason.support for plan in rollout.plans if plan.reason}
    for plan in rollout.plans:
        if plan.supports is not None and told.get(plan.first_step) is None:
            told[plan.first_step] = Support(agent_id=plan.agent_id)
    return [
        {"step": first - rollout.now, **asdict(support)}
        for first, support in sorted(told.items())
        if support is not None
    ]


def _made(one: MadeRoadUser) -> dict[str, Any]:
    """Somebody who was made, in the words of ``source.people.given``, and the id."""
    return {
        "id": one.id,
        "road_user": one.road_user,
        "place": one.place,
        "position_m": one.position_m.tolist(),
        "heading_rad": one.heading_rad,
        "speed_mps": one.speed_mps,
        "way_m": [] if one.way_m is None else one.way_m.tolist(),
    }


def _unrepeated(rollout: Rollout, case: Case) -> list[dict[str, Any]]:
    """That the planner did not do again what it did without the attack: an event, and how far."""
    found = unrepeated_m(rollout, case)
    if found is None:
        return []
    step, away_m = found
    detail = f"{away_m:.2g} m from where it drove without the attack, when all else was the same"
    event = Event(step=step, agent_id=rollout.av_id, kind=UNREPEATED, detail=detail)
    return [{**asdict(event), "away_m": away_m if math.isfinite(away_m) else None}]


def unrepeated(results: Iterable[Mapping[str, Any]]) -> list[float]:
    """How far the AV was, in each run whose planner did not do what it did without the attack."""
    events = (one for result in results for one in result.get("events", ()))
    return [one.get("away_m") or 0.0 for one in events if one["kind"] == UNREPEATED]


def _cause(episode: Episode) -> dict[str, Any] | None:
    """The cause of a finding."""
    told = verdict(episode)
    cause = cause_of(episode) if told is not None and told.finding else None
    return None if cause is None else asdict(cause)


def row(result: Result) -> dict[str, str]:
    """The run's row in ``runs.csv``; unknown values are empty."""
    return {key: tables.cell(value) for key, value in known_of(result).items()}


def known_of(result: Result) -> dict[str, Any]:
    """By column of ``runs.csv``; None for what is not known."""
    contact = first_contact(result) or {}
    metrics, timings = result.get("metrics", {}), result["timings"]
    by_turn = result.get("turns")
    known: dict[str, Any] = {
        **{key: result.get(key) for key in COLUMNS},
        "contact_time_s": contact.get("time_s"),
        "contact_speed_mps": contact.get("relative_mps"),
        "impact_sector": contact.get("sector"),
        **{key: metrics[key]["value"] for key in ("feasible", "on_road") if key in metrics},
        **{f"budget_{name}": value for name, value in result["budget"].items()},
        "simulations": result.get("search", {}).get("simulations"),
        **{key: timings.get(key) for key in TIMINGS},
        "turns": None if by_turn is None else len(by_turn),
        "turn_hits": None if by_turn is None else hits(by_turn),
        "constraints": " ".join(result.get("constraints", ())),
    }
    return {key: known[key] for key in COLUMNS}


def profile(result: Result) -> str:
    """The kind of attack that was meant, and its constraints.

    Empty where the adversary knows no profiles, or that version of the program knew none.
    """
    return profiles.described(result.get("profile", ""), result.get("constraints", ()))


def attacked(result: Result) -> bool:
    """Whether the run succeeded and there was a vehicle to attack with."""
    return bool(result["status"] == "ok" and result["opponent"] is not None)


def first_contact(result: Result) -> ContactValues | None:
    """The contact that the outcome names."""
    contacts = result.get("contacts", [])
    return next((one for one in contacts if one["kind"] == result["outcome"]), None)


def av_contacts(result: Result) -> list[ContactValues]:
    """Contacts of the AV with any road user, in the order of time."""
    return [one for one in result["contacts"] if one["kind"] in {"av_opponent", "av_other"}]


def not_finite(values: Any, name: str = "") -> str | None:
    """Dotted name of the first number that is NaN or infinite; None if all are finite."""
    if isinstance(values, float):
        return None if math.isfinite(values) else name
    inside: Iterable[tuple[Any, Any]] = values.items() if isinstance(values, dict) else ()
    if isinstance(values, list | tuple):
        inside = enumerate(values)
    found = (not_finite(value, f"{name}.{key}" if name else str(key)) for key, value in inside)
    return next((one for one in found if one), None)


def _identity(task: Task, status: Status, error: str = "") -> Result:
    """What is known of a run however it ended; the caller adds its timings."""
    spec = task.spec
    planner = plugins.settings("planners", spec.planner.name, spec.planner.settings)
    adversary = plugins.settings("adversaries", spec.adversary.name, spec.adversary.settings)
    perception = getattr(planner, "perception", None)
    driver = f"{spec.planner.name} {perception}" if perception else spec.planner.name
    label, source = task.label or Label(method=spec.name, planner=driver), spec.source
    found: Result = {
        "run_id": task.run_id,
        "key": task.key,
        "status": status,
        "error": error,
        "timings": {},
        "spec": spec.name,
        "scene": task.scene,
        "network": source.network.stem if isinstance(source, FromNetwork) else None,
        "planner": spec.planner.name,
        "perception": perception,
        "parameters": getattr(planner, "parameters", None),
        "adversary": spec.adversary.name,
        "version": _version(adversary),
        "profile": spec.profile if profiles.applies_to(spec.adversary.name) else "",
        "constraints": sorted(set(getattr(adversary, "constrained", ())) - {"sector"}),
        "method": label.method,
        "planner_label": label.planner,
        "base_method": label.base or label.method,
        "part": label.part,
        "budget": spec.budget.model_dump(mode="json"),
        "weights": spec.weights,
        "seed": spec.seed,
        "settings": {
            "planner": planner.model_dump(mode="json"),
            "adversary": adversary.model_dump(mode="json"),
        },
        "setup": task.placeless(),
        "inputs": dict(task.inputs),
    }
    if task.draw:
        found["draw"] = asdict(task.draw)
    return found


def identity(task: Task) -> dict[str, Any]:
    """What the manifest says of a run: what tables and gates call it before it has a result."""
    known = _identity(task, "ok")
    return {name: known[name] for name in IDENTITY}


def _version(adversary: Any) -> str | None:
    """The paper's name for the period between plans."""
    if "period_s" not in type(adversary).model_fields:
        return None
    names = {period: name for name, period in VERSIONS.items()}
    return names.get(adversary.period_s, f"S{adversary.period_s}")


def _opponent_score(rollout: Rollout, settings: dict[str, Any]) -> float | None:
    """Probability from the head that chose the opponent, from the first plan that knows."""
    for plan in rollout.plans:
        scores = plan.reason.scores if plan.reason else None
        if scores and rollout.opponent_id in scores.ids:
            by_partner = settings.get("opponent") == "partner"
            logits = scores.partner_logits if by_partner else scores.logits
            logit = logits[scores.ids.index(rollout.opponent_id)]
            return float(1.0 / (1.0 + np.exp(-logit)))
    return None


def _contact(contact: Contact, rollout: Rollout) -> Any:
    values = asdict(contact)
    values["time_s"] = round((contact.step - rollout.now) * rollout.dt_s, 3)
    for name in ("pose_first", "pose_second"):
        values[name] = [float(value) for value in values[name]]
    return {name: _plain(value) for name, value in values.items()}


def _tried(trial: Trial) -> str:
    if "rung" in trial.values:
        return RUNGS[round(trial.values["rung"])]
    return "miss"


def _samples(rollout: Rollout, case: Case) -> dict[str, Any] | None:
    """What figures over many runs are made of; None if no vehicle was driven.

    ``opponent_m``: the opponent twice a second, in the frame of the AV's first pose.
    ``attack_mps2``, ``recorded_mps2``: see `metrics.naturalness.samples`, smooth; empty
    where they are not measurable.
    """
    tracks = rollout.tracks
    if rollout.opponent_id is None or rollout.opponent_id not in tracks.ids:
        return None
    row, av = tracks.row(rollout.opponent_id), tracks.row(rollout.av_id)
    there = tracks.valid[row, rollout.now :]
    path = tracks.position_m[row, rollout.now :][there][:: round(0.5 / rollout.dt_s)]
    origin, heading = tracks.position_m[av, rollout.now], tracks.heading_rad[av, rollout.now]
    try:
        changes = naturalness.samples(rollout, case, smooth=True)
    except NotMeasurable:
        changes = naturalness.AccelerationSamples(np.empty(0), np.empty(0))
    return {
        "opponent_m": np.round(frames.to_local(path, origin, float(heading)), 2).tolist(),
        "attack_mps2": np.round(changes.attack, 3).tolist(),
        "recorded_mps2": np.round(changes.unattacked, 3).tolist(),
    }


def values_of(metrics: Iterable[MetricValue]) -> dict[str, Any]:
    """Metrics by name, as in ``result.json``."""
    values = {value.name: asdict(value) for value in metrics}
    return {name: {key: one[key] for key in one if key != "name"} for name, one in values.items()}


def _report(case: Case) -> ConversionReport | None:
    return case.net.report if isinstance(case, RecordedCase) else None


def _conversion(report: ConversionReport | None) -> dict[str, Any] | None:
    if report is None:
        return None
    return {key: _plain(value) for key, value in asdict(report).items() if key != "seconds"}


def _timings(attack: Attack, case: Case, wall_s: float) -> dict[str, Any]:
    rollout = attack.rollout
    parts = [plan.reason.milliseconds for plan in rollout.plans if plan.reason]
    cycles = [float(sum(part.values())) for part in parts]
    report = _report(case)
    return {
        "wall_s": wall_s,
        "generation_s": float(attack.generation_s),
        "simulation_s": float(rollout.seconds.get("simulation", 0.0)),
        "cycle_ms_median": float(np.median(cycles)) if cycles else None,
        "episode_s": {part: float(value) for part, value in rollout.seconds.items()},
        "plans_ms": [{name: float(value) for name, value in part.items()} for part in parts],
        "conversion_s": report.seconds if report else None,
    }


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
