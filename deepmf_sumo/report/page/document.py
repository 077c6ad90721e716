"""A result folder -> ``report.html``."""

import json
from collections.abc import Iterable, Iterator
from importlib import resources
from pathlib import Path
from typing import Any, Final

from deepmf_sumo import files
from deepmf_sumo.benchmark import stored
from deepmf_sumo.errors import UsageError, WeightsError
from deepmf_sumo.report.page.places import ELEMENTS
from deepmf_sumo.report.page.roads import Roads
from deepmf_sumo.report.page.rows import COLUMNS, SPEED_KINDS
from deepmf_sumo.report.page.run_pages import RunPage, run_page
from deepmf_sumo.report.table import SECTORS

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
