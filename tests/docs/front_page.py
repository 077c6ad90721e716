"""Make the pictures of README: ``python -m tests.docs.front_page [RESULTS]``, some minutes.

``docs/pictures/finding.webp`` is the packaged red-light runner, a finding, step by step: lights,
candidates of the plan that drives the opponent, the AV's predicted reactions to the chosen one, and
the contact. ``docs/pictures/risk_map.webp`` is the risk map of a packaged network, from attacks at
moments that are chosen, or from the result folder RESULTS of such a command; ``risk_page.webp``, in
docs/gallery.md, is the same map as a page in a browser.
"""

import csv
import subprocess
import sys
import tempfile
import textwrap
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from PIL import Image

import deepmf_sumo
from deepmf_sumo.report.drawing import Outline, ViewWindow, draw_boxes, draw_road, met_at, square
from deepmf_sumo.report.figures.episode import window_of
from deepmf_sumo.report.palette import (
    AV,
    CANDIDATE,
    OPPONENT,
    REACTION,
    RISK_CLASSES,
    STAR,
    UNSCORED,
    hexadecimal,
)
from deepmf_sumo.results.reader import Results, Run
from deepmf_sumo.scene import RoadMap, signals
from deepmf_sumo.scene.geometry.lane_map import width_m

from tests.docs import drawn
from tests.docs.browser import photograph
from tests.docs.drawn import PICTURES
from tests.docs.pages import ROOT

SPEC = ROOT / "scenarios" / "red_light_runner.yaml"
NETWORK = ROOT / "sumo_nets" / "four_way" / "four_way.sumocfg"
MOMENTS = 120

SIDE_IN, DPI = 6.4, 100
TITLE_IN = 0.5
MARGIN_M, NEAR_M, SMALL = 20.0, 240.0, 0.27
SCALE_M = 20.0
STEP_MS, HOLD_MS = 120, 2600
BACKGROUND = "#ffffff"
LIGHTS = {"red": "#d62728", "yellow": "#e0a800", "green": "#2ca02c"}
WORST = 3
PLAIN = {"fontsize": 12, "framealpha": 0.95}


@dataclass(frozen=True)
class Plans:
    """``plans.npz`` of a run: when each plan began, its candidates, and reactions to the chosen."""

    first: list[int]
    candidates: list[np.ndarray]
    chosen: list[np.ndarray]
    reactions: list[np.ndarray]

    @classmethod
    def read(cls, file: Path) -> "Plans":
        with np.load(file) as found:
            names = [f"{number:02}" for number in range(int(found["plans"]))]
            picked = [int(found[f"{name}/chosen"]) for name in names]
            pairs = list(zip(names, picked, strict=True))
            return cls(
                [int(found[f"{name}/first_step"]) for name in names],
                [found[f"{name}/candidate_position_m"] for name in names],
                [found[f"{name}/position_m"] for name in names],
                [found[f"{name}/reaction_position_m"][at] for name, at in pairs],
            )

    def at(self, step: int) -> tuple[int, int]:
        """The plan that drives at a step, and how much of it is driven."""
        number = max(k for k, first in enumerate(self.first) if first - 1 <= step)
        return number, step + 1 - self.first[number]


def canvas(width_in: float, height_in: float) -> Figure:
    figure = Figure(figsize=(width_in, height_in), dpi=DPI, facecolor=BACKGROUND)
    FigureCanvasAgg(figure)
    return figure


def pixels(figure: Figure) -> Image.Image:
    figure.canvas.draw()
    return Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3])


def title(figure: Figure, words: str) -> None:
    figure.text(0.5, 0.965, words, ha="center", va="center", fontsize=13)


def ground(axes: Axes, road: RoadMap, window: ViewWindow, inches: float) -> None:
    """The roads that the window shows."""
    draw_road(axes, road, window, inches)
    axes.set(xlim=(window.x0, window.x1), ylim=(window.y0, window.y1), aspect="equal")
    axes.set(xticks=[], yticks=[])


