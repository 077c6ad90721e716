"""Networks not used for tuning, built with SUMO's own programs from a few lines each."""

import gzip
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import sumo

HOME = Path(sumo.SUMO_HOME)
SUMOS_OWN = HOME / "tools" / "game"
"""Configurations that come with the wheel: recorded towns and crossings, played by hand."""


def _tool(folder: Path, name: str, *options: object) -> None:
    command = [str(HOME / "bin" / name), *map(str, options)]
    environment = {**os.environ, "SUMO_HOME": str(HOME)}
    subprocess.run(command, cwd=folder, check=True, capture_output=True, env=environment)


def _random_trips(folder: Path, *options: object) -> None:
    """Demand between random edges: ``trips.xml``, of vehicles that get through alone."""
    script = HOME / "tools" / "randomTrips.py"
    common = ("-n", "net.net.xml", "-o", "trips.xml", "--seed", "1", "--fringe-factor", "3")
    environment = {**os.environ, "SUMO_HOME": str(HOME)}
    subprocess.run(
        [sys.executable, str(script), *common, *map(str, options)],
        cwd=folder, check=True, capture_output=True, env=environment,
    )  # fmt: skip


def _config(folder: Path, routes: str = "trips.xml", end: int = 200, more: str = "") -> Path:
    """``my.sumocfg``; ``more`` are sections of it."""
    text = (
        f'<configuration><input><net-file value="net.net.xml"/><route-files value="{routes}"/>'
        f'</input><time><end value="{end}"/></time>{more}</configuration>'
    )
    (folder / "my.sumocfg").write_text(text)
    return folder / "my.sumocfg"


def _generated(*options: object, period: float = 1.0) -> Callable[[Path], Path]:
    def build(folder: Path) -> Path:
        _tool(folder, "netgenerate", "-o", "net.net.xml", "--seed", 1, *options)
        _random_trips(folder, "-p", period, "-e", 200)
        return _config(folder)

    return build


def _plain(
    nodes: str, edges: str, routes: str, *options: object, more: str = "", extra: str = ""
) -> Callable[[Path], Path]:
    """A network in SUMO's plain XML, with its routes; ``extra`` is an additional file."""

    def build(folder: Path) -> Path:
        (folder / "my.nod.xml").write_text(f"<nodes>{nodes}</nodes>")
        (folder / "my.edg.xml").write_text(f"<edges>{edges}</edges>")
        (folder / "my.rou.xml").write_text(f"<routes>{routes}</routes>")
        files = ("-n", "my.nod.xml", "-e", "my.edg.xml", "-o", "net.net.xml")
        _tool(folder, "netconvert", *files, *options)
        given = more
        if extra:
            (folder / "my.add.xml").write_text(f"<additional>{extra}</additional>")
            given += '<input><additional-files value="my.add.xml"/></input>'
        return _config(folder, "my.rou.xml", more=given)

    return build


def _arms(radius: float, speed: float = 13.9) -> tuple[str, str]:
    """A ring of four nodes with an arm at each: nodes and edges of a roundabout."""
    places = {"n": (0, 1), "w": (-1, 0), "s": (0, -1), "e": (1, 0)}
    nodes, edges = "", ""
    for name, (x, y) in places.items():
        nodes += f'<node id="{name}" x="{x * radius}" y="{y * radius}"/>'
        nodes += f'<node id="{name}_far" x="{x * 200}" y="{y * 200}"/>'
        edges += f'<edge id="{name}_in" from="{name}_far" to="{name}" speed="{speed}"/>'
        edges += f'<edge id="{name}_out" from="{name}" to="{name}_far" speed="{speed}"/>'
    for start, end in zip("nwse", "wsen", strict=True):
        (x, y), (u, v) = places[start], places[end]
        corner = f"{(x + u) * radius * 0.7:.1f},{(y + v) * radius * 0.7:.1f}"
        shape = f"{x * radius},{y * radius} {corner} {u * radius},{v * radius}"
        edges += f'<edge id="ring_{start}" from="{start}" to="{end}" speed="8" shape="{shape}"/>'
    return nodes, edges + '<roundabout nodes="n w s e" edges="ring_n ring_w ring_s ring_e"/>'


