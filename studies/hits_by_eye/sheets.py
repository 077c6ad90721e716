"""Sheets of hits for a human judge: a film of four pictures, and what both did, in numbers.

    python -m studies.hits_by_eye.sheets OUT RESULTS...

Writes ``OUT/NNN.png`` and ``OUT/NNN.txt`` for each hit, and ``OUT/key.csv``, which says what a
sheet shows and its rung; a judge does not see that file. A sheet says nothing of grades.
Right of way comes from the network's XML itself, not from the package's reading of it.
"""

import csv
import sys
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Final
from xml.etree import ElementTree as ET

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from deepmf_sumo.report.drawing import Outline, draw_boxes, draw_road, square
from deepmf_sumo.report.palette import AV, OPPONENT
from deepmf_sumo.results.reader import Results, Run
from deepmf_sumo.scene import Contact, RoadMap, Rollout
from deepmf_sumo.scene.signals import colour
from deepmf_sumo.sumo.network.matching import match

BEFORE_S: Final = (4.0, 2.0, 1.0, 0.0)
SIDE_M: Final = 70.0
OTHER: Final = "#8d99a6"


def film(run: Run, road: RoadMap, hit: Contact, path: Path) -> None:
    """Four pictures: 4, 2, 1 and 0 s before the contact, with the paths of the last 4 s."""
    rollout = run.rollout
    tracks = rollout.tracks
    rows = [tracks.row(hit.first_id), tracks.row(hit.second_id)]
    figure = Figure(figsize=(15.0, 15.0), dpi=75, layout="constrained")
    FigureCanvasAgg(figure)
    window = square((hit.pose_first[:2] + hit.pose_second[:2]) / 2, SIDE_M)
    for axes, before_s in zip(figure.subplots(2, 2).ravel(), BEFORE_S, strict=True):
        step = max(hit.step - round(before_s / rollout.dt_s), 0)
        draw_road(axes, road, window, 7.0)
        for lane in road.lanes.values():
            if len(lane.centre_m) > 1 and window.shows(window.place(lane.centre_m)):
                middle = window.place(lane.centre_m)
                at = len(middle) // 2
                axes.annotate("", middle[at], middle[max(at - 1, 0)],
                              arrowprops={"arrowstyle": "->", "color": "#9aa4af"})  # fmt: skip
        there = [row for row in range(len(tracks.ids)) if tracks.valid[row, step]]
        tints = [AV if r == rows[0] else OPPONENT if r == rows[1] else OTHER for r in there]
        places = [(row, step) for row in there]
        draw_boxes(axes, tracks, places, tints, window, Outline(edge="k", zorder=4))
        for row, tint in zip(rows, (AV, OPPONENT), strict=True):
            first = max(hit.step - round(4.0 / rollout.dt_s), 0)
            here = [s for s in range(first, step + 1) if tracks.valid[row, s]]
            axes.plot(*window.place(tracks.position_m[row, here]).T, color=tint, lw=1.5, zorder=3)
        axes.set(xlim=(window.x0, window.x1), ylim=(window.y0, window.y1))
        axes.set_title(f"{before_s:g} s before the contact", fontsize=14)
        axes.set_aspect("equal")
    figure.savefig(path, metadata={"Software": None})


def facts(run: Run, road: RoadMap, hit: Contact) -> Iterator[str]:
    """What a human needs besides the pictures. Blue: AV; the other colour: opponent."""
    rollout, tracks = run.rollout, run.rollout.tracks
    start = rollout.now
    yield f"attack begins {(hit.step - start) * rollout.dt_s:.1f} s before the contact"
    yield f"AV colour {AV}, opponent colour {OPPONENT}"
    yield f"change of the AV's velocity in the impact: {hit.delta_v_mps * 3.6:.0f} km/h"
    earlier = [one for one in rollout.contacts if one.step < hit.step]
    yield f"contacts before: {[(o.kind, o.first_id, o.second_id) for o in earlier] or 'none'}"
    ways = {}
    for name, agent in (("AV", hit.first_id), ("opponent", hit.second_id)):
        row = tracks.row(agent)
        length, width = tracks.size_m[row, :2]
        yield f"-- {name}: {length:.1f} m x {width:.1f} m"
        ways[name] = yield from _motion(rollout, road, row, hit.step)
    yield f"right of way in the network: {_right_of_way(run, *ways.values())}"


