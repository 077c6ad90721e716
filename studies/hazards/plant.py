"""One flaw in any network: ``python studies/hazards/plant.py CONFIG.sumocfg --flaw NAME OUT``.

Copies a SUMO configuration with the files that it names into OUT/sound and OUT/flawed, and plants
one flaw of `flaws.py` in OUT/flawed, at a junction drawn by ``--seed`` from those where the flaw is
not yet and where two conflicting movements have ``--least`` vehicles each. These are counted in a
run of the configuration by SUMO, from ``--from`` to ``--until``. OUT/place.json says where and what
was changed. Sound and flawed are written alike: nothing else differs. Against the original, XML
comments are left out where a file is edited, a packed network is unpacked, files lie in one folder,
and the settings of sumo-gui are gone.
Ends with 2 where no place is suitable. Same arguments, same bytes.
"""

# ruff: noqa: INP001, T201, S314 - a script beside data, not a package; files are the user's own

import argparse
import gzip
import itertools
import os
import re
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple
from zlib import crc32

import numpy as np
import sumo
from flaws import FASTER, FLAWS, Junction, Network, Way

from deepmf_sumo import files
from deepmf_sumo.errors import DeepmfError, OutputError, SimulationError, UsageError
from deepmf_sumo.sumo.simulation.sumo_config import Configuration, read_configuration

LEAST: Final = 10
"""Vehicles on each of two conflicting movements."""
LONGEST_S: Final = 600.0
"""Of the count, from the beginning on, without ``--until``."""
SUMO: Final = Path(sumo.SUMO_HOME) / "bin" / "sumo"
TO_ROOT: Final = "../" * 64
"""SUMO puts its prefix between an output's folder and its name."""
MAX_MPS: Final = {"truck": 36.1, "trailer": 36.1, "coach": 27.8, "bus": 23.6} | dict.fromkeys(
    ("bicycle", "pedestrian", "moped", "scooter", "wheelchair", "tram", "rail", "rail_urban"), 0.0
)
"""SUMO's own by class, where a type does not say; 0 for those that are no cars; others 55.6."""
INPUT: Final = re.compile(r"(-files?|^additional|^route-?files|^net|^load-state)$")


class Window(NamedTuple):
    """Of time in which vehicles are counted and attacked, in seconds of the simulation."""

    start: float
    end: float


class Passed(NamedTuple):
    """Vehicles by movement: all, and those that can drive at a faster limit than theirs."""

    all: Counter[Way]
    able: Counter[tuple[Way, str]]


class Copy:
    """A configuration's files, read once; `write` makes a folder of them."""

    def __init__(self, config: Configuration) -> None:
        self.config = config
        self.options = _tree(config.file)
        self.trees: dict[str, ET.ElementTree[ET.Element]] = {}
        self.kept: dict[str, Path] = {}
        for section in (self.options.getroot(), *self.options.getroot()):
            for option in [one for one in section if INPUT.search(one.tag)]:
                if "gui" in option.tag:
                    section.remove(option)
                elif "output" not in option.tag:
                    self._take(option)

    def _take(self, option: ET.Element) -> None:
        key = "value" if "value" in option.attrib else "v"
        names = []
        for text in option.get(key, "").split(","):
            path = Path(os.path.expandvars(text.strip()))
            path = path if path.is_absolute() else (self.config.file.parent / path).resolve()
            name = self._free(path.name)
            if path == self.config.net or self._has_lights(option.tag, path):
                name = name.removesuffix(".gz")
                self.trees[name] = _tree(path)
                if path == self.config.net:
                    self.net = name
            else:
                self.kept[name] = path
            if path in (*self.config.additional, *self.config.routes):
                self._take_named(path)
            names.append(name)
        option.set(key, ",".join(names))

    def _free(self, name: str) -> str:
        """Files of several folders may have one name."""
        taken = {*self.trees, *self.kept, self.config.file.name}
        numbers = (name if not n else f"{n}_{name}" for n in range(len(taken) + 1))
        return next(one for one in numbers if one not in taken)

    def _has_lights(self, tag: str, path: Path) -> bool:
        return tag.startswith("additional") and any(True for _ in _tree(path).iter("tlLogic"))

    def _take_named(self, path: Path) -> None:
        """What a file of the configuration names itself, by a path beside it."""
        for element in _elements(path):
            for key in ("file", "href"):
                text = element.get(key, "")
                if text and (path.parent / text).is_file():
                    if Path(text).is_absolute() or ".." in Path(text).parts:
                        raise UsageError(
                            f"'{path}' names the file '{text}' in <{element.tag}>, which does not"
                            " lie beside it and is not copied; put it there."
                        )
                    self.kept.setdefault(text, path.parent / text)

    def network(self) -> Network:
        """The trees, for flaws to change."""
        others = [tree.getroot() for name, tree in self.trees.items() if name != self.net]
        return Network(self.trees[self.net].getroot(), others)

    def write(self, folder: Path) -> None:
        """Write all files. Raises OutputError."""
        with files.writing(folder):
            folder.mkdir(parents=True)
            for name, path in self.kept.items():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, folder / name)
            for name, tree in {**self.trees, self.config.file.name: self.options}.items():
                tree.write(folder / name, encoding="UTF-8", xml_declaration=True)


