"""Write layers of GeoJSON features as a GeoPackage (OGC 12-128r18, version 1.3), a file of SQLite."""

from __future__ import annotations

import json
import math
import sqlite3
import struct
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from auv_mcm.shell.whole_files import write_file
from sim_replay.qgis import contact_style

_APPLICATION_ID: Final = 0x47504B47  # "GPKG", by the standard
_VERSION: Final = 10300  # 1.3.0, by the standard
_WGS84: Final = 4326  # EPSG code
_HEADER: Final = struct.Struct("<2sBBi")  # magic, version, flags, reference system
_LITTLE_ENDIAN, _WITH_BOX, _IS_EMPTY = 0x01, 0x02, 0x10  # flags of a geometry's header
_WKB: Final = {"Point": 1, "LineString": 2, "Polygon": 3, "MultiPoint": 4, "MultiLineString": 5, "MultiPolygon": 6}
"""Codes of ISO well-known binary."""
_PARTS: Final = {"MultiPoint": "Point", "MultiLineString": "LineString", "MultiPolygon": "Polygon"}
_WGS84_WKT: Final = (
    'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],'
    'AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4326"]]'
)
_TABLES: Final = """
CREATE TABLE gpkg_spatial_ref_sys (srs_name TEXT NOT NULL, srs_id INTEGER NOT NULL PRIMARY KEY,
  organization TEXT NOT NULL, organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL, description TEXT);
CREATE TABLE gpkg_contents (table_name TEXT NOT NULL PRIMARY KEY, data_type TEXT NOT NULL, identifier TEXT UNIQUE,
  description TEXT DEFAULT '', last_change DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')),
  min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE, srs_id INTEGER REFERENCES gpkg_spatial_ref_sys(srs_id));
CREATE TABLE gpkg_geometry_columns (table_name TEXT NOT NULL UNIQUE REFERENCES gpkg_contents(table_name),
  column_name TEXT NOT NULL, geometry_type_name TEXT NOT NULL,
  srs_id INTEGER NOT NULL REFERENCES gpkg_spatial_ref_sys(srs_id), z TINYINT NOT NULL, m TINYINT NOT NULL,
  PRIMARY KEY (table_name, column_name));
"""
_STYLES: Final = """
CREATE TABLE layer_styles (id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, f_table_catalog TEXT(256),
  f_table_schema TEXT(256), f_table_name TEXT(256), f_geometry_column TEXT(256), styleName TEXT(30), styleQML TEXT,
  styleSLD TEXT, useAsDefault BOOLEAN, description TEXT, owner TEXT(30), ui TEXT(30), update_time DATETIME)
"""
_TIMES: Final = frozenset({"time", "judged_time", "start", "stop", "view_time"})
_CHANGED: Final = "1970-01-01T00:00:00.000Z"  # equal layers give equal files

Feature = Mapping[str, Any]


def write_geopackage(path: Path, layers: Mapping[str, Sequence[Feature]]) -> None:
    """Write each layer as a table of its name, in the order given; empty layers are left out.

    Properties become columns, times of type DATETIME; lists and objects are written as JSON. Features without a
    geometry are kept. `layer_styles` holds the style that QGIS shows contacts in, by how likely a mine they are.

    Raises OSError.
    """
    with closing(sqlite3.connect(":memory:")) as base:  # of a full disk SQLite names neither file nor reason
        with base:
            base.execute(f"PRAGMA application_id = {_APPLICATION_ID}")
            base.execute(f"PRAGMA user_version = {_VERSION}")
            base.executescript(_TABLES)
            base.executemany(
                "INSERT INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?, ?)",
                [
                    ("Undefined Cartesian", -1, "NONE", -1, "undefined", None),
                    ("Undefined geographic", 0, "NONE", 0, "undefined", None),
                    ("WGS 84", _WGS84, "EPSG", _WGS84, _WGS84_WKT, "longitude, latitude in degrees"),
                ],
            )
            for name, features in layers.items():
                if features:
                    _write_layer(base, name, features)
            if layers.get("contacts"):
                _write_style(base)
        write_file(path, base.serialize())


def _write_layer(base: sqlite3.Connection, name: str, features: Sequence[Feature]) -> None:
    columns = _columns(features)
    kinds = {feature["geometry"]["type"] for feature in features if feature["geometry"]}
    kind = kinds.pop().upper() if len(kinds) == 1 else "GEOMETRY"
    boxes = [_box(feature["geometry"]) for feature in features if feature["geometry"]]
    around = [bound(box[i] for box in boxes) if boxes else None for i, bound in enumerate((min, min, max, max))]
    base.execute(
        "INSERT INTO gpkg_contents VALUES (?, 'features', ?, '', ?, ?, ?, ?, ?, ?)",
        (name, name, _CHANGED, *around, _WGS84),
    )
    base.execute("INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', ?, ?, 0, 0)", (name, kind, _WGS84))
    defined = "".join(f", {_quoted(column)} {of_type}" for column, of_type in columns.items())
    base.execute(f"CREATE TABLE {_quoted(name)} (fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, geom {kind}{defined})")
    marks = ", ".join("?" * (len(columns) + 1))
    names = ", ".join(["geom", *map(_quoted, columns)])
    base.executemany(
        f"INSERT INTO {_quoted(name)} ({names}) VALUES ({marks})",
        (
            (
                _geometry(feature["geometry"]),
                *(_cell(feature["properties"].get(column), of_type) for column, of_type in columns.items()),
            )
            for feature in features
        ),
    )