def _flows(*flows: tuple[str, str, int], kind: str = "") -> str:
    """Flows (from, to, vehicles an hour)."""
    return "".join(
        f'<flow id="{start}-{end}" begin="0" end="200" vehsPerHour="{number}" from="{start}"'
        f' to="{end}" departSpeed="max" departLane="best"{kind}/>'
        for start, end, number in flows
    )


_ROAD = '<node id="a" x="0" y="0"/><node id="b" x="400" y="0"/><node id="c" x="800" y="0"/>'
_RAMP_NODES = (
    '<node id="a" x="0" y="0"/><node id="m" x="600" y="0"/><node id="b" x="1200" y="0"/>'
    '<node id="r" x="250" y="-80"/>'
)
_RAMP_EDGES = (
    '<edge id="up" from="a" to="m" numLanes="2" speed="33.3"/>'
    '<edge id="down" from="m" to="b" numLanes="2" speed="33.3"/>'
    '<edge id="ramp" from="r" to="m" numLanes="1" speed="16.7"/>'
)
_BUS_LANE = "".join(
    f'<edge id="{a}{b}" from="{a}" to="{b}" numLanes="2" speed="13.9"><lane index="0" allow="bus"/>'
    "</edge>"
    for a, b in ("ab", "bc")
)
_BUSES = (
    '<vType id="line" vClass="bus"/>'
    '<flow id="bus" type="line" begin="0" end="200" period="20" from="ab" to="bc">'
    '<stop busStop="stop" duration="10"/></flow>'
)

TEN: dict[str, Callable[[Path], Path]] = {
    "grid": _generated("--grid", "--grid.number", 5, "--grid.length", 120),
    "spider": _generated("--spider", "--spider.arm-number", 6, "--spider.circle-number", 3),
    "random": _generated("--rand", "--rand.iterations", 40),
    "roundabout": _plain(
        *_arms(18.0),
        _flows(("n_in", "s_out", 300), ("w_in", "e_out", 300), ("s_in", "w_out", 200),
               ("e_in", "n_out", 200)),
    ),
    "motorway ramp": _plain(
        _RAMP_NODES, _RAMP_EDGES, _flows(("up", "down", 1800), ("ramp", "down", 600)),
        "--ramps.guess", "true",
    ),
    "left hand": _generated("--grid", "--grid.number", 4, "--lefthand", "true"),
    "actuated lights": _generated(
        *("--grid", "--grid.number", 4, "--default-junction-type", "traffic_light"),
        *("--tls.default-type", "actuated", "--default.lanenumber", 2),
    ),
    "single edge": _plain(
        '<node id="a" x="0" y="0"/><node id="b" x="900" y="0"/>',
        '<edge id="ab" from="a" to="b" numLanes="2" speed="25"/>',
        _flows(("ab", "ab", 1200)),
    ),
    "bus lane": _plain(
        _ROAD, _BUS_LANE, _flows(("ab", "bc", 900)) + _BUSES,
        extra='<busStop id="stop" lane="bc_0" startPos="40" endPos="60"/>',
    ),
    "Ingolstadt": lambda _: SUMOS_OWN / "fkk_in.sumocfg",
}  # fmt: skip


def _persons(folder: Path) -> Path:
    _tool(
        folder, "netgenerate", "-o", "net.net.xml", "--seed", 1, "--grid", "--grid.number", 3,
        "--sidewalks.guess", "true", "--crossings.guess", "true", "--walkingareas", "true",
        "--tls.guess", "true",
    )  # fmt: skip
    _random_trips(folder, "-p", 0.5, "-e", 200, "--pedestrians", "--max-distance", 300)
    (folder / "trips.xml").rename(folder / "walks.xml")
    _random_trips(folder, "-p", 1.0, "-e", 200)
    return _config(folder, "trips.xml,walks.xml")


def _several_zipped(folder: Path) -> Path:
    """Two route files, the network and the additional file packed, beginning late."""
    TEN["grid"](folder)
    _random_trips(folder, "-p", 2, "-b", 1000, "-e", 1200, "--prefix", "one")
    (folder / "trips.xml").rename(folder / "one.xml")
    _random_trips(folder, "-p", 2, "-b", 1000, "-e", 1200, "--prefix", "two")
    for name in ("one.xml", "trips.xml", "net.net.xml"):
        with gzip.open(folder / f"{name}.gz", "wb") as packed:
            packed.write((folder / name).read_bytes())
        (folder / name).unlink()
    config = _config(folder, "one.xml.gz,trips.xml.gz", end=1200)
    text = config.read_text().replace("net.net.xml", "net.net.xml.gz")
    config.write_text(text.replace("<time>", '<time><begin value="1000"/>'))
    return config


