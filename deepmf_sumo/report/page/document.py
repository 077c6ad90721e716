"""A result folder -> ``report.html``."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from deepmf_sumo import files
from deepmf_sumo.datatypes import Floats, RoadMap
from deepmf_sumo.errors import UsageError, WeightsError
from deepmf_sumo.metrics.collision import ACCIDENT_TYPES
from deepmf_sumo.report.page.replay import main_places, packed, reasons, replay
from deepmf_sumo.report.page.roads import ELEMENTS, Roads, element
from deepmf_sumo.report.table import OUTCOMES, SECTORS
from deepmf_sumo.results import stored
from deepmf_sumo.results.reader import Run
from deepmf_sumo.results.result import Result, first_contact

COLUMNS: Final = (
    "run", "status", "outcome", "method", "planner", "scene", "part", "seed", "time_s", "speed_mps",
    "delta_v_mps", "sector", "accident", "element", "edge", "turn", "speed", "min_ttc_s",
    "min_gap_m", "avoidable", "opponent", "score", "note",
)  # fmt: skip
SPEEDS_MPS: Final = (2.0, 5.0, 10.0)
"""Bounds between the kinds of speed."""
SPEED_KINDS: Final = (
    *(f"{low:g} to {high:g} m/s" for low, high in pairwise((0.0, *SPEEDS_MPS))),
    f"{SPEEDS_MPS[-1]:g} m/s and more",
)


def row(table: Mapping[str, str], result: Result | None, element: str, note: str) -> list[Any]:
    """Values in the order of `COLUMNS`, null where there is none.

    Args:
        table: the row of ``runs.csv``, and of ``moments.csv`` where there is one.
        result: the content of ``result.json``; None where it is not there.
        element: of the road, where the AV was hit; else empty.
        note: why the run has no result, or cannot be replayed.
    """
    found: Any = result or {}
    outcome = found.get("outcome") or table.get("outcome") or None
    contact = (first_contact(found) if outcome else None) or {}
    hit = bool(contact) and str(outcome).startswith("av")
    metrics = found.get("metrics", {})
    speed = contact.get("relative_mps")
    known = {
        "run": table["run_id"],
        "status": table["status"],
        "outcome": OUTCOMES.get(str(outcome), outcome),
        "method": table.get("method") or table["spec"],
        "planner": table.get("planner_label") or table["planner"],
        "scene": table["scene"],
        "part": table.get("part") or None,
        "seed": int(table["seed"]) if table.get("seed") else None,
        "time_s": contact.get("time_s"),
        "speed_mps": speed,
        "delta_v_mps": contact.get("delta_v_mps"),
        "sector": SECTORS[contact["sector"]] if hit else None,
        "accident": _accident(_metric(metrics, "accident_type")),
        "element": element or None,
        "edge": _edge(table),
        "turn": table.get("turn") or None,
        "speed": speed_kind(speed) if hit else None,
        "min_ttc_s": _metric(metrics, "ttc_min"),
        "min_gap_m": _metric(metrics, "min_gap"),
        "avoidable": _metric(metrics, "avoidable"),
        "opponent": found.get("opponent") or None,
        "score": found.get("opponent_score"),
        "note": note or None,
    }
    return [_short(known[name]) for name in COLUMNS]


def speed_kind(speed_mps: float | None) -> str | None:
    """Name of the band that a contact's relative speed lies in."""
    if speed_mps is None:
        return None
    return SPEED_KINDS[int(np.searchsorted(SPEEDS_MPS, speed_mps, side="right"))]


def _accident(number: float | None) -> str | None:
    if number is None:
        return None
    name = ACCIDENT_TYPES[int(number)]
    return "T-bone" if name == "t_bone" else name.replace("_", " ")


def _edge(table: Mapping[str, str]) -> str | None:
    """With the street's name, where the network has one."""
    edge, street = table.get("edge"), table.get("street")
    return f"{street} ({edge})" if street else edge or None