def signs(axes: Axes, window: ViewWindow) -> None:
    """A scale, and an arrow to the north."""
    unit, left, bottom = window.side_m / 100, window.x0, window.y0
    x, y = left + 3 * unit, bottom + 3 * unit
    axes.plot([x, x + SCALE_M], [y, y], color="black", lw=2, zorder=20)
    axes.text(x + SCALE_M / 2, y + unit, f"{SCALE_M:g} m", ha="center", fontsize=8, zorder=20)
    foot, head = (left + 4 * unit, window.y1 - 10 * unit), (left + 4 * unit, window.y1 - 3 * unit)
    tip = {"arrowstyle": "-|>", "color": "black"}
    axes.annotate("", head, foot, arrowprops=tip, zorder=20)
    axes.text(foot[0] + 1.5 * unit, foot[1] + 2 * unit, "N", fontsize=9, zorder=20)


def draw_step(run: Run, road: RoadMap, plans: Plans, step: int) -> Image.Image:
    """One frame."""
    rollout, contact, window = run.rollout, run.contact, window_of([run])
    figure = canvas(SIDE_IN, SIDE_IN + TITLE_IN)
    axes = figure.add_axes((0, 0, 1, SIDE_IN / (SIDE_IN + TITLE_IN)))
    ground(axes, road, window, SIDE_IN)
    signs(axes, window)
    lights(axes, run, road, step)
    vehicles(axes, run, window, step)
    said = f"{(step - rollout.now) * rollout.dt_s:.1f} s"
    if step == contact.step:
        met = met_at(rollout.tracks, contact)
        axes.plot(*met, marker="x", color="white", markersize=17, markeredgewidth=6, zorder=10)
        axes.plot(*met, marker="x", color="black", markersize=15, markeredgewidth=3, zorder=11)
        said = f"hit after {said} at {contact.relative_mps:.0f} m/s"
    else:
        intentions(axes, plans, step)
    title(figure, f"A car runs a red light: {said}")
    handles = list(key(met=step == contact.step))
    axes.legend(handles=handles, loc="lower right", fontsize=12, framealpha=0.95).set(zorder=30)
    return pixels(figure)


def intentions(axes: Axes, plans: Plans, step: int) -> None:
    """What is left of the plan that drives: candidates, the chosen one, reactions to it."""
    number, driven = plans.at(step)
    ways = (plans.candidates[number], CANDIDATE, 0.7), (plans.reactions[number], REACTION, 1.0)
    for positions, colour, width in ways:
        lines = LineCollection(list(positions[:, driven:]), colors=colour, linewidths=width)
        axes.add_collection(lines)
        lines.set(alpha=0.6, zorder=3)
    chosen = plans.chosen[number][driven:].T
    axes.plot(*chosen, color=OPPONENT, lw=2.4, ls=(0, (4, 1.5)), zorder=5)


def lights(axes: Axes, run: Run, road: RoadMap, step: int) -> None:
    """Stop lines in the colours of their lights."""
    rollout = run.rollout
    now = rollout.signals[max(step - rollout.now - 1, 0)]
    for name, state in now.items():
        lane, shade = road.lanes[name], signals.colour(state)
        if shade is not None and lane.previous:
            before = road.lanes[lane.previous[0]].centre_m
            ahead = before[-1] - before[-2]
            aside = np.array([-ahead[1], ahead[0]]) / np.hypot(*ahead) * width_m(lane) / 2
            line = np.stack([lane.centre_m[0] - aside, lane.centre_m[0] + aside])
            axes.plot(*line.T, color=LIGHTS[shade], lw=4, solid_capstyle="butt", zorder=5)