def _motion(
    rollout: Rollout, road: RoadMap, row: int, last: int
) -> Generator[str, None, list[str]]:
    """Lines of time, speed, acceleration, lane; returns the lanes (generator's value)."""
    tracks = rollout.tracks
    steps = np.arange(max(last - round(5.0 / rollout.dt_s), 0), last + 1)
    found = match(road, tracks.position_m[row, steps], tracks.heading_rad[row, steps],
                  tracks.valid[row, steps], tracks.z_m[row, steps])  # fmt: skip
    speed, before, lanes = tracks.speed_mps[row, steps], None, []
    for at, step in enumerate(steps):
        lane = found.lane_ids[at]
        if lane is not None and (not lanes or lanes[-1] != lane):
            lanes.append(lane)
        entered = lane != before and lane is not None
        before = lane
        if not tracks.valid[row, step] or (not entered and (last - step) % 5):
            continue
        gain = (speed[at] - speed[max(at - 5, 0)]) / (0.1 * max(min(at, 5), 1))
        light = ""
        shown = step - rollout.now
        if 0 <= shown < len(rollout.signals) and lane in rollout.signals[shown]:
            light = f", light {colour(rollout.signals[shown][lane])}"
        yield (f"   {(step - last) * 0.1:5.1f} s: {speed[at] * 3.6:5.1f} km/h, {gain:+.1f} m/s2,"
               f" lane {lane}{light}")  # fmt: skip
    return lanes


def _right_of_way(run: Run, av: list[str], opponent: list[str]) -> str:
    """Which yields, by the junction's ``request`` rows of the run's network."""
    net = run.folder / "sumo" / "net.net.xml"
    if not net.is_file():
        return "not known"
    root = ET.parse(net).getroot()  # noqa: S314 - our own file
    for junction in root.iter("junction"):
        inside = (junction.get("intLanes") or "").split()
        mine = [inside.index(lane) for lane in av if lane in inside]
        theirs = [inside.index(lane) for lane in opponent if lane in inside]
        if not mine or not theirs:
            continue
        rows = {int(one.get("index", "0")): one for one in junction.iter("request")}
        one, other = mine[-1], theirs[-1]
        if one not in rows or other not in rows:
            continue
        yields = rows[one].get("response", "")[::-1][other : other + 1] == "1"
        let = rows[other].get("response", "")[::-1][one : one + 1] == "1"
        kind = junction.get("type")
        if yields != let:
            return f"{'AV' if yields else 'opponent'} must give way ({kind})"
        return f"neither gives way to the other by the junction's rules ({kind})"
    return "they meet at no junction that both cross"


def main(out: Path, folders: list[Path]) -> None:
    """Write sheets of all hits of result folders."""
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    for folder in folders:
        for run in Results.of(folder).done:
            hit = run.rollout.first("av_opponent") if run.hit else None
            if hit is None:
                continue
            road, name = run.road()[0], f"{len(rows):03d}"
            film(run, road, hit, out / f"{name}.png")
            (out / f"{name}.txt").write_text("\n".join(facts(run, road, hit)) + "\n")
            verdict = run.result.get("finding") or {}
            rows.append([name, folder, run.run_id, verdict.get("rung"), verdict.get("reasons")])
    with (out / "key.csv").open("w", newline="") as file:
        csv.writer(file).writerows([["sheet", "folder", "run", "rung", "reasons"], *rows])


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(one) for one in sys.argv[2:]])
