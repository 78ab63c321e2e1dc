"""GeoPackage 1.3 (OGC 12-128r17): layers in one SQLite file, by SQLite itself; same layers, same bytes."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from flexmap_tasks.formats.clean_text import clean
from flexmap_tasks.model.layers import VectorLayer

APPLICATION_ID = 0x47504B47
"""The letters GPKG, which tell a GeoPackage from other SQLite files."""
USER_VERSION = 10300
WGS84 = 4326
WGS84_WKT = (
    'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],'
    'AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],'
    'UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],AXIS["Latitude",NORTH],AXIS["Longitude",EAST],'
    'AUTHORITY["EPSG","4326"]]'
)
NO_TIME = "1970-01-01T00:00:00.000Z"
"""`last_change` of every table: the file says nothing about when it was made."""

_HEADER_NO_BOX, _HEADER_BOX = 0b0000_0001, 0b0000_0011
_TABLES = """
CREATE TABLE gpkg_spatial_ref_sys (srs_name TEXT NOT NULL, srs_id INTEGER NOT NULL PRIMARY KEY,
    organization TEXT NOT NULL, organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL,
    description TEXT);
CREATE TABLE gpkg_contents (table_name TEXT NOT NULL PRIMARY KEY, data_type TEXT NOT NULL,
    identifier TEXT UNIQUE, description TEXT DEFAULT '', last_change DATETIME NOT NULL,
    min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE, srs_id INTEGER,
    CONSTRAINT fk_gc_r_srs_id FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys(srs_id));
CREATE TABLE gpkg_geometry_columns (table_name TEXT NOT NULL, column_name TEXT NOT NULL,
    geometry_type_name TEXT NOT NULL, srs_id INTEGER NOT NULL, z TINYINT NOT NULL, m TINYINT NOT NULL,
    CONSTRAINT pk_geom_cols PRIMARY KEY (table_name, column_name),
    CONSTRAINT uk_gc_table_name UNIQUE (table_name),
    CONSTRAINT fk_gc_tn FOREIGN KEY (table_name) REFERENCES gpkg_contents(table_name),
    CONSTRAINT fk_gc_srs FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys (srs_id));
"""


def geopackage(layers: Sequence[VectorLayer]) -> bytes:
    """The file. It depends on nothing but the layers and the version of SQLite."""
    with sqlite3.connect(":memory:") as db:
        db.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        db.execute(f"PRAGMA user_version = {USER_VERSION}")
        db.executescript(_TABLES)
        db.executemany("INSERT INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?, ?)", _systems())
        for layer in layers:
            _write(db, layer)
        db.commit()
        db.execute("VACUUM")
        content = db.serialize()
    db.close()
    return content


def _systems() -> list[tuple[str, int, str, int, str, str]]:
    return [
        ("Undefined Cartesian SRS", -1, "NONE", -1, "undefined", "undefined Cartesian coordinates"),
        ("Undefined geographic SRS", 0, "NONE", 0, "undefined", "undefined geographic coordinates"),
        ("WGS 84 geodetic", WGS84, "EPSG", WGS84, WGS84_WKT, "longitude and latitude in degrees"),
    ]


def _write(db: sqlite3.Connection, layer: VectorLayer) -> None:
    kinds = {name: _kind(column) for name, column in layer.columns.items()}
    columns = "".join(f', "{name}" {kind}' for name, kind in kinds.items())
    db.execute(
        f'CREATE TABLE "{layer.name}" (fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, '
        f"geom {layer.kind.upper()}{columns})"
    )
    box = shapely.total_bounds(layer.geometry).tolist() if len(layer) else [None] * 4
    db.execute(
        "INSERT INTO gpkg_contents VALUES (?, 'features', ?, '', ?, ?, ?, ?, ?, ?)",
        (layer.name, layer.name, NO_TIME, *box, WGS84),
    )
    db.execute(
        "INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', ?, ?, 0, 0)",
        (layer.name, layer.kind.upper(), WGS84),
    )
    slots = ", ".join("?" * (len(kinds) + 1))
    names = "".join(f', "{name}"' for name in kinds)
    values = (_values(column) for column in layer.columns.values())
    rows = zip(_blobs(layer), *values, strict=True)
    db.executemany(f'INSERT INTO "{layer.name}" (geom{names}) VALUES ({slots})', rows)  # noqa: S608 - our own names


def _blobs(layer: VectorLayer) -> list[bytes]:
    """The header of the standard, then WKB; points go without a box of their own."""
    point = layer.kind == "Point"
    head = b"GP\x00" + bytes([_HEADER_NO_BOX if point else _HEADER_BOX]) + struct.pack("<i", WGS84)
    wkbs = shapely.to_wkb(layer.geometry, byte_order=1, output_dimension=2).tolist()
    if point:
        return [head + wkb for wkb in wkbs]
    boxes = shapely.bounds(layer.geometry)[:, [0, 2, 1, 3]].astype("<f8")
    return [head + box.tobytes() + wkb for box, wkb in zip(boxes, wkbs, strict=True)]


def _kind(column: NDArray[Any]) -> str:
    return {"f": "DOUBLE", "i": "INTEGER", "b": "BOOLEAN"}.get(column.dtype.kind, "TEXT")


def _values(column: NDArray[Any]) -> list[Any]:
    if column.dtype.kind == "O":
        return [None if v is None else clean(v) for v in column.tolist()]
    values: list[Any] = (column if column.dtype.kind == "f" else column.astype(np.int64)).tolist()
    if column.dtype.kind == "f":
        for i in np.flatnonzero(np.isnan(column)).tolist():
            values[i] = None
    return values