def _bound(folder: Path) -> Path:
    """Signals, and no lanes inside junctions."""
    return _generated(
        "--grid", "--grid.number", 4, "--no-internal-links", "true", "--tls.guess", "true"
    )(folder)


def _with_steps(step_s: float) -> Callable[[Path], Path]:
    def build(folder: Path) -> Path:
        config = TEN["grid"](folder)
        step = f'<time><step-length value="{step_s}"/>'
        config.write_text(config.read_text().replace("<time>", step))
        return config

    return build


def _sublane(folder: Path) -> Path:
    config = TEN["actuated lights"](folder)
    sublane = '<processing><lateral-resolution value="0.8"/></processing></configuration>'
    config.write_text(config.read_text().replace("</configuration>", sublane))
    return config


HARDER: dict[str, Callable[[Path], Path]] = {
    "persons": _persons,
    "sublane": _sublane,
    "zipped, from 1000 s": _several_zipped,
    "no internal links": _bound,
    "steps of 0.5 s": _with_steps(0.5),
    "steps of 1 s": _with_steps(1.0),
    **{
        f"SUMO's {name}": (lambda _, name=name: SUMOS_OWN / f"{name}.sumocfg")
        for name in ("A10KW", "square", "cross", "grid6", "fokr_bs_demo", "DRT", "ramp")
    },
    "SUMO's racing": lambda _: SUMOS_OWN / "racing" / "racing.sumocfg",
}


def _of_class(permission: str) -> Callable[[Path], Path]:
    kind = f'<vType id="t" vClass="{permission}"/>'
    edges = (
        f'<edge id="ab" from="a" to="b" allow="{permission}" speed="20"/>'
        f'<edge id="bc" from="b" to="c" allow="{permission}" speed="20"/>'
    )
    return _plain(_ROAD, edges, kind + _flows(("ab", "bc", 600), kind=' type="t"'))


def _edges(lanes: int = 1) -> str:
    return "".join(
        f'<edge id="{a}{b}" from="{a}" to="{b}" numLanes="{lanes}" speed="13.9"/>'
        for a, b in ("ab", "bc")
    )


def _standing() -> str:
    return "".join(
        f'<vehicle id="v{number}" depart="0" departPos="{20 * number + 20}"><route edges="ab bc"/>'
        f'<stop lane="ab_0" endPos="{20 * number + 20}" duration="9999"/></vehicle>'
        for number in range(5)
    )


def _meso(folder: Path) -> Path:
    config = TEN["grid"](folder)
    meso = '<mesoscopic><mesosim value="true"/></mesoscopic></configuration>'
    config.write_text(config.read_text().replace("</configuration>", meso))
    return config


def _without(name: str) -> Callable[[Path], Path]:
    def build(folder: Path) -> Path:
        config = TEN["single edge"](folder)
        shutil.move(folder / name, folder / "elsewhere.xml")
        return config

    return build


NOBODY: dict[str, tuple[Callable[[Path], Path], str]] = {
    "rail only": (_of_class("rail"), "no car, truck or bus is among the vehicles"),
    "bicycles only": (_of_class("bicycle"), "no car, truck or bus is among the vehicles"),
    "no vehicles": (_plain(_ROAD, _edges(), ""), "there is no vehicle from"),
    "nobody moves": (_plain(_ROAD, _edges(), _standing()), "must move, and none does"),
    "one vehicle": (
        _plain(_ROAD, _edges(), '<trip id="v" depart="0" from="ab" to="bc"/>'),
        "has another vehicle within 50 m",
    ),
}
"""Networks where there is nobody to attack, and what is said of it."""

REFUSED: dict[str, tuple[Callable[[Path], Path], str]] = {
    "mesoscopic": (_meso, "mesoscopic"),
    "no routes": (_without("my.rou.xml"), "my.rou.xml"),
    "no network": (_without("net.net.xml"), "net.net.xml"),
}
"""Configurations that cannot be run, and what is named of it."""