def _metric(metrics: Mapping[str, Any], name: str) -> float | None:
    value: float | None = metrics.get(name, {}).get("value")
    return value


def _short(value: Any) -> Any:
    return round(value, 3) if isinstance(value, float) else value


_LOG_LINES: Final = 40
_FACTS: Final = (
    "weights", "seed", "version", "adversary", "settings", "budget", "plans", "rules", "ended",
    "error", "expectations_broken",
)  # fmt: skip
"""Of ``result.json``, as it is."""
_ENDED: Final = {"too_long": "longest time of a turn", "time": "end of the run"}
"""Of `datatypes.turn` what does not say by itself what it is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunPage:
    """One run of the page.

    Attributes:
        row: in the order of `document.COLUMNS`.
        details: `replay.packed`.
        weights: name of the weights that it used, if known.
        missing: why it cannot be replayed; empty where it can, or where it has no result at all.
    """

    row: list[Any]
    details: str
    weights: str | None
    missing: str


def run_page(out: Path, table: Mapping[str, str], roads: Roads) -> RunPage:
    """Read a run; what cannot be read is left out, and the page says so."""
    run = Run.of_row(out, table)
    result, missing = _result(run)
    shown: dict[str, Any] = {}
    place = ""
    if result and table["status"] == "ok":
        try:
            shown, place = _shown(run, roads, result.get("turns") or [])
        except stored.DAMAGE as error:
            missing = f"cannot be replayed: {type(error).__name__}: {error}"
    note = "; ".join(part for part in (table.get("error", ""), missing, *_broken(result)) if part)
    return RunPage(
        row=row(table, result, place, note),
        details=packed({**_facts(run.folder, result), **shown, "missing": missing}),
        weights=result.get("weights") if result else None,
        missing=missing,
    )


def _result(run: Run) -> tuple[Result | None, str]:
    if not (run.folder / "result.json").exists():
        return None, "" if run.status == "skipped" else "result.json is missing"
    try:
        return run.result, ""
    except UsageError as error:
        return None, f"cannot be shown: {error}".replace(f"{run.folder}/", "")


def _broken(result: Result | None) -> list[str]:
    broken = result["expectations_broken"] if result else []
    return [f"expectation broken: {one}" for one in broken]


def _shown(
    run: Run, roads: Roads, turns: Sequence[Mapping[str, Any]]
) -> tuple[dict[str, Any], str]:
    """What is drawn of a run, and the element of the road on which the AV was hit."""
    rollout = run.rollout
    places = main_places(rollout)
    number, road, note = roads.add(run, places)
    origin = np.rint(places[0])
    shown = {
        "replay": replay(rollout, origin, turns),
        "reasons": reasons(run.folder / "plans.npz", origin),
        "road": number,
        "road_note": note,
        "gui": (run.folder / "sumo" / "replay.sumocfg").is_file(),
    }
    return shown, _element(run, road)


def _element(run: Run, road: RoadMap | None) -> str:
    if run.contact is None or road is None:
        return ""
    pose: Floats = run.contact.pose_first
    return element(road, pose[:2], float(pose[2]))


def _facts(folder: Path, result: Result | None) -> dict[str, Any]:
    found: Any = result or {}
    metrics = found.get("metrics", {})
    return {
        **{name: found[name] for name in _FACTS if name in found},
        "metrics": {
            name: [value["value"], value.get("unit", ""), value.get("reason", "")]
            for name, value in metrics.items()
        },
        "events": [
            [event["step"], event["agent_id"], event["kind"], event.get("detail", "")]
            for event in found.get("events", [])
        ],
        "turns": _turns(found),
        "repairs": found.get("repairs", []),
        "spec": _text(folder / "spec.yaml"),
        "log": _text(folder / "log.txt", last=_LOG_LINES),
    }


def _turns(result: Result) -> list[dict[str, Any]]:
    """Who attacked when and how it went, where opponents took turns."""
    turns: list[dict[str, Any]] = result.get("turns") or []
    gaps = [turn["metrics"].get("min_gap") for turn in turns]
    nearest = min((gap for gap in gaps if gap is not None), default=None)
    hits = [number for number, turn in enumerate(turns) if turn["ended"] == "contact"]
    # as `datatypes.rollout.decisive`: the first that hits, else the one that came nearest
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


def _text(file: Path, last: int | None = None) -> str:
    if not file.is_file():
        return ""
    lines = file.read_text("utf-8", errors="replace").splitlines()
    return "\n".join(lines[-last:] if last else lines)


_SCRIPTS: Final = (
    "packing", "statistics", "elements", "table", "totals", "groups", "scene", "turns", "map",
    "charts", "layers", "moment", "player", "facts", "details", "start",
)  # fmt: skip
"""In the order in which they are joined."""


def write(out: Path) -> Path:
    """Write ``out/report.html``: one page with all runs, which needs no other file and no network.

    The same runs give the same page. Runs that cannot be read or replayed are in the table with the
    reason. Raises UsageError where ``out`` is no result folder, OutputError where it cannot be
    written.
    """
    table, manifest = _table(out), _json(out / stored.MANIFEST)
    roads = Roads()
    pages = [run_page(out, row, roads) for row in table]
    content = {
        "title": out.resolve().name,
        "columns": COLUMNS,
        "rows": [page.row for page in pages],
        "missing": sum(bool(page.missing) for page in pages),
        "interrupted": bool(_json(out / "summary.json").get("interrupted")),
        "manifest": {name: manifest.get(name) for name in ("version", "packages", "machine")},
        "weights": {name: _licences(name) for name in _weights(pages)},
        "orders": {"sector": SECTORS, "element": ELEMENTS, "speed": SPEED_KINDS},
    }
    page = _joined(content, [page.details for page in pages], roads.packed())
    with files.writing(out):
        files.write(out / "report.html", page)
    return out / "report.html"


def _table(out: Path) -> list[dict[str, str]]:
    """Rows of ``runs.csv``, with where the AV was where an attack chose moments by itself."""
    known = stored.moments_of(out)
    return [{**known.get(row["run_id"], {}), **row} for row in stored.rows_of(out)]


def _json(file: Path) -> dict[str, Any]:
    """Content of a file that the page can do without."""
    try:
        return stored.mapping(file)
    except UsageError:
        return {}


def _weights(pages: Iterable[RunPage]) -> list[str]:
    return sorted({page.weights for page in pages if page.weights})


def _licences(name: str) -> list[list[str]] | str:
    """Network, licence and day of training of each of a set's networks; or why not known."""
    from deepmf_sumo.predictors import weights  # brings torch along

    try:
        folder = weights.find(name)
        cards = {name: weights.read_card(folder, name) for name in weights.listed(folder)}
    except WeightsError as error:
        return str(error)
    return [
        [network, str(card.get("licence") or "not stated"), str(card.get("trained", ""))]
        for network, card in cards.items()
    ]


def _joined(content: dict[str, Any], details: list[str], roads: list[str]) -> str:
    assets = resources.files("deepmf_sumo.report.page") / "assets"

    def asset(name: str) -> str:
        return (assets / name).read_text("utf-8")

    data = "\n".join(
        (*_stored("run", details), *_stored("road", roads), _script("content", _safe(content)))
    )
    script = "\n".join(asset(f"{name}.js") for name in _SCRIPTS)
    parts = {"style": asset("page.css") + asset("run.css"), "data": data, "script": script}
    page = asset("page.html")
    for name, text in parts.items():
        page = page.replace(f"<!-- {name} -->", text, 1)
    return page


def _stored(kind: str, texts: list[str]) -> Iterator[str]:
    return (_script(f"{kind}-{number}", text) for number, text in enumerate(texts))


def _script(name: str, text: str) -> str:
    """An element that browsers keep as text, and do not run."""
    return f'<script type="text/plain" id="{name}">{text}</script>'


def _safe(values: Any) -> str:
    """JSON that cannot end the element that it stands in."""
    text = json.dumps(values, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.replace("<", "\\u003c")