def vehicles(axes: Axes, run: Run, window: ViewWindow, step: int) -> None:
    """All vehicles at a step, and what AV and opponent have driven."""
    rollout, tracks = run.rollout, run.rollout.tracks
    colours = {tracks.row(rollout.av_id): AV, tracks.row(rollout.opponent_id): OPPONENT}
    for row, colour in colours.items():
        path = tracks.position_m[row, rollout.now : step + 1]
        axes.plot(*path.T, color=colour, lw=1.8, zorder=6)
    rows = [int(row) for row in np.flatnonzero(tracks.valid[:, step])]
    faces, places = [colours.get(row, UNSCORED) for row in rows], [(row, step) for row in rows]
    draw_boxes(axes, tracks, places, faces, window, Outline(edge="black", zorder=7, alpha=0.9))
    star = {"color": STAR, "markeredgecolor": "black", "markeredgewidth": 0.7}
    opponent = tracks.position_m[tracks.row(rollout.opponent_id), step]
    axes.plot(*opponent, marker="*", markersize=14, zorder=9, **star)


def key(*, met: bool) -> Iterator[Line2D | Patch]:
    """Of the legend; the contact is in it from the beginning, so that nothing moves."""
    yield Line2D([], [], color=AV, lw=6, label="AV, driven by SUMO's IDM")
    yield Line2D([], [], color=OPPONENT, lw=6, label="opponent, driven by DeepMF")
    yield Line2D([], [], color=CANDIDATE, lw=1, label="what it may do (candidates)")
    yield Line2D([], [], color=OPPONENT, lw=2.4, ls="--", label="what it chose")
    yield Line2D([], [], color=REACTION, lw=1, label="predicted reactions of the AV")
    mark = {"marker": "x", "markersize": 8, "markeredgewidth": 2}
    yield Line2D([], [], color="black", ls="", label="contact", alpha=1.0 if met else 0.25, **mark)


def animation(run: Run, path: Path) -> None:
    """An animated WebP of a run that ends with a contact."""
    road = run.road()[0]
    plans = Plans.read(run.folder / "plans.npz")
    steps = range(run.rollout.now, run.contact.step + 1)
    frames = [draw_step(run, road, plans, step) for step in steps]
    times = [STEP_MS] * (len(frames) - 1) + [HOLD_MS]
    more = {"save_all": True, "append_images": frames[1:], "duration": times, "loop": 0}
    frames[0].save(path, quality=75, method=6, **more)


def polygons(file: Path, kinds: set[str]) -> dict[str, tuple[str, np.ndarray]]:
    """Colours and corners, by id, of the places where a hit happened, as sumo-gui draws them."""
    found = {}
    for one in ET.parse(file).getroot().iter("poly"):
        if one.get("fill") == "1" and one.get("type").removeprefix("risk.") in kinds:
            corners = [[float(x) for x in pair.split(",")] for pair in one.get("shape").split()]
            colour = hexadecimal([int(part) for part in one.get("color").split(",")])
            found[one.get("id")] = colour, np.array(corners)
    return found


def worst(risk: Path, kinds: set[str]) -> list[dict[str, str]]:
    """Rows of places with a hit, first what is surely dangerous."""
    with (risk / "risk.csv").open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["counted"] == "decided"]
    rows = [row for row in rows if row["kind"] in kinds and int(row["hits"])]
    return sorted(rows, key=lambda row: -float(row["risk_hit_lo"]))


def around(shapes: list[np.ndarray]) -> ViewWindow:
    """A square with all shapes; if they are too far apart, that with most of their corners."""
    there = np.concatenate(shapes)
    begin, end = there.min(axis=0), there.max(axis=0)
    side_m = float((end - begin).max()) + MARGIN_M
    if side_m <= NEAR_M:
        return square((begin + end) / 2, side_m)
    inside = [(np.abs(there - corner).max(axis=1) < NEAR_M / 2).sum() for corner in there]
    return square(there[int(np.argmax(inside))], NEAR_M)


