"""A SUMO configuration with changes, beside the same one without them.

Signal programs and limits are changed in SUMO's own XML, and nothing else is different. Where a
change needs netconvert, both networks are built by it from the same one, for it computes junctions
anew. The changes are also written as a patch, which netconvert and netedit take.

Controllers may ignore what a file says. So SUMO runs the changed configuration for four minutes and
notes the signal's states. Each yellow, and each time from the end of a yellow to the green of a way
that meets it, must be as long as asked for.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple
from xml.sax.saxutils import quoteattr

from deepmf_sumo import files
from deepmf_sumo.errors import ConversionError, SimulationError, UsageError, nearest
from deepmf_sumo.roadcheck.countermeasures import signals
from deepmf_sumo.roadcheck.countermeasures.document import Change
from deepmf_sumo.roadcheck.countermeasures.signals import Foes
from deepmf_sumo.sumo.network import sumo_tools
from deepmf_sumo.sumo.network.sumo_net import ROAD_VEHICLES, read_once
from deepmf_sumo.sumo.simulation import files_read, sumo_options
from deepmf_sumo.sumo.simulation.sumo_config import (
    Configuration,
    Traffic,
    command_line,
    read_configuration,
)

PATCH: Final = "patch"
_LARGEST: Final = 2_000_000_000
_LEAST_BEHIND_M: Final = 10.0
"""Of the edge behind one that has become longer."""
_HEADER: Final = re.compile(rb"<!-- generated on .*?-->\n*", re.DOTALL)
"""Date and paths, which netconvert writes on top."""
Tree = ET.ElementTree
_SECONDS: Final = 240.0
_SLACK_S: Final = 0.11
"""A step of SUMO, and rounding."""
_STATES: Final = "signal-states.xml"
_CHANGED: Final = ("net-file", "additional-files")
"""Options of SUMO that name what is changed."""
_GREEN, _YELLOW = "Gg", "yY"
_ACROSS: Final = {False: ("l", "L", "t"), True: ("r", "R", "T")}
"""Directions of links across oncoming traffic (turn, half turn, back), by whether it keeps left."""

State = tuple[float, str]
"""From when on a signal shows which letters."""


class Short(NamedTuple):
    """A time that is too short: which (``yellow``, ``all-red``), how long, of which link, when."""

    kind: str
    seconds: float
    link: int
    time_s: float


def check(config: Path, change: Change, foes: Foes, options: Sequence[str] = ()) -> str:
    """A sentence on what SUMO, with its ``options``, shows of a changed signal.

    Raises UsageError where that is not what was asked for, SimulationError if SUMO cannot be run.
    """
    states = list(_states(config, change.signal or "", options))
    wanted = {"yellow": change.yellow_s, "all-red": change.all_red_s}
    found = list(too_short(states, foes, wanted))
    if found:
        one = min(found, key=lambda short: short.time_s)
        raise UsageError(
            f"signal '{change.signal}': SUMO shows {one.seconds:.1f} s of {one.kind} at"
            f" {one.time_s:.1f} s (link {one.link}), and {wanted[one.kind]:g} s were asked for: its"
            " controller does not take the change; change it in netedit."
        )
    if len({state for _, state in states}) < 2:
        return f"signal '{change.signal}': it shows one state for {_SECONDS:g} s in SUMO"
    return f"signal '{change.signal}': SUMO shows what was asked for"


def too_short(
    states: Sequence[State], foes: Foes, wanted: dict[str, float | None]
) -> Iterator[Short]:
    """Times of yellow and of all-red that are below what is wanted."""
    if not states:
        return
    yellow_s, red_s = wanted.get("yellow"), wanted.get("all-red")
    ended: dict[int, float] = {}
    since: dict[int, float] = {}
    last = states[0][1]
    for time_s, state in states[1:]:
        for link, (old, new) in enumerate(zip(last, state, strict=True)):
            if old in _GREEN and new not in _GREEN:
                since[link] = time_s
            if new not in _YELLOW and new not in _GREEN and link in since:
                shown_s = time_s - since.pop(link)
                ended[link] = time_s
                if yellow_s is not None and shown_s < yellow_s - _SLACK_S:
                    yield Short("yellow", shown_s, link, time_s - shown_s)
        for link, (old, new) in enumerate(zip(last, state, strict=True)):
            if red_s is None or old in _GREEN or new not in _GREEN:
                continue
            for other, end_s in ended.items():
                if other != link and foes(link, other) and time_s - end_s < red_s - _SLACK_S:
                    yield Short("all-red", time_s - end_s, link, end_s)
        last = state


def _states(config: Path, signal: str, options: Sequence[str]) -> Iterable[State]:
    configuration = read_configuration(config, options)
    event = f'<timedEvent type="SaveTLSSwitchStates" source={quoteattr(signal)} dest="{_STATES}"/>'
    traffic = Traffic(configuration=configuration, seed=configuration.seed)
    with command_line(traffic, event) as (arguments, folder):
        end_s = configuration.begin_s + _SECONDS
        try:
            sumo_tools.run("sumo", *arguments, "--end", f"{end_s:.12g}", timeout_s=600.0)
        except ConversionError as error:
            raise SimulationError(f"SUMO cannot run '{config}': {error}") from None
        events = ET.parse(folder / _STATES).iter("tlsState")  # noqa: S314 - SUMO wrote it
        return [(float(one.get("time", "0")), one.get("state", "")) for one in events]


@dataclass(frozen=True, slots=True, kw_only=True)
class Built:
    """What has been written.

    Attributes:
        before, after: configurations; ``before`` is the given one where netconvert was not needed.
        patch: a folder; options for netconvert stand in ``patch/README.txt``.
        done: a sentence for each change.
        junctions, edges: where attacks meet the changes.
    """

    before: Path
    after: Path
    patch: Path
    done: tuple[str, ...]
    junctions: tuple[str, ...]
    edges: tuple[str, ...]


def build(config: Path, changes: Sequence[Change], out: Path, options: Sequence[str] = ()) -> Built:
    """Write the changed configuration to ``out/after``, the patch to ``out/patch``.

    ``options`` are SUMO's, with which both sides are run.

    Raises SimulationError for a configuration that cannot be read, UsageError for a change that
    names nothing in the network or cannot be made, where nothing changes, and for options that
    name the files to change, ConversionError of netconvert, OutputError.
    """
    if wrong := set(_CHANGED) & sumo_options.parse(options).keys():
        raise UsageError(
            f"SUMO's option --{min(wrong)} cannot be given here: both sides would have that file,"
            f" and none the change; name it in '{config}'."
        )
    given = read_configuration(config, options)
    with files.writing(out):
        work = _Work(given, changes, out)
        return work.built()


class _Work:
    """The trees of a configuration, and what becomes of them."""

    def __init__(self, config: Configuration, changes: Sequence[Change], out: Path) -> None:
        self.config, self.changes, self.out = config, changes, out
        self.name = config.net.name.removesuffix(".gz")
        self.patches: dict[str, ET.Element] = {}
        self.done: list[str] = []
        self.effective = False
        self._check_names()

    @cached_property
    def net(self) -> Any:
        """The given network, as sumolib reads it."""
        import sumolib

        return sumolib.net.readNet(str(self.config.net), withPrograms=True)

    def built(self) -> Built:
        """Write all. Raises as `build`."""
        rebuilt = any(one.rebuilds for one in self.changes)
        before = self.config.file
        nets = {"after": self.config.net}
        if rebuilt:
            for change in self.changes:
                self._patch(change)
            if all(one.control for one in self.changes):
                self._check_effect()  # before anything is written
            nets = {side: self._converted(side) for side in ("before", "after")}
            before = self._configuration("before", nets["before"], {})
        trees = self._changed(nets["after"])
        self._check_effect()
        after = self._configuration("after", nets["after"], trees)
        for change in self.changes:
            if change.signal:
                foes, _ = self._links(self.net.getTLS(change.signal))
                self.done.append(check(after, change, foes, self.config.options))
        self._write_patch()
        return Built(
            before=before, after=after, patch=self.out / PATCH, done=tuple(self.done),
            junctions=tuple(sorted(self._junctions())), edges=tuple(sorted(self._edges())),
        )  # fmt: skip

    def _check_names(self) -> None:
        kinds = {
            "signal": [one.getID() for one in self.net.getTrafficLights()],
            "edge": [one.getID() for one in self.net.getEdges(withInternal=False)],
            "junction": [one.getID() for one in self.net.getNodes()],
        }
        for change in self.changes:
            for kind, known in kinds.items():
                name = getattr(change, kind)
                if name is not None and name not in known:
                    raise UsageError(
                        f"no {kind} '{name}' is in '{self.config.net}'.{nearest(name, known)}"
                    )

    def _check_effect(self) -> None:
        if not self.effective:
            raise UsageError(
                f"nothing changes: {'; '.join(self.done)}. There is nothing to compare; ask for"
                " more than the network has."
            )

    def _junctions(self) -> Iterator[str]:
        for change in self.changes:
            if change.junction:
                yield change.junction
            if change.signal:
                light = self.net.getTLS(change.signal)
                yield from {
                    lane.getEdge().getToNode().getID() for lane, _, _ in light.getConnections()
                }

    def _edges(self) -> Iterator[str]:
        for change in self.changes:
            if change.edge:
                yield change.edge
                if change.ending_lane_m:  # vehicles come into conflict from behind it on
                    yield from (one.getID() for one in self.net.getEdge(change.edge).getIncoming())

    def _patch(self, change: Change) -> None:
        """What netconvert needs to know of a change; nothing for others."""
        if change.control:
            node = self.net.getNode(change.junction)
            self.effective |= node.getType() != change.control
            self.done.append(f"{change.what}: {node.getType()} becomes {change.control}")
            self._add("nod", "nodes", "node", id=change.junction or "", type=change.control)
        if change.ending_lane_m:
            self._lengthen(change.edge or "", change.ending_lane_m)

    def _add(self, file: str, root: str, tag: str, **values: str) -> None:
        ET.SubElement(self.patches.setdefault(file, ET.Element(root)), tag, values)

    def _lengthen(self, name: str, length_m: float) -> None:
        """Move the end of an edge along the one behind it, which becomes shorter."""
        edge = self.net.getEdge(name)
        behind = list(edge.getOutgoing())
        into = list(edge.getToNode().getIncoming())
        if len(behind) != 1 or len(into) != 1 or behind[0].getLaneNumber() >= edge.getLaneNumber():
            raise UsageError(
                f"edge '{name}': ending_lane_m is for an edge that leads into one other edge with"
                " fewer lanes, and nothing else leads there."
            )
        first, more = edge.getLength(), length_m - edge.getLength()
        most = first + behind[0].getLength() - _LEAST_BEHIND_M
        if not 0 < more <= most - first:
            raise UsageError(
                f"edge '{name}': ending_lane_m is {length_m:g} m, and must be above its length of"
                f" {first:g} m and at most {most:g} m, where the edge behind it ends."
            )
        own, rest = _cut(behind[0].getRawShape(), more)
        shape = [*edge.getRawShape(), *own[1:]]
        x, y = own[-1]
        self._add("nod", "nodes", "node", id=edge.getToNode().getID(), x=f"{x:.2f}", y=f"{y:.2f}")
        self._add("edg", "edges", "edge", id=name, shape=_shape(shape))
        self._add("edg", "edges", "edge", id=behind[0].getID(), shape=_shape(rest))
        self.effective = True
        self.done.append(f"edge '{name}': {first:g} m becomes {length_m:g} m")

    def _converted(self, side: str) -> Path:
        """The network built by netconvert, with the patches in ``after``."""
        path = self.out / side / self.name
        path.parent.mkdir(parents=True, exist_ok=True)
        patches = []
        for file, option in (("nod", "-n"), ("edg", "-e")):
            if side == "after" and file in self.patches:
                patch = self.out / PATCH / f"patch.{file}.xml"
                _write(patch, ET.ElementTree(self.patches[file]))
                patches += [option, str(patch)]
        sumo_tools.run("netconvert", "-s", str(self.config.net), *patches, "-o", str(path))
        files.write(path, _HEADER.sub(b"", files.content(path, _LARGEST), count=1))
        return path

    def _changed(self, net: Path) -> Mapping[Path, "Tree[ET.Element]"]:
        """Trees of the network and of additional files with the other changes, by given path."""
        trees = {self.config.net: _tree(net)}
        trees |= {path: tree for path in self.config.additional if (tree := _tree(path, "tlLogic"))}
        for change in self.changes:
            if change.limit:
                self._limit(trees[self.config.net], change)
            if change.signal:
                self._signal(list(trees.values()), change)
        return trees

    def _limit(self, tree: "Tree[ET.Element]", change: Change) -> None:
        edge = next(one for one in tree.iter("edge") if one.get("id") == change.edge)
        old = {lane.get("speed", "") for lane in edge.iter("lane")}
        self.effective |= any(abs(float(one) - (change.limit or 0.0)) >= 0.005 for one in old)
        for lane in edge.iter("lane"):
            lane.set("speed", f"{change.limit:.2f}")
        self._add("edg", "edges", "edge", id=change.edge or "", speed=f"{change.limit:.2f}")
        limits = " and ".join(sorted(old))
        self.done.append(f"{change.what}: the limit of {limits} m/s becomes {change.limit:.2f} m/s")

    def _signal(self, trees: Sequence["Tree[ET.Element]"], change: Change) -> None:
        light = self.net.getTLS(change.signal)
        foes, lefts = self._links(light)
        programs = [
            one for tree in trees for one in tree.iter("tlLogic") if one.get("id") == change.signal
            and "off" not in {one.get("programID"), one.get("type")}
        ]  # fmt: skip
        if not programs:
            raise UsageError(
                f"signal '{change.signal}' has no program to change: '{self.config.net}' and the"
                " additional files have none, as for a rail signal or a light that TraCI controls."
            )
        for program in programs:
            name = change.signal or ""
            if program.get("type") == signals.NEMA:
                old, new = signals.change_nema(name, program, change)
            else:
                before, after = signals.changed(name, program, change, lefts, foes)
                signals.write(program, after)
                old, new = (" ".join(map(str, each)) for each in (before, after))
            self.effective |= old != new
            said = "stays as it is" if old == new else f"becomes {new}"
            self.done.append(f"{change.what}, program {program.get('programID')}: {old} {said}")
            patch = self.patches.setdefault("tll", ET.Element("tlLogics"))
            patch.append(program)

    def _links(self, light: Any) -> tuple[signals.Foes, list[int]]:
        """Which links of a light meet, and where motor vehicles turn across oncoming traffic.

        A light may have links at several junctions.
        """
        rows: dict[int, list[tuple[Any, int]]] = {index: [] for *_, index in light.getConnections()}
        lefts, across = [], _ACROSS[read_once(self.config.net).left_hand]
        for lane, into, index in light.getConnections():
            links = [one for one in lane.getOutgoing() if one.getToLane() == into]
            node = lane.getEdge().getToNode()
            rows[index] += [(node, node.getLinkIndex(one)) for one in links]
            motor = any(map(lane.allows, ROAD_VEHICLES))  # cyclists wait for gaps as before
            if motor and any(one.getDirection() in across for one in links):
                lefts.append(index)

        def foes(one: int, other: int) -> bool:
            return any(
                at is there and min(a, b) >= 0 and at.areFoes(a, b)
                for at, a in rows.get(one, ()) for there, b in rows.get(other, ())
            )  # fmt: skip

        return foes, lefts

    def _configuration(
        self, side: str, net: Path, trees: Mapping[Path, "Tree[ET.Element]"]
    ) -> Path:
        """Write a configuration with its changed files; it names the others where they lie."""
        folder = self.out / side
        changed = {self.config.net: net}
        for path, tree in trees.items():
            name = self.name if path == self.config.net else path.name.removesuffix(".gz")
            changed[path] = folder / name
            if path != self.config.net:
                _place_named(tree.getroot(), path.parent)
            _write(folder / name, tree)
        options = _tree(self.config.file)
        for section in list(options.iter()):
            for option in list(section):
                name = sumo_options.long_name(option.tag)
                if name == "gui-settings-file":
                    section.remove(option)
                elif sumo_options.names_files(name):
                    self._point(option, changed)
        file = folder / self.config.file.name
        _write(file, options)
        return file

    def _point(self, option: ET.Element, changed: Mapping[Path, Path]) -> None:
        name = sumo_options.long_name(option.tag)
        written = sumo_options.of_configuration(self.config.file).get(name, "")
        paths = sumo_options.paths(written, self.config.file.parent)
        option.attrib.pop("v", None)
        option.text = None
        moved = (changed.get(one, one).resolve() for one in paths)
        option.set("value", sumo_options.in_configuration(moved))

    def _write_patch(self) -> None:
        options = {"nod": "-n", "edg": "-e", "tll": "-i"}
        used = [
            (option, f"patch.{file}.xml")
            for file, option in options.items()
            if file in self.patches
        ]
        for file, root in self.patches.items():
            _write(self.out / PATCH / f"patch.{file}.xml", ET.ElementTree(root))
        words = " ".join(f"{option} {name}" for option, name in used)
        files.write(
            self.out / PATCH / "README.txt",
            f"netconvert -s {self.config.net} {words} -o changed.net.xml\n\n"
            + "".join(f"{line}\n" for line in self.done),
        )


def _cut(shape: Sequence[tuple[float, float]], at_m: float) -> tuple[Any, Any]:
    """A polyline (x, y) up to an arc length, and from there on."""
    from shapely import LineString
    from shapely.ops import substring

    line = LineString([one[:2] for one in shape])
    parts = substring(line, 0.0, at_m), substring(line, at_m, line.length)
    return parts[0].coords[:], parts[1].coords[:]


def _shape(points: Sequence[Sequence[float]]) -> str:
    return " ".join(f"{one[0]:.2f},{one[1]:.2f}" for one in points)


def _tree(path: Path, only: str = "") -> Any:
    """The XML of a file; None where it lacks the element ``only``. Raises SimulationError."""
    try:
        with files.unpacked(path, _LARGEST) as stream:
            tree = ET.ElementTree(ET.parse(stream).getroot())  # noqa: S314 - the user's own
    except (ET.ParseError, OSError, EOFError) as error:
        raise SimulationError(f"'{path}' cannot be read as XML: {error}.") from None
    return tree if not only or any(True for _ in tree.iter(only)) else None


def _place_named(root: ET.Element, folder: Path) -> None:
    """Files to be read that an additional file names beside itself are found from elsewhere."""
    for element in root.iter():
        for key in ("file", "href") if element.tag in files_read.NAMING else ():
            text = element.get(key, "")
            if text and (folder / text).is_file():
                element.set(key, str((folder / text).resolve()))


def _write(path: Path, tree: "Tree[ET.Element]") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    ET.indent(tree)
    files.write(path, ET.tostring(tree.getroot(), encoding="utf-8", xml_declaration=True))
