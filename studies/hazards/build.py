"""Forty places, four of them flawed: ``python studies/hazards/build.py FOLDER``.

Ten merges, ten signalled crossings, ten left turns and ten stops lie beside each other in one
network, each with traffic of its own. Volumes differ by up to a fifth and speed limits by up to a
tenth from place to place, drawn once for all. One of each kind has a flaw that road safety audits
look for:

- a merge without an acceleration lane worth the name (15 m instead of 200 m),
- a signal that goes from green to red without a yellow or a pause,
- a left turn that has to find gaps in fast oncoming traffic instead of its own green,
- a stop whose sign cannot be seen: no vehicle gives way.

Edges and junctions carry the name of their place: ``merge3_in``; vehicles are of a type that is
called like the kind of their place: ``merge``. Same arguments, same bytes.
"""

# ruff: noqa: INP001, T201 - a script beside data, not a package

import argparse
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import sumo

OF_A_KIND: Final = 10
APART_M: Final = 600
FLAWED: Final = ("merge3", "signal6", "left1", "stop8")
"""Spread over the network, for what is chosen first must not be what is found."""
NETCONVERT: Final = Path(sumo.SUMO_HOME) / "bin" / "netconvert"
HORIZON_S: Final = 180
"""Twelve changes of each light."""
DRAWN: Final = 20
"""Seed of what differs from place to place."""
HEADER: Final = re.compile(r"<!-- generated on .*?-->\n*", re.DOTALL)
"""Date and paths, which netconvert writes on top."""


class Place(NamedTuple):
    """A place: name, kind and middle, its volume and speed limits as shares of the kind's."""

    name: str
    kind: str
    x: float
    y: float
    volume: float
    speed: float


class Plain:
    """SUMO's plain XML, element by element."""

    def __init__(self) -> None:
        self.files: dict[str, list[str]] = {key: [] for key in ("nod", "edg", "con", "tll", "rou")}

    def add(self, file: str, tag: str, inside: str = "", **values: object) -> None:
        """An element; ``start`` stands for ``from``."""
        named = "".join(
            f' {"from" if key == "start" else key}="{value}"' for key, value in values.items()
        )
        self.files[file].append(f"  <{tag}{named}>{inside}</{tag}>")

    def node(self, name: str, x: float, y: float, kind: str = "priority", **more: object) -> None:
        """A node of a kind that netconvert knows."""
        self.add("nod", "node", id=name, x=x, y=y, type=kind, **more)

    def edge(
        self, name: str, start: str, to: str, speed: float, lanes: int = 1, **more: object
    ) -> None:
        """An edge between two nodes, with its speed limit in m/s."""
        self.add("edg", "edge", id=name, start=start, to=to, speed=speed, numLanes=lanes, **more)

    def flow(self, start: str, to: str, chance: float, speed: str = "max") -> None:
        """Vehicles from an edge to another, with a chance in each second."""
        span = {"begin": 0, "end": HORIZON_S}
        ways = {"start": start, "to": to, "probability": round(chance, 4)}
        name, kind = f"{start}.{to}", re.sub(r"\d.*", "", start)
        self.add("rou", "flow", id=name, type=kind, **span, **ways, departLane="best",
                 departSpeed=speed)  # fmt: skip


def merge(plain: Plain, place: Place, *, flawed: bool) -> None:
    """A motorway of two lanes with a ramp from the right."""
    name, x, y = place.name, place.x, place.y
    length, fast = 15 if flawed else 200, round(25.0 * place.speed, 1)
    plain.node(f"{name}_west", x - 150, y)
    plain.node(f"{name}_nose", x, y)
    plain.node(f"{name}_taper", x + length, y)
    plain.node(f"{name}_east", x + length + 100, y)
    plain.node(f"{name}_below", x - 150, y - 40)
    plain.edge(f"{name}_in", f"{name}_west", f"{name}_nose", fast, 2, priority=10)
    # it comes beside the motorway, not over it
    ramp = f"{x - 150},{y - 40} {x - 60},{y - 11} {x - 30},{y - 6.4} {x},{y - 6.4}"
    plain.edge(f"{name}_ramp", f"{name}_below", f"{name}_nose", fast, 1, priority=5, shape=ramp)
    plain.edge(f"{name}_lane", f"{name}_nose", f"{name}_taper", fast, 3, priority=10)
    plain.edge(f"{name}_out", f"{name}_taper", f"{name}_east", fast, 2, priority=10)
    for lane in (0, 1):
        plain.add("con", "connection", start=f"{name}_in", to=f"{name}_lane", fromLane=lane,
                  toLane=lane + 1)  # fmt: skip
        plain.add("con", "connection", start=f"{name}_lane", to=f"{name}_out", fromLane=lane + 1,
                  toLane=lane)  # fmt: skip
    plain.add("con", "connection", start=f"{name}_ramp", to=f"{name}_lane", fromLane=0, toLane=0)
    plain.flow(f"{name}_in", f"{name}_out", 0.6 * place.volume)
    plain.flow(f"{name}_ramp", f"{name}_out", 0.2 * place.volume)


