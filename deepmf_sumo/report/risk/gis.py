"""The risk map for geographic information systems: places and attacks as GeoJSON and GeoPackage.

SUMO's coordinates are those of the network's projection plus ``netOffset``, which is undone here.
GeoJSON (RFC 7946) knows longitude and latitude of WGS84 alone, so that a network without a
projection cannot be written; a GeoPackage holds the projection's own metres, or without a
projection the network's coordinates under an undefined reference system.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from deepmf_sumo.errors import UsageError
from deepmf_sumo.report.risk import geopackage
from deepmf_sumo.report.risk.sumo_files import areas
from deepmf_sumo.results import risk
from deepmf_sumo.results.risk import Network, PlaceRow
from deepmf_sumo.scene import Floats

if TYPE_CHECKING:
    import pyproj

Form = Literal["geojson", "gpkg"]
FORMS: Final[tuple[Form, ...]] = get_args(Form)
PLACES, ATTACKS = "places", "attacks"
GEOPACKAGE: Final = "risk.gpkg"
FILES: Final = {f"{PLACES}.geojson", f"{ATTACKS}.geojson", GEOPACKAGE}
_DIGITS: Final = 8
"""Of degrees: about a millimetre."""
Layers = Mapping[str, "Layer"]
Placed = Callable[[Floats], Floats]


@dataclass(frozen=True, slots=True, kw_only=True)
class Layer:
    """Features of one kind of geometry.

    Attributes:
        rows: attributes, each with the same names.
        shapes: in the network's coordinates; None for a place without an area.
    """

    rows: Sequence[Mapping[str, Any]]
    shapes: Sequence[BaseGeometry | None]


def check(networks: Sequence[Network], forms: Sequence[Form]) -> None:
    """Raise UsageError where a network cannot be written in one of the forms."""
    for network in networks:
        known = network.places.net.location.geographic
        if "geojson" in forms and not known:
            raise UsageError(
                f"geojson: the network {network.name} has the projection"
                f" '{network.places.net.location.projection}', which gives no longitude and"
                " latitude; ask for gpkg, which holds the network's own coordinates."
            )
        if forms and known:
            _reference(network)


def written(network: Network, rows: Sequence[PlaceRow], forms: Sequence[Form]) -> dict[str, bytes]:
    """The files of the forms, by name; the same map gives the same bytes.

    Raises UsageError as `check`.
    """
    check([network], forms)
    layers = {PLACES: _places(network, rows), ATTACKS: _attacks(network)}
    found: dict[str, bytes] = {}
    if "geojson" in forms:
        to_degrees = _degrees(network)
        found |= {
            f"{name}.geojson": _geojson(name, layer, to_degrees) for name, layer in layers.items()
        }
    if "gpkg" in forms:
        found[GEOPACKAGE] = _gpkg(network, layers)
    return found


def _places(network: Network, rows: Sequence[PlaceRow]) -> Layer:
    """A multipolygon for each row of ``risk.csv``; lanes that touch are one area."""
    return Layer(
        rows=[risk.columns(row) for row in rows],
        shapes=[_area(list(areas(network, row))) for row in rows],
    )


def _area(parts: Sequence[shapely.Polygon]) -> shapely.MultiPolygon | None:
    union = shapely.union_all(shapely.make_valid(np.array(parts, object)))
    pieces = [one for one in shapely.get_parts(union) if isinstance(one, shapely.Polygon)]
    if not pieces:
        return None
    # RFC 7946 wants outer rings counter-clockwise, whatever way the network draws them
    turned = [shapely.geometry.polygon.orient(one) for one in pieces]
    return shapely.MultiPolygon(turned)


def _attacks(network: Network) -> Layer:
    """A point for each row of ``attacks.csv``: the AV's centre when the attack was decided."""
    return Layer(
        rows=risk.attack_rows(network),
        shapes=[shapely.Point(one.place_m) for one in network.attacks],
    )


def _reference(network: Network) -> "pyproj.CRS":
    """Raises UsageError without pyproj, and for a projection that PROJ does not know."""
    try:
        import pyproj
    except ModuleNotFoundError:
        raise UsageError(
            f"--gis needs pyproj for the projection of the network {network.name}; install it with"
            ' `pip install "deepmf-sumo[gis]"`.'
        ) from None
    text = network.places.net.location.projection
    try:
        return pyproj.CRS.from_user_input(text)
    except pyproj.exceptions.CRSError:
        raise UsageError(
            f"--gis: the network {network.name} has projParameter '{text}', which PROJ does not"
            " know; correct it in the .net.xml and run the attacks again."
        ) from None


def _projected(network: Network) -> Placed:
    """From the network's coordinates (P, 2) to those of its projection."""
    offset = np.array(network.places.net.location.offset_m)
    return lambda points: points - offset


def _degrees(network: Network) -> Placed:
    """From the network's coordinates (P, 2) to longitude and latitude of WGS84."""
    import pyproj

    change = pyproj.Transformer.from_crs(_reference(network), "EPSG:4326", always_xy=True)
    projected = _projected(network)

    def placed(points: Floats) -> Floats:
        found = np.column_stack(change.transform(*projected(points).T))
        if not np.isfinite(found).all():
            raise UsageError(
                f"--gis: netOffset or projParameter of the network {network.name} are wrong: its"
                " coordinates have no longitude and latitude; correct its .net.xml and run the"
                " attacks again."
            )
        return np.round(found, _DIGITS)

    return placed


def _geojson(name: str, layer: Layer, placed: Placed) -> bytes:
    """A FeatureCollection with one feature a line."""
    features = [
        json.dumps(
            {
                "type": "Feature",
                "properties": dict(row),
                "geometry": shape and shapely.geometry.mapping(shape),
            },
            ensure_ascii=False,
            allow_nan=False,
        )
        for row, shape in zip(layer.rows, _shapes(layer, placed), strict=True)
    ]
    head = f'{{"type": "FeatureCollection", "name": "{name}", "features": ['
    return (head + "\n" + ",\n".join(features) + "\n]}\n").encode()


def _gpkg(network: Network, layers: Layers) -> bytes:
    known = network.places.net.location.geographic
    placed: Placed = _projected(network) if known else lambda points: points
    reference = geopackage.UNDEFINED
    if known:
        crs = _reference(network)
        reference = geopackage.Reference.of(crs.name, crs.to_wkt("WKT1_GDAL"), crs.to_authority())
    tables = [
        geopackage.GeoTable(
            name=name,
            geometry="MULTIPOLYGON" if name == PLACES else "POINT",
            columns=list(risk.ATTACKED)
            if name == ATTACKS
            else list(layer.rows[0])
            if layer.rows
            else [],
            rows=layer.rows,
            shapes=list(_shapes(layer, placed)),
        )
        for name, layer in layers.items()
    ]
    return geopackage.packed(tables, reference)


def _shapes(layer: Layer, placed: Placed) -> Iterator[BaseGeometry | None]:
    for shape in layer.shapes:
        yield None if shape is None else shapely.transform(shape, placed)