def _tree(path: Path) -> "ET.ElementTree[ET.Element]":
    """Raises SimulationError for a file that is not XML."""
    try:
        with _opened(path) as stream:
            return ET.ElementTree(ET.parse(stream).getroot())
    except (ET.ParseError, OSError, EOFError) as error:
        raise SimulationError(f"'{path}' cannot be read as XML: {error}.") from None


def _opened(path: Path) -> Any:
    with path.open("rb") as stream:
        packed = stream.read(2) == b"\x1f\x8b"
    return gzip.open(path) if packed else path.open("rb")


def _elements(path: Path) -> Iterator[ET.Element]:
    try:
        with _opened(path) as stream:
            for _, element in ET.iterparse(stream, events=("start",)):
                yield element
    except (ET.ParseError, OSError, EOFError) as error:
        raise SimulationError(f"'{path}' cannot be read as XML: {error}.") from None


def window(config: Configuration, start_s: float | None, until_s: float | None) -> Window:
    """From and until, by default the first ten minutes. Raises UsageError for an empty one."""
    start = config.begin_s if start_s is None else start_s
    end = until_s if until_s is not None else min(config.end_s or np.inf, start + LONGEST_S)
    if end <= start:
        raise UsageError(f"There is no time from {start:g} to {end:g} s; give --until after it.")
    return Window(start, float(end))


def passed(config: Configuration, time: Window) -> Passed:
    """Vehicles over each movement in a run of the configuration. Raises SimulationError."""
    with tempfile.TemporaryDirectory(prefix="plant-") as folder:
        command = [
            SUMO, "-c", config.file, "--end", f"{time.end:g}", "--no-step-log", "--no-warnings",
            "--random", "false", "--remote-port", "0", "--xml-validation", "never",
            "--vehroute-output", f"{folder}/passed.xml",
            "--vehroute-output.exit-times", "--vehroute-output.write-unfinished",
            "--output-prefix", f"{TO_ROOT}{folder.lstrip('/')}/",
        ]  # fmt: skip
        done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)
        if done.returncode:
            words = " ".join(done.stderr.split())
            raise SimulationError(f"SUMO does not run '{config.file}': {words}")
        types = _types(config)
        found = Passed(Counter(), Counter())
        for element in _elements_whole(Path(folder) / "passed.xml", "vehicle"):
            kind = element.get("type", "DEFAULT_VEHTYPE").partition("@")[0]
            for way in _ways(element, time):
                found.all[way] += 1
                found.able[way, kind] += 1
    able: Counter[tuple[Way, str]] = Counter()
    for (way, kind), count in found.able.items():
        able[way, f"{types.get(kind, 55.6):g}"] += count
    return Passed(found.all, able)


def _elements_whole(path: Path, tag: str) -> Iterator[ET.Element]:
    for _, element in ET.iterparse(path):
        if element.tag == tag:
            yield element
            element.clear()


def _ways(vehicle: ET.Element, time: Window) -> Iterator[Way]:
    """Movements that a vehicle made in the time: it left the edge before."""
    route = list(vehicle.iter("route"))[-1:]
    for one in route:
        edges = one.get("edges", "").split()
        exits = [float(text) for text in one.get("exitTimes", "").split()]
        for way, left in zip(itertools.pairwise(edges), exits, strict=False):
            if time.start <= left <= time.end:
                yield way


