"""``report.html`` of a result folder, and the page of a risk map: each needs no other file."""

import json
from collections.abc import Iterable, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Final

from deepmf_sumo import files
from deepmf_sumo.errors import UsageError, WeightsError
from deepmf_sumo.report import failures as words
from deepmf_sumo.report.map_layers import LAYERS
from deepmf_sumo.report.page import maps
from deepmf_sumo.report.page.columns import RUN_COLUMNS, SPEED_CLASSES
from deepmf_sumo.report.page.replay import packed
from deepmf_sumo.report.page.roads import ELEMENTS, PageRoads
from deepmf_sumo.report.page.runs import RunPage, run_page
from deepmf_sumo.report.palette import SCORES
from deepmf_sumo.report.table import SECTORS
from deepmf_sumo.results import risk, sessions, stored
from deepmf_sumo.results.groups import FailureGroup, grouped
from deepmf_sumo.results.risk import Network, PlaceRow
from deepmf_sumo.spec.profiles import described, headline

_SCRIPTS: Final = (
    "packing", "statistics", "elements", "table", "runs", "totals", "groups", "camera", "scene",
    "turns", "canvas", "charts", "layers", "moment", "player", "failures", "facts", "details",
    "places", "kinds", "map", "start",
)  # fmt: skip
"""In the order in which they are joined."""


def write(out: Path) -> Path:
    """Write ``out/report.html``: one page with all runs, which needs no other file and no network.

    Where a SUMO network was attacked, the page has a risk map, too. The same runs give the same
    page. Runs that cannot be read or replayed are in the table with the reason. Raises UsageError
    where ``out`` is not a result folder, OutputError where it cannot be written.
    """
    table, manifest = _table(out), _json(out / stored.MANIFEST)
    roads = PageRoads()
    pages = [run_page(out, row, roads) for row in table]
    groups = grouped([page.failure for page in pages if page.failure], len(pages))
    networks, without_map = _networks(out, pages)
    content = {
        "title": out.resolve().name,
        "rows": [page.row for page in pages],
        "causes": words.summary(groups),
        "failures": _failures(pages, groups),
        "maps": [network.name for network in networks],
        "withoutMap": without_map,
        "switchedOff": sessions.switched_off(out),
        "missing": sum(bool(page.missing) for page in pages),
        "profile": headline(
            described(row.get("profile", ""), row.get("constraints", "").split()) for row in table
        ),
        "interrupted": bool(_json(out / stored.SUMMARY).get("interrupted")),
        "manifest": {name: manifest.get(name) for name in ("version", "packages", "machine")},
        "weights": {name: _licences(name) for name in _weights(pages)},
        "orders": {"sector": SECTORS, "element": ELEMENTS, "speed": SPEED_CLASSES},
    }
    texts = {
        "run": [page.details for page in pages],
        "road": roads.packed(),
        "map": [packed(maps.content(network, risk.rows(network))) for network in networks],
    }
    with files.writing(out):
        files.write(out / "report.html", _joined(content, texts))
    return out / "report.html"


def map_page(network: Network, rows: Sequence[PlaceRow], title: str) -> str:
    """A page with a risk map alone. The same rows give the same page."""
    content = {"title": title, "maps": [network.name]}
    return _joined(content, {"map": [packed(maps.content(network, rows))]})


def _failures(pages: Sequence[RunPage], groups: Sequence[FailureGroup]) -> list[dict[str, Any]]:
    """Groups of failures, the worst first, with the numbers of their runs, the example first."""
    number = {page.failure.run.run_id: place for place, page in enumerate(pages) if page.failure}
    return [
        {
            "title": words.title(group.example),
            "sentence": words.sentence(group),
            "facts": words.facts(group),
            "of": group.of,
            "runs": [number[one.run.run_id] for one in group.failures],
            "replay": group.example.kind == "hit",
            "apart": group.kind == "no finding",
        }
        for group in groups
    ]


def _networks(out: Path, pages: Iterable[RunPage]) -> tuple[list[Network], str]:
    """The networks with attacks; why there is no map although a network was attacked."""
    if not any(page.network for page in pages):
        return [], ""
    try:
        return risk.read([out]), ""
    except stored.DAMAGE as error:
        return [], f"{error}"


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
    from deepmf_sumo.deepmf.networks import weights

    try:
        folder = weights.find(name)
        cards = {name: weights.read_card(folder, name) for name in weights.listed(folder)}
    except WeightsError as error:
        return str(error)
    return [
        [network, str(card.get("licence") or "not stated"), str(card.get("trained", ""))]
        for network, card in cards.items()
    ]


def _joined(content: dict[str, Any], texts: dict[str, list[str]]) -> str:
    """The document; ``texts`` are unpacked only when the page shows them."""
    columns = [column.as_json() for column in RUN_COLUMNS]
    layers = [
        [one.name, one.of, bool(one.fill), one.edge_pt * bool(one.edge), one.words]
        for one in LAYERS
    ]
    content = {"columns": columns, "rows": [], "scores": SCORES, "layers": layers, **content}
    assets = resources.files("deepmf_sumo.report.page") / "assets"

    def asset(name: str) -> str:
        return (assets / name).read_text("utf-8")

    stored_texts = [
        _script(f"{kind}-{number}", text)
        for kind, of_kind in texts.items()
        for number, text in enumerate(of_kind)
    ]
    parts = {
        "style": "".join((*map(asset, ("page.css", "run.css", "map.css")), _map_colours())),
        "data": "\n".join((*stored_texts, _script("content", _safe(content)))),
        "script": "\n".join(asset(f"{name}.js") for name in _SCRIPTS),
    }
    page = asset("page.html")
    for name, text in parts.items():
        page = page.replace(f"<!-- {name} -->", text, 1)
    return page


def _map_colours() -> str:
    """Style sheet with the colours of maps, ``--map-NAME`` and ``--map-NAME-edge``."""

    def shades(number: int) -> str:
        colours = {f"map-{one.name}": one.fill for one in LAYERS}
        colours |= {f"map-{one.name}-edge": one.edge for one in LAYERS}
        return "".join(f"--{name}:{one[number]};" for name, one in colours.items() if one)

    dark = shades(1)
    return (
        f":root{{{shades(0)}}}\n"
        f':root[data-theme="dark"]{{{dark}}}\n'
        "@media (prefers-color-scheme: dark)"
        f'{{:root:not([data-theme="light"]){{{dark}}}}}\n'
    )


def _script(name: str, text: str) -> str:
    """An element that browsers keep as text, and do not run."""
    return f'<script type="text/plain" id="{name}">{text}</script>'


def _safe(values: Any) -> str:
    """JSON that cannot end the element that it stands in."""
    text = json.dumps(values, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.replace("<", "\\u003c")