def risk_map(results: Results, path: Path) -> None:
    """The worst places, the whole network, and their names."""
    risk = results.folders[0] / "risk"
    road, drawn = results.runs[0].road()[0], risk / "polygons.add.xml"
    lanes = np.concatenate([lane.centre_m for lane in road.lanes.values()])
    (x0, y0), (x1, y1) = lanes.min(axis=0) - MARGIN_M, lanes.max(axis=0) + MARGIN_M
    found = polygons(drawn, {"movement", "edge"})
    colours, corners = zip(*found.values(), strict=True)
    names = tuple(
        f"risk.{one['kind']}.{one['place']}." for one in worst(risk, {"movement", "edge"})[:WORST]
    )
    shapes = [shape for name, (_, shape) in found.items() if name.startswith(names)]
    near, whole = around(shapes), ViewWindow(x0=x0, x1=x1, y0=y0, y1=y1)
    figure, high = canvas(SIDE_IN, SIDE_IN + TITLE_IN), SIDE_IN + TITLE_IN
    axes = figure.add_axes((0, 0, 1, SIDE_IN / high))
    inset = figure.add_axes(
        (1 - SMALL, (1 - SMALL) * SIDE_IN / high, SMALL, SMALL * SIDE_IN / high)
    )
    for one, window, inches in ((axes, near, SIDE_IN), (inset, whole, SMALL * SIDE_IN)):
        ground(one, road, window, inches)
        one.add_collection(PolyCollection(corners, facecolors=colours, zorder=4))
    signs(axes, near)
    frame = {"fill": False, "ec": "black", "lw": 1.2, "zorder": 15}
    inset.add_patch(Rectangle((near.x0, near.y0), near.side_m, near.side_m, **frame))
    hits = sum(run.hit for run in results.runs)
    title(figure, f"Risk map: {len(results.runs)} attacks, {hits} of them hit the AV")
    axes.legend(handles=list(classes()), loc="lower right", title="risk of a hit", **PLAIN)
    lines = ["worst places, hits of attacks:"]
    for row in worst(risk, {"movement", "edge"})[:WORST]:
        words = f"{row['title']}: {row['hits']} of {row['attacks']}"
        lines += textwrap.wrap(words, 27, initial_indent="- ", subsequent_indent="  ")
    box = {"fc": "white", "ec": "#cccccc", "boxstyle": "round"}
    place = {"transform": axes.transAxes, "fontsize": 12, "bbox": box}
    axes.text(0.02, 0.1, "\n".join(lines), zorder=30, **place)
    pixels(figure).save(path, quality=85, method=6)


def classes() -> Iterator[Patch]:
    """Of the legend of risks."""
    bounds = [*(bound for bound, _ in RISK_CLASSES), 1.0]
    for low, up, (_, colour) in zip(bounds, bounds[1:], RISK_CLASSES, strict=False):
        yield Patch(fc=hexadecimal(colour), label=f"{low:.0%} to {up:.0%}".replace("%", " %"))


def attacked(out: Path) -> Results:
    """Attacks on the network, with their risk map."""
    command = [sys.executable, "-m", "deepmf_sumo.cli.main", "attack", str(NETWORK)]
    command += ["--moments", str(MOMENTS), "--set", "adversary.version=S4"]
    command += ["--no-pictures", "--jobs", "2", "--out", str(out)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return Results.open(out)


def main() -> int:
    """Run, draw, and say how large the files are."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        runner = deepmf_sumo.run([SPEC], folder / "runner", pictures=False)
        animation(runner.runs[0], PICTURES / "finding.webp")
        given = [Results.open(Path(argument)) for argument in sys.argv[1:]]
        results = given[0] if given else attacked(folder / "four-way")
        risk_map(results, PICTURES / "risk_map.webp")
        drawn.keep("finding.webp", "risk_map.webp")
        page = results.folders[0] / "risk" / "risk.html"
        if photograph(page.resolve(), PICTURES / "risk_page.webp"):
            drawn.keep("risk_page.webp")
    for picture in ("finding.webp", "risk_map.webp"):
        print(picture, f"{(PICTURES / picture).stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