def _types(config: Configuration) -> dict[str, float]:
    """The highest speed of each type, in m/s; less where it keeps well below limits."""
    found = {}
    for path in (*config.routes, *config.additional):
        for one in _elements(path):
            if one.tag == "vType":
                usual = MAX_MPS.get(one.get("vClass", "passenger"), 55.6)
                speed = float(one.get("maxSpeed", usual))
                numbers = re.findall(r"[\d.]+", one.get("speedFactor", "1"))
                slow = bool(numbers) and float(numbers[0]) < 1 / FASTER**0.5
                found[one.get("id", "")] = 0.0 if slow else speed
    return found


def places(
    network: Network, flaw: str, traffic: Passed, least: int
) -> list[tuple[Junction, tuple[int, int]]]:
    """Suitable junctions by id, each with its busiest conflict: most on the lesser movement."""
    found = []
    for junction in network.junctions:
        best = (least - 1, (0, 0))
        for pair in FLAWS[flaw].where(network, junction):
            one, other = (junction.links[row].way for row in pair)
            first = traffic.all[one]
            if flaw == "fast_approach":
                need = FASTER * network.limit_mps(one[0])
                first = sum(
                    count
                    for (way, speed), count in traffic.able.items()
                    if way == one and float(speed) >= need
                )
            best = max(best, (min(first, traffic.all[other]), pair))
        if best[0] >= least:
            found.append((junction, best[1]))
    return found


def plant(
    file: Path, flaw: str, seed: int, out: Path, *, least: int = LEAST,
    start_s: float | None = None, until_s: float | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Write OUT/sound, OUT/flawed and OUT/place.json; returns the latter.

    Raises UsageError where no place is suitable, SimulationError for a configuration that SUMO
    does not run, OutputError for a folder that is there.
    """
    if out.exists():
        raise OutputError(f"{out} is there already; name a folder that is not.")
    config = read_configuration(file)
    time = window(config, start_s, until_s)
    traffic = passed(config, time)
    copy = Copy(config)
    network = copy.network()
    suitable = places(network, flaw, traffic, least)
    if not suitable:
        raise UsageError(
            f"'{file}' has no place for {flaw} among {len(network.junctions)} junctions: it takes"
            f" {FLAWS[flaw].needs}, with {least} vehicles on both ways from {time.start:g} to"
            f" {time.end:g} s."
        )
    drawn = np.random.default_rng([seed, crc32(flaw.encode())]).integers(len(suitable))
    junction, pair = suitable[int(drawn)]
    ways = [junction.links[row].way for row in pair]
    place = {
        "configuration": config.file.name,
        "flaw": flaw,
        "seed": seed,
        "junction": junction.name,
        "suitable": [one.name for one, _ in suitable],
        "conflict": [" -> ".join(way) for way in ways],
        "vehicles": [traffic.all[way] for way in ways],
        "from_s": time.start,
        "until_s": time.end,
    }
    with files.writing(out), files.whole_folder(out) as folder:
        copy.write(folder / "sound")
        place["changed"] = FLAWS[flaw].plant(network, junction, pair)
        copy.write(folder / "flawed")
        files.write_json(folder / "place.json", place)
    return place


def main() -> int:
    """Plant the flaw; one line says where."""
    parser = argparse.ArgumentParser(description="Plant one flaw in a network.")
    parser.add_argument("config", type=Path, metavar="CONFIG.sumocfg")
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--flaw", required=True, choices=FLAWS)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--least", type=int, default=LEAST, help="vehicles on each of two movements"
    )
    parser.add_argument("--from", type=float, dest="start_s", metavar="S")
    parser.add_argument("--until", type=float, dest="until_s", metavar="S")
    given = parser.parse_args()
    try:
        place = plant(
            given.config, given.flaw, given.seed, given.out, least=given.least,
            start_s=given.start_s, until_s=given.until_s,
        )  # fmt: skip
    except DeepmfError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    counts, ways = (" and ".join(map(str, place[key])) for key in ("vehicles", "conflict"))
    print(
        f"{place['flaw']} at junction {place['junction']}, one of {len(place['suitable'])}"
        f" suitable; {counts} vehicles on {ways}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
