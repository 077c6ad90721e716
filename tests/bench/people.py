"""How SUMO treats people that are moved, and what they cost: ``python -m tests.bench.people``.

Printed: where a car drives through a person, by keepRoute and with the takeover; what becomes of
persons that are walked anywhere and let go, with ``--net`` on another network; and the time of a
step with 200 persons around, of plain libsumo and of an episode.
"""

import argparse
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import libsumo
import numpy as np

from deepmf_sumo.planners import sumo as sumo_planner
from deepmf_sumo.scene import agent_ids
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.sumo.network.footways import footways_of
from deepmf_sumo.sumo.simulation import network_case, simulate
from deepmf_sumo.sumo.simulation.frame import Pose
from deepmf_sumo.sumo.simulation.occupancy import Occupancy
from deepmf_sumo.sumo.simulation.road_users import TrafficReader
from deepmf_sumo.sumo.simulation.vehicle_control import SumoOwner, Takeover

from tests.support import pavements

OPTIONS = ["--step-length", "0.1", "--no-warnings", "--no-step-log", "--collision.action", "none"]
PLACES = {
    "mid-block": (201.6, 120.0), "crossing": (201.6, 190.6), "junction": (201.6, 198.0),
    "walking area": (204.5, 189.6),
}  # fmt: skip
WALK_MPS = 1.4


