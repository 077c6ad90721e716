"""The part of a network that is attacked: junctions, edges, and polygons of a file."""

import difflib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Final

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from deepmf_sumo import files
from deepmf_sumo.errors import SimulationError, UsageError
from deepmf_sumo.scene import Bools, Floats
from deepmf_sumo.spec import Moments
from deepmf_sumo.sumo.network.sumo_net import NetFile, elements, points, read_once, truth
from deepmf_sumo.sumo.simulation.traffic_survey import Sightings

_LARGEST: Final = 2**26
_POLYGONS: Final = {"Polygon", "MultiPolygon"}
_SLOWEST_MPS: Final = 3.0
"""A vehicle that stands now may be at the junction soon."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AttackArea:
    """Where AVs are attacked: at any of these places.

    Attributes:
        junctions, edges: ids. streets: names, each with the ids of its edges.
        polygon: in the network's frame, or of longitudes and latitudes if ``geographic``; None
            without one.
    """

    junctions: tuple[str, ...] = ()
    edges: tuple[str, ...] = ()
    streets: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    polygon: BaseGeometry | None = None
    geographic: bool = False

    @property
    def corners(self) -> tuple[tuple[float, float], ...]:
        """Longitudes and latitudes that SUMO has to project; none if it is not geographic."""
        if self.polygon is None or not self.geographic:
            return ()
        return tuple((float(x), float(y)) for x, y in shapely.get_coordinates(self.polygon))

    def __str__(self) -> str:
        named = [f"junction {one}" for one in self.junctions]
        of_streets = set(chain.from_iterable(self.streets.values()))
        named += [f"edge {one}" for one in self.edges if one not in of_streets]
        named += list(self.streets)
        return ", ".join(named + ["the polygon"] * (self.polygon is not None))


def area_of(asked: Moments, net_file: Path, named: Callable[[str], str]) -> AttackArea | None:
    """The area of a spec; None where it is the whole network.

    ``named`` tells how messages call a key. Raises UsageError for an id that is not in the network
    and for a file without a polygon that can be placed in it, SimulationError for a network that
    cannot be read.
    """
    if not (asked.junctions or asked.edges or asked.polygon):
        return None
    net = read_once(net_file)
    normal = [edge.id for edge in net.edges.values() if not edge.function]
    streets: dict[str, list[str]] = {}
    for edge in net.edges.values():
        if edge.name and not edge.function:
            streets.setdefault(edge.name, []).append(edge.id)
    _known(named("junctions"), "junction", asked.junctions, [one.id for one in net.junctions])
    _known(named("edges"), "edge", asked.edges, [*normal, *streets])
    meant = {one: tuple(streets[one]) for one in asked.edges if one not in set(normal)}
    edges = chain.from_iterable(meant.get(one, (one,)) for one in asked.edges)
    polygon, geographic = None, False
    if asked.polygon is not None:
        polygon, geographic = read_polygon(asked.polygon, named("polygon"))
        if geographic and not net.location.geographic:
            raise UsageError(
                f"{named('polygon')} {asked.polygon}: it has longitudes and latitudes, and"
                f" {net_file.name} has no projection; give polygons of SUMO (<poly>) in metres."
            )
    return AttackArea(
        junctions=asked.junctions,
        edges=tuple(dict.fromkeys(edges)),
        streets=meant,
        polygon=polygon,
        geographic=geographic,
    )


def _known(option: str, kind: str, names: Sequence[str], known: Sequence[str]) -> None:
    for name in names:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=3, cutoff=0.4) or sorted(known)[:3]
            raise UsageError(
                f"{option} {name}: no such {kind} is in the network; there are"
                f" {', '.join(near)}{' and others' * (len(known) > len(near))}."
            )


def read_polygon(file: Path, option: str) -> tuple[BaseGeometry, bool]:
    """The union of a file's polygons, and whether they are of longitudes and latitudes.

    The file is GeoJSON (RFC 7946), or has ``<poly>`` as SUMO writes them. Raises UsageError.
    """
    try:
        text = files.text(file, _LARGEST).lstrip("\ufeff \t\r\n")
    except (OSError, UnicodeError) as error:
        why = files.reason(error) if isinstance(error, OSError) else "it is not UTF-8"
        raise UsageError(f"{option} {file}: it cannot be read ({why}).") from None
    try:
        found = _of_sumo(file) if text.startswith("<") else (_of_geojson(text), True)
    except (shapely.errors.ShapelyError, SimulationError, ValueError) as error:
        raise UsageError(
            f"{option} {file}: it is neither GeoJSON nor a file of SUMO polygons ({error})."
        ) from None
    if found is None:
        raise UsageError(f"{option} {file}: its polygons are partly geographic; give one kind.")
    polygon, geographic = found
    if polygon.is_empty or polygon.area == 0:
        raise UsageError(f"{option} {file}: it has no polygon of three corners or more.")
    return polygon, geographic


def _of_geojson(text: str) -> BaseGeometry:
    whole = shapely.from_geojson(text)
    parts = [one for one in _parts(whole) if one.geom_type in _POLYGONS]
    return shapely.unary_union(parts)


def _parts(whole: BaseGeometry) -> Iterator[BaseGeometry]:
    for one in shapely.get_parts(whole):
        if one.geom_type == "GeometryCollection":
            yield from _parts(one)
        else:
            yield one


def _of_sumo(file: Path) -> tuple[BaseGeometry, bool] | None:
    """The same of SUMO's ``<poly>``; None where some are geographic and some are not."""
    drawn, kinds = [], set()
    for element in elements(file, "polygon"):
        if element.tag == "poly":
            corners = points(element.get("shape", ""))[:, :2]
            if len(corners) > 2:
                drawn.append(shapely.make_valid(shapely.Polygon(corners)))
                kinds.add(truth(element.get("geo", "")))
    if len(kinds) > 1:
        return None
    return shapely.unary_union(drawn), kinds == {True}


def gets_there(sightings: Sightings, duration_s: float) -> Bools:
    """(K) whether it reaches the next junction within the attack, at its present speed."""
    way_m = duration_s * np.maximum(sightings.speed_mps, _SLOWEST_MPS)
    reached: Bools = sightings.to_end_m <= way_m
    return reached


def inside(area: AttackArea, sightings: Sightings, net: NetFile, duration_s: float) -> Bools:
    """(K) whether an attack on the vehicle is in the area.

    On one of the edges; at one of the junctions, or before it and there within the attack; or
    within the polygon when the attack begins.
    """
    edges = np.array([edge in area.edges for edge in sightings.edges], bool)
    ends = (net.edges[edge].end if edge in net.edges else "" for edge in sightings.edges)
    before = np.array([end in area.junctions for end in ends], bool)
    found: Bools = edges[sightings.edge] & (sightings.to_end_m > 0)
    found |= before[sightings.edge] & gets_there(sightings, duration_s)
    if area.polygon is not None:
        polygon = area.polygon
        if area.geographic:
            polygon = shapely.set_coordinates(polygon, np.array(sightings.projected_m))
        shapely.prepare(polygon)
        at: Floats = sightings.position_m
        found |= shapely.intersects_xy(polygon, at[:, 0], at[:, 1])
    return found