def _columns(features: Iterable[Feature]) -> dict[str, str]:
    """Choose the type of each property; `fid` and `geom` are names of the table's own."""
    types: dict[str, str] = {}
    for feature in features:
        for name, value in feature["properties"].items():
            if name.lower() in ("fid", "geom"):
                continue
            found = {bool: "BOOLEAN", int: "INTEGER", float: "DOUBLE"}.get(type(value), "TEXT")
            found = "DATETIME" if name in _TIMES and found == "TEXT" and _time(value) else found
            if value is None or types.get(name) == found:
                types.setdefault(name, "")
            elif {types.get(name) or found, found} == {"INTEGER", "DOUBLE"}:
                types[name] = "DOUBLE"
            else:
                types[name] = "TEXT" if types.get(name) else found
    return {name: of_type or ("DATETIME" if name in _TIMES else "TEXT") for name, of_type in types.items()}


def _write_style(base: sqlite3.Connection) -> None:
    """Add the table of styles as QGIS keeps it, with the one of contacts."""
    base.execute(_STYLES)
    empty = "NULL, NULL, NULL, NULL, 0"
    base.execute(
        f"INSERT INTO gpkg_contents VALUES ('layer_styles', 'attributes', 'layer_styles', '', ?, {empty})", (_CHANGED,)
    )
    base.execute(
        "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name, f_geometry_column, styleName, "
        "styleQML, styleSLD, useAsDefault, description, owner, ui, update_time) "
        "VALUES ('', '', 'contacts', 'geom', 'chance of a mine', ?, '', 1, '', '', NULL, ?)",
        (contact_style(), _CHANGED),
    )


def _time(value: Any) -> str:
    """Write a time as the standard wants it, UTC with milliseconds; "" for what is none."""
    try:
        moment = datetime.fromisoformat(str(value))
        if moment.tzinfo is None:
            return ""
        return moment.astimezone(UTC).replace(tzinfo=None).isoformat(timespec="milliseconds") + "Z"
    except (ValueError, OverflowError):  # the latter of a time before the year 1 or after 9999 in UTC
        return ""


def _cell(value: Any, of_type: str) -> Any:
    if of_type == "DATETIME" and value is not None:
        return _time(value)
    return json.dumps(value, ensure_ascii=False) if isinstance(value, list | dict) else value


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


def _geometry(geometry: Mapping[str, Any] | None) -> bytes | None:
    """Encode a geometry as GeoPackage binary: a header with its outline, then well-known binary."""
    if geometry is None:
        return None
    west, south, east, north = _box(geometry)
    flags = _LITTLE_ENDIAN | (_WITH_BOX if math.isfinite(west) else _IS_EMPTY)
    box = struct.pack("<4d", west, east, south, north) if math.isfinite(west) else b""
    return _HEADER.pack(b"GP", 0, flags, _WGS84) + box + _wkb(geometry["type"], geometry["coordinates"])


def _wkb(kind: str, coordinates: Any) -> bytes:
    head = struct.pack("<BI", 1, _WKB[kind])
    if kind == "Point":
        return head + struct.pack("<2d", *coordinates[:2])
    if kind == "LineString":
        return head + _points(coordinates)
    if kind == "Polygon":
        return head + struct.pack("<I", len(coordinates)) + b"".join(map(_points, coordinates))
    parts = [_wkb(_PARTS[kind], part) for part in coordinates]
    return head + struct.pack("<I", len(parts)) + b"".join(parts)


def _points(coordinates: Sequence[Sequence[float]]) -> bytes:
    flat = [value for point in coordinates for value in point[:2]]
    return struct.pack(f"<I{len(flat)}d", len(coordinates), *flat)


def _box(geometry: Mapping[str, Any]) -> tuple[float, float, float, float]:
    points = list(_flat(geometry["coordinates"]))
    if not points:
        return (math.nan,) * 4
    longitudes, latitudes = zip(*points, strict=True)
    return min(longitudes), min(latitudes), max(longitudes), max(latitudes)


def _flat(coordinates: Any) -> Iterable[tuple[float, float]]:
    if coordinates and isinstance(coordinates[0], int | float):
        yield float(coordinates[0]), float(coordinates[1])
    else:
        for part in coordinates:
            yield from _flat(part)