def main() -> None:
    """Print every figure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--net", type=Path)
    parser.add_argument("--routes", nargs="*", default=[], help="of that network, with persons")
    parser.add_argument("--begin", default="0")
    parser.add_argument("--persons", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=["seen", "walked", "cost"])
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        where = Path(folder)
        if asked.only in {None, "seen"} and asked.net is None:
            _seen(where)
        if asked.only in {None, "walked"}:
            _walked(where, asked)
        if asked.only in {None, "cost"} and asked.net is None:
            _cost(where)


def _started(folder: Path) -> None:
    net, rou = folder / "pavements.net.xml", folder / "pavements.rou.xml"
    libsumo.start(["sumo", "-n", str(net), "-r", str(rou), *OPTIONS])


def _seen(folder: Path) -> None:
    """A person stands somewhere, and a car comes straight on."""
    demand = pavements.car("car", "sm mn", 1, 40), pavements.walker("p", "wm me", 180)
    pavements.build(folder, *demand)
    print(f"{'person at':14} {'keepRoute':9} {'off by m':>8} {'nearest m':>9} {'lane':12} car")
    for place, at in PLACES.items():
        for keep in (0, 2, 4, 6, None):
            off, near, lane = _stands(folder, at, keep)
            name = "takeover" if keep is None else str(keep)
            what = "drives through" if near < 0.3 and place != "walking area" else ""
            print(f"{place:14} {name:9} {off:8.2f} {near:9.1f} {lane:12} {what}")


def _stands(folder: Path, at: tuple[float, float], keep: int | None) -> tuple[float, float, str]:
    """Largest error of the position, least distance of the car's box, and SUMO's lane."""
    _started(folder)
    takeover = Takeover(libsumo, [], footways=lambda: footways_of(folder / "pavements.net.xml"))
    off, near, lane = 0.0, np.inf, ""
    for step in range(300):
        there = "p" in libsumo.person.getIDList()
        if there and keep is None:
            pose = Pose(x_m=at[0], y_m=at[1], heading_rad=np.pi / 2, speed_mps=0.0)
            takeover.place(step, "person p", pose, 0.0)
        elif there:
            libsumo.person.moveToXY("p", "", *at, 0.0, keep, 5.0)
        libsumo.simulationStep()
        if there:
            off = max(off, float(np.hypot(*(np.array(libsumo.person.getPosition("p")) - at))))
            lane = libsumo.person.getLaneID("p")
        if "car" in libsumo.vehicle.getIDList():
            x, y = libsumo.vehicle.getPosition("car")
            ahead, beside = at[1] - y, abs(at[0] - x)
            gap = np.hypot(max(-5.0 - ahead, 0.0, ahead), max(beside - 0.9, 0.0))
            near = min(near, float(gap))
    libsumo.close()
    return off, near, lane


def _walked(folder: Path, asked: argparse.Namespace) -> None:
    """Persons are walked 1 m to 15 m in any direction, to the footway, and let go."""
    if asked.net is None:
        pavements.build(folder, *_crowd(60, 20, np.random.default_rng(0)))
        _started(folder)
        net = folder / "pavements.net.xml"
    else:
        net = asked.net
        routes = ["-r", ",".join(asked.routes)] if asked.routes else []
        libsumo.start(["sumo", "-n", str(net), *routes, "--begin", asked.begin, *OPTIONS])
    libsumo.simulationStep(libsumo.simulation.getTime() + 3.0)
    events: list[Any] = []
    takeover = Takeover(libsumo, events, leaves=True, footways=lambda: footways_of(net))
    crowd = _Crowd(takeover, np.random.default_rng(asked.seed), asked.persons)
    for step in range(20 * asked.persons + 900):
        crowd.step(step)
    libsumo.close()
    kinds = [event.kind for event in events]
    told = ", ".join(f"{kind} {kinds.count(kind)}" for kind in sorted(set(kinds)))
    print(f"taken {len(crowd.known)}: {told}; placed off by at most {crowd.off_m:.2f} m;")
    print(f"farthest step of one while driven, and in the step after: {crowd.moved_m:.2f} m")


class _Crowd:
    """Persons that are taken over one after the other."""

    def __init__(self, takeover: Takeover, rng: np.random.Generator, most: int) -> None:
        self._takeover, self._rng, self._most = takeover, rng, most
        self._reader = TrafficReader(libsumo)
        self._owner = SumoOwner(takeover, self._around)
        self._going: dict[str, list[Any]] = {}  # pose, angle, steps left, way, steps alone
        self._frame = self._reader.read()
        self.known: set[str] = set()
        self.off_m = self.moved_m = 0.0

    def _around(self, _: str) -> Occupancy:
        size = self._reader.bodies.sizes_m(self._frame.ids)
        return Occupancy(frame=self._frame, size_m=size, av_id="")

    def step(self, step: int) -> None:
        self._frame = self._reader.read()
        if step % 20 == 0 and len(self.known) < self._most:
            self._take()
        before = dict(zip(self._frame.ids, self._frame.position_m, strict=True))
        watched = set(self._going)
        for agent in list(self._going):
            self._go_on(step, agent)
        libsumo.simulationStep()
        self._takeover.after_step()
        after = self._reader.read()
        for row, agent in enumerate(after.ids):
            if agent in watched and agent in before:
                moved = float(np.hypot(*(after.position_m[row] - before[agent])))
                self.moved_m = max(self.moved_m, moved)
            if agent in self._going:
                pose = self._going[agent][0]
                off = after.position_m[row] - (pose.x_m, pose.y_m)
                self.off_m = max(self.off_m, float(np.hypot(*off)))

    def _take(self) -> None:
        free = [
            agent
            for agent in self._frame.ids
            if agent_ids.person_of(agent) and agent not in self.known
            if not self._takeover.persons.refusal(agent)
        ]
        if not free:
            return
        agent = free[self._rng.integers(len(free))]
        row = self._frame.ids.index(agent)
        (x, y), heading = self._frame.position_m[row], self._frame.heading_rad[row]
        pose = Pose(x_m=float(x), y_m=float(y), heading_rad=float(heading), speed_mps=0.0)
        angle, far_m = self._rng.uniform(-np.pi, np.pi), self._rng.uniform(1.0, 15.0)
        self._going[agent] = [pose, float(angle), int(far_m / WALK_MPS / 0.1), None, 0]
        self.known.add(agent)

    def _go_on(self, step: int, agent: str) -> None:
        pose, angle, left, way, alone = self._going[agent]
        if agent not in self._frame.ids:
            del self._going[agent]
            return
        if left > 0:
            x, y = np.array([pose.x_m, pose.y_m]) + 0.1 * WALK_MPS * frames.unit(np.array(angle))
            pose = Pose(x_m=float(x), y_m=float(y), heading_rad=angle, speed_mps=WALK_MPS)
        elif alone > 300 or self._owner.takes(agent, step, pose):
            self._takeover.hand_back(step, agent)
            del self._going[agent]
            return
        else:
            way = way or self._owner.walk(agent, pose)
            pose = way.next(lambda poses: self._owner.clear(agent, poses))
            alone += 1
        self._going[agent] = [pose, angle, left - 1, way, alone]
        self._takeover.place(step, agent, pose, self._reader.body(agent).size_m[0])


def _crowd(persons: int, cars: int, rng: np.random.Generator) -> list[str]:
    demand = []
    for number in range(persons):
        start, end = rng.choice(list("wens"), 2, replace=False)
        way = f"{start}m m{end}"
        demand.append(pavements.walker(f"p{number}", way, rng.uniform(60, 185)))
    ways = (("wm me", 3), ("em mw", 2), ("sm mn", 1), ("nm ms", 1))
    for number in range(cars):
        edges, lane = ways[number % 4]
        demand.append(pavements.car(f"c{number}", edges, lane, 20 + (number // 4) * 8))
    return demand


def _cost(folder: Path) -> None:
    """Processor time of steps, medians of five runs of 100 steps each in turn."""
    demand = _crowd(200, 20, np.random.default_rng(0))
    config = pavements.build(folder, pavements.car("av", "wm me", 2, 10), *demand)
    runs: dict[str, list[float]] = {"plain": [], "plain, read": [], "episode": []}
    for _ in range(5):
        for name, read in (("plain", False), ("plain, read", True)):
            _started(folder)
            libsumo.simulationStep(3.0)
            begin = time.process_time()
            for _ in range(100):
                libsumo.simulationStep()
                if read:
                    _read_plainly()
            runs[name].append((time.process_time() - begin) * 10)
            libsumo.close()
        runs["episode"].append((_episode_s(config, 200) - _episode_s(config, 100)) * 10)
    for name, took in runs.items():
        times = [one / plain for one, plain in zip(took, runs["plain"], strict=True)]
        print(
            f"{name:12} {statistics.median(took):5.2f} ms of the processor a step with 200 persons,"
            f" {statistics.median(times):.2f} times plain"
        )


def _episode_s(config: Path, steps: int) -> float:
    """Processor time of an episode, its start included."""
    case = network_case(config, 3.0, "av", steps, seed=0)
    planner = sumo_planner.build(sumo_planner.Settings())
    begin = time.process_time()
    simulate(case, planner, None, rng=np.random.default_rng(0))
    return time.process_time() - begin


def _read_plainly() -> None:
    """Positions, angles and speeds of all, as any client has to ask for them."""
    for domain in (libsumo.vehicle, libsumo.person):
        for name in domain.getIDList():
            domain.getPosition3D(name)
            domain.getAngle(name)
            domain.getSpeed(name)


if __name__ == "__main__":
    main()
