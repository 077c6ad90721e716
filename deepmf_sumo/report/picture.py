"""One picture per run: the map, the paths driven, the chosen opponent, and the scores."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from deepmf_sumo.judge.conflict_types import ACROSS, Side
from deepmf_sumo.judge.hits import Hit, hit_of
from deepmf_sumo.judge.metrics import Episode
from deepmf_sumo.report.drawing import (
    SCORES,
    Outline,
    ViewWindow,
    draw_boxes,
    draw_road,
    met_at,
    square,
)
from deepmf_sumo.report.map_layers import LAYERS, features
from deepmf_sumo.report.palette import AV, CANDIDATE, HEAT, OPPONENT, REACTION, STAR, UNSCORED
from deepmf_sumo.report.table import OUTCOMES, SECTORS
from deepmf_sumo.scene import (
    Case,
    Contact,
    Floats,
    OpponentScores,
    Plan,
    RoadMap,
    Rollout,
    TrafficCase,
    View,
)
from deepmf_sumo.scene.road_users import road_user

OTHER, CONTACT = "#8d99a6", "#000000"
AXES_IN: Final = 7.4
"""Width of the map on paper, about."""
MARGIN_M: Final = 18.0
SMALLEST_M: Final = 60.0
LARGEST_M: Final = 160.0
"""Side of the picture of a contact; without a contact there is no such detail."""
WIDEST_M: Final = 260.0
FRAME_PX: Final = 480
FRAME_M: Final = 90.0
"""Side of the picture of a view."""
_HEIGHT_IN: Final = 9.8
_ROWS, _ROW_IN = 5, 0.18
"""Rows of the legend that have room in this height, and what each more takes."""
EVERY_STEPS: Final = 10
"""Boxes along a driven path: one a second."""


def draw(rollout: Rollout, case: Case, path: Path) -> None:
    """Write a PNG; the same rollout gives the same bytes."""
    figure = Figure(figsize=(8.0, _HEIGHT_IN), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    plan = _explained(rollout)
    contact = rollout.first(rollout.outcome)
    window = _window(rollout, plan, contact)
    draw_road(axes, case.road, window, AXES_IN)
    scores = plan.reason.scores if plan and plan.reason else None
    _others(axes, rollout, scores, window)
    if plan:
        _reasoning(axes, plan)
    _driven(axes, rollout, rollout.av_id, AV, window)
    if rollout.opponent_id:
        _driven(axes, rollout, rollout.opponent_id, OPPONENT, window)
    if contact:
        _contact(axes, rollout, contact, window)
    _finish(axes, window, _title(rollout, case, contact), north=isinstance(case, TrafficCase))
    handles = [*_handles(rollout, scores, plan), *_map_handles(case.road, window)]
    rows = -(-len(handles) // 2)
    figure.set_figheight(_HEIGHT_IN + _ROW_IN * max(rows - _ROWS, 0))
    # below the map: on it, it would hide road users
    figure.legend(handles=handles, loc="outside lower center", ncols=2, fontsize=8)
    figure.savefig(path, metadata={"Software": None})


def frame(view: View) -> NDArray[np.uint8]:
    """(480, 480, 3) picture of a view, the AV in its middle; x to the right, y up."""
    figure = Figure(figsize=(FRAME_PX / 100, FRAME_PX / 100), dpi=100)
    canvas: Any = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    tracks = view.history
    av = tracks.row(view.av_id)
    window = square(tracks.position_m[av, -1], FRAME_M)
    draw_road(axes, view.road, window, FRAME_PX / 100)
    now = tracks.steps - 1
    rows = [row for row in range(len(tracks.ids)) if tracks.valid[row, now]]
    colours = [AV if row == av else OTHER for row in rows]
    places = [(row, now) for row in rows]
    draw_boxes(axes, tracks, places, colours, window, Outline(edge="#59626d", zorder=4))
    axes.set(xlim=(window.x0, window.x1), ylim=(window.y0, window.y1))
    axes.axis("off")
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()


def _explained(rollout: Rollout) -> Plan | None:
    """The first plan that has reasons: the one that opens the attack."""
    return next((plan for plan in rollout.plans if plan.reason), None)


def _window(rollout: Rollout, plan: Plan | None, contact: Contact | None) -> ViewWindow:
    """A square around what the AV and the opponent did."""
    tracks = rollout.tracks
    chosen = [agent for agent in (rollout.av_id, rollout.opponent_id) if agent in tracks.ids]
    points = [_positions(rollout, agent) for agent in chosen if agent]
    if plan:
        points.append(plan.position_m[: rollout.tracks.steps])
    every = np.concatenate(points)
    low, high = every.min(axis=0) - MARGIN_M, every.max(axis=0) + MARGIN_M
    largest = LARGEST_M if contact else WIDEST_M
    side = float(np.clip((high - low).max(), SMALLEST_M, largest))
    centre = (low + high) / 2
    if (high - low).max() > largest:  # too far for one picture
        centre = contact.pose_first[:2] if contact else _nearest(rollout)
    return square(centre, side)


def _nearest(rollout: Rollout) -> Floats:
    """(2,) where the AV was when the opponent was nearest; without one, where the AV ended."""
    tracks = rollout.tracks
    av = tracks.row(rollout.av_id)
    if rollout.opponent_id in tracks.ids:
        other = tracks.row(rollout.opponent_id)
        both = np.flatnonzero((tracks.valid[av] & tracks.valid[other])[rollout.now :]) + rollout.now
        if len(both):
            apart = tracks.position_m[av, both] - tracks.position_m[other, both]
            place: Floats = tracks.position_m[av, both[np.hypot(*apart.T).argmin()]]
            return place
    end: Floats = _positions(rollout, rollout.av_id)[-1]
    return end


def _positions(rollout: Rollout, agent: str) -> Floats:
    """(K, 2) where an agent was from the current step on (at any step, if it was gone by then)."""
    row = rollout.tracks.row(agent)
    valid = rollout.tracks.valid[row].copy()
    if valid[rollout.now :].any():
        valid[: rollout.now] = False
    positions: Floats = rollout.tracks.position_m[row, valid]
    return positions


def _others(
    axes: Axes, rollout: Rollout, scores: OpponentScores | None, window: ViewWindow
) -> None:
    """Everyone else as the simulation took over, coloured by score; thin lines where they went."""
    tracks = rollout.tracks
    main = {rollout.av_id, rollout.opponent_id}
    rows = [
        row
        for row, agent in enumerate(tracks.ids)
        if agent not in main and tracks.valid[row, rollout.now]
    ]
    paths = [_positions(rollout, tracks.ids[row]) for row in rows]
    axes.add_collection(LineCollection(paths, colors=OTHER, linewidths=0.8, alpha=0.6, zorder=2))
    chances = _probabilities(scores)
    colors = [
        SCORES(chances[tracks.ids[row]]) if tracks.ids[row] in chances else UNSCORED for row in rows
    ]
    here = [(row, rollout.now) for row in rows]
    draw_boxes(axes, tracks, here, colors, window, Outline(edge="#59626d", zorder=4))


def _probabilities(scores: OpponentScores | None) -> dict[str, float]:
    if scores is None:
        return {}
    chances = 1.0 / (1.0 + np.exp(-scores.logits))
    return dict(zip(scores.ids, chances.tolist(), strict=True))


def _reasoning(axes: Axes, plan: Plan) -> None:
    """Candidates, the AV's reactions to the chosen one, and that one.

    A candidate ends where it is expected to meet the AV: what follows is never driven.
    """
    reason = plan.reason
    assert reason is not None
    if reason.heat:
        x, y = reason.heat.position_m.T
        share = reason.heat.probability / reason.heat.probability.max()
        axes.scatter(x, y, s=9.0, color=HEAT, alpha=0.1 + 0.8 * np.sqrt(share), lw=0, zorder=2.5)
    ends = reason.collision_step.min(axis=1).astype(int) + 1
    futures = reason.candidates.futures.position_m
    candidates = [path[:end] for path, end in zip(futures, ends, strict=True)]
    axes.add_collection(
        LineCollection(candidates, colors=CANDIDATE, linewidths=0.7, alpha=0.55, zorder=3)
    )
    if reason.reactions:
        reactions = list(reason.reactions[reason.chosen].futures.position_m)
        axes.add_collection(
            LineCollection(reactions, colors=REACTION, linewidths=1.0, alpha=0.8, zorder=3)
        )
    chosen = plan.position_m[: ends[reason.chosen]]
    axes.plot(*chosen.T, color=OPPONENT, lw=2.6, ls=(0, (4, 1.5)), zorder=5)


def _driven(axes: Axes, rollout: Rollout, agent: str, color: str, window: ViewWindow) -> None:
    """The path, a box a second, and the first and last box in full colour."""
    tracks = rollout.tracks
    row = tracks.row(agent)
    steps = [step for step in np.flatnonzero(tracks.valid[row]) if step >= rollout.now]
    if not steps:
        return
    axes.plot(*tracks.position_m[row, steps].T, color=color, lw=1.8, zorder=6)
    between = [(row, int(step)) for step in steps[EVERY_STEPS:-1:EVERY_STEPS]]
    faint = [color] * len(between)
    draw_boxes(axes, tracks, between, faint, window, Outline(edge=color, zorder=6, alpha=0.22))
    ends = [(row, int(steps[0])), (row, int(steps[-1]))]
    draw_boxes(axes, tracks, ends, [color] * 2, window, Outline(edge="black", zorder=7, alpha=0.85))
    x, y = tracks.position_m[row, steps[0]]
    if agent == rollout.opponent_id:
        star = {"marker": "*", "color": STAR, "markeredgecolor": "black"}
        axes.plot(x, y, markersize=15, markeredgewidth=0.7, zorder=9, **star)  # type: ignore[arg-type]


def _contact(axes: Axes, rollout: Rollout, contact: Contact, window: ViewWindow) -> None:
    """A cross between the two, and the outlines of both at that moment."""
    rows = [rollout.tracks.row(agent) for agent in (contact.first_id, contact.second_id)]
    there = [(row, contact.step) for row in rows if rollout.tracks.valid[row, contact.step]]
    draw_boxes(axes, rollout.tracks, there, ["none"], window, Outline(edge=CONTACT, zorder=8))
    middle = met_at(rollout.tracks, contact)
    axes.plot(*middle, marker="x", color="white", markersize=15, markeredgewidth=5, zorder=10)
    axes.plot(*middle, marker="x", color=CONTACT, markersize=13, markeredgewidth=2.5, zorder=11)


def _title(rollout: Rollout, case: Case, contact: Contact | None) -> str:
    """What happened, in words; below it the name of the case."""
    seconds = (rollout.tracks.steps - 1 - rollout.now) * rollout.dt_s
    if contact is None:
        return f"{_capital(OUTCOMES[rollout.outcome])} in {seconds:.1f} s\n{case.name}"
    time_s = (contact.step - rollout.now) * rollout.dt_s
    what = _capital(OUTCOMES[rollout.outcome])
    where = f", {SECTORS[contact.sector]}" if rollout.outcome.startswith("av") else ""
    if rollout.outcome == "av_opponent":
        row = rollout.tracks.row(contact.second_id)
        other = road_user(rollout.tracks.kinds[row], rollout.tracks.size_m[row])
        hit = hit_of(Episode(rollout, case))
        assert hit is not None
        what = came_from(other.noun, hit.side) if other.person else happened(hit)
        what += ": hit"
    return f"{what} after {time_s:.1f} s at {contact.relative_mps:.0f} m/s{where}\n{case.name}"


def came_from(noun: str, side: Side) -> str:
    """A person on the AV's way: kinds of conflict are those of vehicles on lanes."""
    where = f"the {side}" if side in {"left", "right"} else side
    return f"{_capital(noun)} from {where}"