ARMS: Final = {"west": (-1, 0), "east": (1, 0), "south": (0, -1), "north": (0, 1)}
ACROSS: Final = {"west": "east", "east": "west", "south": "north", "north": "south"}
MAIN: Final = ("west", "east")
APPROACH_M: Final = 120
EXIT_M: Final = 40
"""Too short to be attacked on: what happens behind a place says little about it."""


def _crossing(
    plain: Plain, place: Place, kind: str, speed: float, main_lanes: dict[str, int] | None = None
) -> None:
    """Four arms; west and east are the main road, ``NAME_west_in`` leads to the middle."""
    name, x, y = place.name, place.x, place.y
    plain.node(f"{name}_mid", x, y, kind, **({"tl": name} if kind == "traffic_light" else {}))
    for arm, (u, v) in ARMS.items():
        plain.node(f"{name}_{arm}_from", x + APPROACH_M * u, y + APPROACH_M * v)
        plain.node(f"{name}_{arm}_to", x + EXIT_M * u, y + EXIT_M * v)
        limit, rank = (round(speed * place.speed, 1), 10) if arm in MAIN else (11.1, 1)
        many = main_lanes or {}
        before, behind = (
            many.get(arm, 1),
            many.get(ACROSS[arm], 1),
        )  # vehicles that go straight on may
        start, mid, end = f"{name}_{arm}_from", f"{name}_mid", f"{name}_{arm}_to"
        plain.edge(f"{name}_{arm}_in", start, mid, limit, before, priority=rank)
        plain.edge(f"{name}_{arm}_out", mid, end, limit, behind, priority=rank)


def _link(plain: Plain, name: str, start: str, to: str, lane: int = 0) -> None:
    ends = {"start": f"{name}_{start}_in", "to": f"{name}_{to}_out"}
    plain.add("con", "connection", **ends, fromLane=lane, toLane=0)


def _straight(plain: Plain, place: Place, main: float, side: float) -> None:
    """Everybody drives straight over."""
    for arm, other in ACROSS.items():
        _link(plain, place.name, arm, other)
        chance = (main if arm in MAIN else side) * place.volume
        plain.flow(f"{place.name}_{arm}_in", f"{place.name}_{other}_out", chance)


def _lights(plain: Plain, name: str, links: list[tuple[str, str, int]], phases: str) -> None:
    """A fixed programme; ``phases``: ``seconds:state`` for the links in their order."""
    states = "".join(
        f'<phase duration="{seconds}" state="{state}"/>'
        for seconds, state in (phase.split(":") for phase in phases.split())
    )
    plain.add("tll", "tlLogic", states, id=name, type="static", programID="0", offset=0)
    for index, (start, to, lane) in enumerate(links):
        plain.add("tll", "connection", start=f"{name}_{start}_in", to=f"{name}_{to}_out",
                  fromLane=lane, toLane=0, tl=name, linkIndex=index)  # fmt: skip


def signal(plain: Plain, place: Place, *, flawed: bool) -> None:
    """Two roads cross straight over under a light."""
    _crossing(plain, place, "traffic_light", 13.9)
    _straight(plain, place, 0.17, 0.14)
    good = "10:GGrr 3:yyrr 2:rrrr 10:rrGG 3:rryy 2:rrrr"
    links = [(arm, other, 0) for arm, other in ACROSS.items()]
    _lights(plain, place.name, links, "15:GGrr 15:rrGG" if flawed else good)


