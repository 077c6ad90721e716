"""How a map is drawn, in pictures and on pages alike: what, in which order, colour and width.

Buildings are part of it because they hide people: line of sight is judged with them.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import shapely

from deepmf_sumo.scene import Floats, RoadMap
from deepmf_sumo.scene.geometry.lane_map import per_road, width_m

_FILLED_M: Final = 5.0
"""Between lanes of one junction gaps up to twice this wide are part of it."""


class Shade(NamedTuple):
    """A colour on white pages and pictures, and on dark pages."""

    light: str
    dark: str


@dataclass(frozen=True, slots=True, kw_only=True)
class MapLayer:
    """Features of one kind, and how they look.

    Attributes:
        of: kind of the features.
        fill: of areas; of lanes, which are lines as wide as in the world.
        edge: of lines and outlines, ``edge_pt`` points wide.
        hatch: in pictures, as in matplotlib.
        words: in a key; empty where a map explains itself.
    """

    name: str
    of: str
    fill: Shade | None = None
    edge: Shade | None = None
    edge_pt: float = 0.9
    hatch: str = ""
    words: str = ""


_SURFACE: Final = Shade("#e9ecef", "#262b32")
_CENTRE: Final = Shade("#cfd5db", "#3b424b")
_LINE: Final = Shade("#b6bec7", "#4a525c")
_EDGE: Final = Shade("#6f7884", "#8b95a1")

LAYERS: Final = (
    MapLayer(name="water", of="water", fill=Shade("#cfe3f2", "#1a3142"), words="water"),
    MapLayer(
        name="building", of="building", words="buildings: they hide road users",
        fill=Shade("#dadada", "#3a3a3c"), edge=Shade("#a9a9ab", "#66666a"), edge_pt=0.8,
    ),
    MapLayer(
        name="footway", of="footway", words="sidewalks and other areas for people",
        fill=Shade("#f3e9d7", "#37301f"), edge=Shade("#d9c9ab", "#564a30"), edge_pt=0.6,
    ),
    MapLayer(
        name="track", of="track", words="tracks of trams and trains",
        fill=Shade("#e6deee", "#2f2838"), edge=Shade("#bdadd0", "#57486b"), edge_pt=0.6,
    ),
    MapLayer(name="junction", of="junction", fill=_SURFACE),
    MapLayer(name="lane", of="lane", fill=_SURFACE),
    MapLayer(
        name="crosswalk", of="crosswalk", words="crossings", hatch="//",
        fill=Shade("#ffffff", "#565e68"), edge=_LINE,
    ),
    MapLayer(name="centre", of="lane", edge=_CENTRE),
    MapLayer(name="line", of="line", edge=_LINE),
    MapLayer(name="edge", of="edge", edge=_EDGE, edge_pt=1.1),
)  # fmt: skip
"""From the lowest to the uppermost."""


class Feature(NamedTuple):
    """What is drawn of a map.

    Attributes:
        parts_m: (P, 2) each: a line; or an area's outline, and the outlines of its islands.
        width_m: of lanes; else 0.
    """

    kind: str
    parts_m: list[Floats]
    width_m: float = 0.0


@per_road
def features(road: RoadMap) -> list[Feature]:
    """All that is drawn of a road, see `LAYERS`."""
    found = [Feature("lane", [lane.centre_m], width_m(lane)) for lane in road.lanes.values()]
    found += [Feature("junction", area) for area in junctions(road)]
    for kind, lines in (("line", road.lines), ("edge", road.edges)):
        found += [Feature(kind, [one.points_m]) for one in lines]
    areas = (*road.polygons, *road.beside)
    drawn = {layer.of for layer in LAYERS}
    found += [
        Feature(one.kind, [one.points_m])
        for one in areas
        if one.kind in drawn and len(one.points_m) > 2
    ]
    return [one for one in found if len(one.parts_m[0]) > 1]


@per_road
def junctions(road: RoadMap) -> list[list[Floats]]:
    """The places where lanes cross: lanes of a junction, and what is between.

    Each an outline (P, 2), and those of its islands.
    """
    lanes = [
        shapely.LineString(lane.centre_m).buffer(width_m(lane) / 2, cap_style="flat")
        for lane in road.lanes.values()
        if lane.interpolating and len(lane.centre_m) > 1
    ]
    if not lanes:
        return []
    joined = shapely.union_all(lanes).buffer(_FILLED_M).buffer(-_FILLED_M)
    parts = shapely.get_parts(joined)
    return [
        [shapely.get_coordinates(ring) for ring in (one.exterior, *one.interiors)]
        for one in parts
        if isinstance(one, shapely.Polygon)
    ]