def happened(hit: Hit) -> str:
    """A conflict in a few words."""
    conflict, side, turned = hit.conflict, hit.side, hit.turned
    turn = conflict.partition(" ")[0].capitalize()
    if conflict in ACROSS:
        by_av = turned == "AV"
        return f"{turn} turn {'of the AV across the opponent' if by_av else 'in front of the AV'}"
    if conflict == "rear-end":
        return "Into the AV from behind" if side == "behind" else "Into the vehicle ahead"
    if conflict == "head-on":
        return "Head-on"
    who = " of the AV" if turned == "AV" else ""
    name = {"crossing": "Crossing", "merging": "Merging"}.get(conflict, "Lane change")
    where = f"the {side}" if side in {"left", "right"} else side
    return f"{name}{who}, opponent from {where}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _finish(axes: Axes, window: ViewWindow, title: str, *, north: bool) -> None:
    """Frame, title and scale; in networks up is north."""
    x0, x1, y0, y1 = window.x0, window.x1, window.y0, window.y1
    axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal", xticks=[], yticks=[])
    axes.set_title(title, fontsize=11, parse_math=False)
    bar = 20.0 if x1 - x0 > 80 else 10.0
    left, bottom = x0 + 0.04 * (x1 - x0), y0 + 0.03 * (y1 - y0)
    width, height = bar + (0.1 if north else 0.02) * (x1 - x0), 0.07 * (y1 - y0)
    corner = left - 0.01 * (x1 - x0), y0 + 0.015 * (y1 - y0)
    axes.add_patch(Rectangle(corner, width, height, fc="white", ec="none", alpha=0.75, zorder=12))
    axes.plot([left, left + bar], [bottom, bottom], color="black", lw=2, zorder=13)
    axes.text(left + bar / 2, bottom + 0.01 * (y1 - y0), f"{bar:g} m", ha="center", zorder=13)
    if north:
        tip = {"arrowstyle": "-|>", "color": "black", "lw": 1.2}
        place = left + bar + 0.05 * (x1 - x0)
        axes.annotate(
            "N", xy=(place, bottom + 0.06 * (y1 - y0)), xytext=(place, bottom), ha="center",
            arrowprops=tip, zorder=13,
        )  # fmt: skip