def left(plain: Plain, place: Place, *, flawed: bool) -> None:
    """A fast road with a lane to turn left from into a side road."""
    _crossing(plain, place, "traffic_light", 19.4, {"west": 2})
    links = [("west", "east", 0), ("east", "west", 0), ("west", "north", 1)]
    for start, to, lane in links:
        _link(plain, place.name, start, to, lane)
        chance = (0.12 if lane else 0.2) * place.volume
        plain.flow(f"{place.name}_{start}_in", f"{place.name}_{to}_out", chance)
    # 3 s of yellow are too short for 70 km/h
    good = "12:GGr 5:yyr 2:rrr 8:rrG 3:rry 2:rrr"
    _lights(plain, place.name, links, "25:GGg 5:yyy 2:rrr" if flawed else good)


def stop(plain: Plain, place: Place, *, flawed: bool) -> None:
    """A side road crosses a main road and has to stop, if its drivers see the sign."""
    _crossing(plain, place, "unregulated" if flawed else "priority_stop", 16.7)
    _straight(plain, place, 0.12, 0.08)


KINDS: Final[dict[str, Callable[..., None]]] = {
    "merge": merge, "signal": signal, "left": left, "stop": stop,
}  # fmt: skip


def places() -> Iterator[Place]:
    """All forty, with what differs between them."""
    rng = np.random.default_rng(DRAWN)
    for row, kind in enumerate(KINDS):
        for column in range(OF_A_KIND):
            volume, speed = rng.uniform(0.8, 1.2), rng.uniform(0.9, 1.1)
            where = column * APART_M, row * APART_M
            yield Place(f"{kind}{column}", kind, *where, float(volume), float(speed))


def build(folder: Path, flawed: tuple[str, ...] = FLAWED) -> Path:
    """Network, traffic and configuration; returns the .sumocfg. Raises CalledProcessError."""
    plain = Plain()
    for kind in KINDS:
        plain.add("rou", "vType", id=kind)
    for place in places():
        KINDS[place.kind](plain, place, flawed=place.name in flawed)
    folder.mkdir(parents=True, exist_ok=True)
    roots = {"nod": "nodes", "edg": "edges", "con": "connections", "tll": "tlLogics"}
    for file, lines in plain.files.items():
        root = roots.get(file, "routes")
        text = "\n".join([f"<{root}>", *lines, f"</{root}>", ""])
        (folder / f"hazards.{file}.xml").write_text(text, encoding="utf-8")
    command = [str(NETCONVERT), "-o", "hazards.net.xml", "--no-turnarounds", "true"]
    for option, file in {"-n": "nod", "-e": "edg", "-x": "con", "-i": "tll"}.items():
        command += [option, f"hazards.{file}.xml"]
    environment = {**os.environ, "SUMO_HOME": str(sumo.SUMO_HOME)}
    subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True, env=environment)
    net = folder / "hazards.net.xml"
    net.write_text(HEADER.sub("", net.read_text("utf-8"), count=1), encoding="utf-8")
    config = folder / "hazards.sumocfg"
    config.write_text(
        '<configuration>\n  <input>\n    <net-file value="hazards.net.xml"/>\n'
        '    <route-files value="hazards.rou.xml"/>\n  </input>\n  <time>\n'
        f'    <end value="{HORIZON_S}"/>\n    <step-length value="0.1"/>\n  </time>\n'
        "</configuration>\n",
        encoding="utf-8",
    )
    return config


def main() -> int:
    """Build into the folder given."""
    parser = argparse.ArgumentParser(description="Forty places, four of them flawed.")
    parser.add_argument("folder", type=Path)
    every = [place.name for place in places()]
    parser.add_argument("--flawed", nargs="*", default=FLAWED, metavar="PLACE", choices=every)
    given = parser.parse_args()
    try:
        print(build(given.folder, tuple(given.flawed)))
    except subprocess.CalledProcessError as error:
        print(error.stderr.strip(), file=sys.stderr)
        return 1
    except OSError as error:
        print(f"{given.folder} cannot be written: {error.strerror}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
