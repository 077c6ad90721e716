"""A GeoPackage (OGC 12-128r18, version 1.3) of tables with geometries, as bytes.

It is an SQLite file with some fixed tables, which Python's own sqlite3 writes: GDAL or geopandas
would be some 100 MB more to install, and write the time of day into the file. The time of the last
change is a fixed one here, so that the same tables give the same bytes.
"""

import sqlite3
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, Self

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

Geometry = Literal["POINT", "MULTIPOLYGON"]
_APPLICATION: Final = 0x47504B47
"""``GPKG``: how a GeoPackage is known from another SQLite file."""
_VERSION: Final = 10300
_CHANGED: Final = "1970-01-01T00:00:00.000Z"
_OWN: Final = 100_000
"""Number of a reference system that no authority has one for."""
_FIXED: Final = """
CREATE TABLE gpkg_spatial_ref_sys (
    srs_name TEXT NOT NULL, srs_id INTEGER PRIMARY KEY, organization TEXT NOT NULL,
    organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL, description TEXT);
CREATE TABLE gpkg_contents (
    table_name TEXT NOT NULL PRIMARY KEY, data_type TEXT NOT NULL, identifier TEXT UNIQUE,
    description TEXT DEFAULT '', last_change DATETIME NOT NULL,
    min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE,
    srs_id INTEGER REFERENCES gpkg_spatial_ref_sys(srs_id));
CREATE TABLE gpkg_geometry_columns (
    table_name TEXT NOT NULL UNIQUE REFERENCES gpkg_contents(table_name), column_name TEXT NOT NULL,
    geometry_type_name TEXT NOT NULL,
    srs_id INTEGER NOT NULL REFERENCES gpkg_spatial_ref_sys(srs_id),
    z TINYINT NOT NULL, m TINYINT NOT NULL, PRIMARY KEY (table_name, column_name));
"""
_WGS84: Final = (
    'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],'
    'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4326"]]'
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Reference:
    """A coordinate reference system; ``definition`` is its well-known text."""

    id: int
    name: str
    organization: str
    number: int
    definition: str

    @classmethod
    def of(cls, name: str, definition: str, authority: tuple[str, str] | None) -> Self:
        """By name, well-known text, and authority with its code where there is one."""
        organization, code = authority or ("NONE", str(_OWN))
        number = int(code) if code.isdigit() else _OWN
        return cls(
            id=number, name=name, organization=organization, number=number, definition=definition
        )


UNDEFINED: Final = Reference(
    id=-1, name="Undefined Cartesian SRS", organization="NONE", number=-1, definition="undefined"
)
_ALWAYS: Final = (
    UNDEFINED,
    Reference(id=0, name="Undefined geographic SRS", organization="NONE", number=0,
              definition="undefined"),
    Reference(id=4326, name="WGS 84", organization="EPSG", number=4326, definition=_WGS84),
)  # fmt: skip
"""Those that each GeoPackage has."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GeoTable:
    """Features: rows with a geometry, or None, each."""

    name: str
    geometry: Geometry
    columns: Sequence[str]
    rows: Sequence[Mapping[str, Any]]
    shapes: Sequence[BaseGeometry | None]


def packed(tables: Sequence[GeoTable], reference: Reference) -> bytes:
    """The file; all shapes have the same reference system."""
    database = sqlite3.connect(":memory:")
    try:
        database.executescript(_FIXED)
        references = {one.id: one for one in (*_ALWAYS, reference)}
        database.executemany(
            "INSERT INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?, '')",
            [
                (one.name, one.id, one.organization, one.number, one.definition)
                for one in references.values()
            ],
        )
        for table in tables:
            _add(database, table, reference.id)
        database.execute(f"PRAGMA application_id = {_APPLICATION}")
        database.execute(f"PRAGMA user_version = {_VERSION}")
        database.commit()
        return database.serialize()
    finally:
        database.close()


def _add(database: sqlite3.Connection, table: GeoTable, reference: int) -> None:
    there = [one for one in table.shapes if one is not None]
    bounds = shapely.total_bounds(np.array(there, object)).tolist() if there else [None] * 4
    database.execute(
        "INSERT INTO gpkg_contents VALUES (?, 'features', ?, '', ?, ?, ?, ?, ?, ?)",
        (table.name, table.name, _CHANGED, *bounds, reference),
    )
    database.execute(
        "INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', ?, ?, 0, 0)",
        (table.name, table.geometry, reference),
    )
    columns = [f"{_quoted(name)} {_type(name, table)}" for name in table.columns]
    named = ", ".join(["fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL",
                       f"geom {table.geometry}", *columns])  # fmt: skip
    database.execute(f"CREATE TABLE {_quoted(table.name)} ({named})")
    marks = ", ".join("?" * (2 + len(columns)))
    database.executemany(
        f"INSERT INTO {_quoted(table.name)} VALUES ({marks})",  # noqa: S608 (names are quoted)
        [
            (number, None if shape is None else _blob(shape, reference),
             *(row[name] for name in table.columns))
            for number, (row, shape) in enumerate(
                zip(table.rows, table.shapes, strict=True), start=1
            )
        ],
    )  # fmt: skip


def _type(name: str, table: GeoTable) -> str:
    """Of all values that are there: a whole number among others is a number with decimals."""
    types = {type(row[name]) for row in table.rows if row[name] is not None}
    if types == {bool}:
        return "BOOLEAN"
    if types == {int}:
        return "INTEGER"
    return "DOUBLE" if types and types <= {int, float} else "TEXT"


def _blob(shape: BaseGeometry, reference: int) -> bytes:
    """Header without an envelope (little-endian), and well-known binary."""
    header = struct.pack("<2sBBi", b"GP", 0, 1, reference)
    content: bytes = shapely.to_wkb(shape, byte_order=1)
    return header + content


def _quoted(name: str) -> str:
    doubled = name.replace('"', '""')
    return f'"{doubled}"'