def _map_handles(road: RoadMap, window: ViewWindow) -> Iterator[Patch]:
    """Of what the window shows of the map, as far as it does not explain itself."""
    shown = {one.kind for one in features(road) if window.shows(one.parts_m[0])}
    for layer in LAYERS:
        if layer.words and layer.of in shown and layer.fill:
            edge = layer.edge.light if layer.edge else "none"
            hatch = 2 * layer.hatch or None
            yield Patch(fc=layer.fill.light, ec=edge, hatch=hatch, label=layer.words)


def _handles(
    rollout: Rollout, scores: OpponentScores | None, plan: Plan | None
) -> Iterator[Line2D | Patch]:
    yield Line2D([], [], color=AV, lw=2, label=f"AV ({rollout.av_id}), a box a second")
    if rollout.opponent_id:
        chance = _probabilities(scores).get(rollout.opponent_id)
        score = f", score {chance:.2f}" if chance is not None else ""
        label = f"opponent ({rollout.opponent_id}{score})"
        yield Line2D([], [], color=OPPONENT, lw=2, marker="*", mfc=STAR, mec="k", label=label)
    if plan and plan.reason:
        at = (plan.first_step - 1 - rollout.now) * rollout.dt_s
        yield Line2D([], [], color=CANDIDATE, lw=0.8, label=f"its candidates at {at:.1f} s")
        yield Line2D([], [], color=OPPONENT, lw=2.6, ls="--", label="the chosen one")
        if plan.reason.heat:
            dot = {"marker": "o", "markersize": 5, "markeredgewidth": 0}
            label = "where it may be in 8 s"
            yield Line2D([], [], color=HEAT, ls="", label=label, **dot)  # type: ignore[arg-type]
        if plan.reason.reactions:
            yield Line2D([], [], color=REACTION, lw=1, label="the AV's predicted reactions")
    if scores:
        for chance in (0.0, 0.5, 1.0):
            yield Patch(fc=SCORES(chance), ec="#59626d", label=f"opponent score {chance:g}")
    others = "others, not scored" if scores else "others"
    yield Patch(fc=UNSCORED, ec="#59626d", label=f"{others}; all others where they were at 0 s")
    if rollout.contacts:
        mark = {"marker": "x", "markersize": 8, "markeredgewidth": 2}
        yield Line2D([], [], color=CONTACT, ls="", label="contact", **mark)  # type: ignore[arg-type]
