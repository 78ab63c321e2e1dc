"""The header of a PCD file: read strictly, so that everything behind it can be trusted."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np

from flexmap_tasks.errors import InputError
from flexmap_tasks.model.source import Source

ENCODINGS = ("ascii", "binary", "binary_compressed")
IDENTITY = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
PADDING = "_"
AXES = ("x", "y", "z")
MAX_HEADER_BYTES = 64 * 1024
MAX_POINT_BYTES = 64 * 1024
_KEYS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
_VERSIONS = {"0.7", ".7", "0.6", ".6", "0.5", ".5"}
_SIZES = {"I": (1, 2, 4, 8), "U": (1, 2, 4, 8), "F": (4, 8)}


@dataclass(frozen=True, slots=True)
class PcdField:
    """One field of a point: its name ("_" is padding), numpy type and number of values."""

    name: str
    dtype: np.dtype[Any]
    count: int

    @property
    def padding(self) -> bool:
        """Bytes between fields that mean nothing."""
        return self.name == PADDING

    @property
    def nbytes(self) -> int:
        """Bytes of the field in one point."""
        return self.dtype.itemsize * self.count

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the field in one point: () or (count,)."""
        return () if self.count == 1 else (self.count,)


@dataclass(frozen=True, slots=True)
class PcdHeader:
    """What the header promises.

    fields : all fields in order, padding included
    points : number of points; viewpoint : x y z qw qx qy qz
    data_start : offset of the first byte behind the header; lines : lines of the header
    """

    fields: tuple[PcdField, ...]
    points: int
    viewpoint: tuple[float, ...]
    encoding: str
    data_start: int
    lines: int

    @property
    def point_bytes(self) -> int:
        """Bytes of one point in the file, padding included."""
        return sum(f.nbytes for f in self.fields)

    def record_type(self) -> np.dtype[Any]:
        """One point as it lies in a binary file; padding is a hole."""
        offsets = np.cumsum([0, *(f.nbytes for f in self.fields)])[:-1]
        real = [(f, int(o)) for f, o in zip(self.fields, offsets, strict=True) if not f.padding]
        return np.dtype(
            {
                "names": [f.name for f, _ in real],
                "formats": [(f.dtype, f.shape) for f, _ in real],
                "offsets": [o for _, o in real],
                "itemsize": self.point_bytes,
            }
        )


def read_header(file: BinaryIO, source: Source) -> PcdHeader:
    """Read up to and with the DATA line; the file then stands at the first byte of data."""
    entries: dict[str, tuple[int, list[str]]] = {}
    lines = 0
    while "DATA" not in entries:
        line = file.readline(MAX_HEADER_BYTES)
        lines += 1
        if not line.endswith(b"\n") or file.tell() > MAX_HEADER_BYTES:
            raise InputError(source.name, _no_header(line, lines), f"line {lines}")
        words = _words(line, source, lines)
        if not words or words[0].startswith("#"):
            continue
        key = "FIELDS" if words[0] == "COLUMNS" else words[0]
        if key not in _KEYS:
            raise InputError(
                source.name, f"expected a PCD header line, got {words[0][:40]!r}", f"line {lines}"
            )
        if key in entries:
            raise InputError(source.name, f"{key} stands twice in the PCD header", f"line {lines}")
        entries[key] = (lines, words[1:])
    return _Entries(source, entries).header(file.tell(), lines)


def _no_header(line: bytes, number: int) -> str:
    if not line and number == 1:
        return "the file is empty; expected a PCD point cloud"
    if not line:
        return "the PCD header ends before its DATA line; the file is cut off"
    return "expected the text lines of a PCD header, got something else; is this a PCD file?"


def _words(line: bytes, source: Source, number: int) -> list[str]:
    try:
        return line.decode("ascii" if not line.startswith(b"#") else "latin-1").split()
    except UnicodeDecodeError:
        raise InputError(source.name, _no_header(line, number), f"line {number}") from None


@dataclass(frozen=True, slots=True)
class _Entries:
    """The lines of a header by their keyword: (line number, words)."""

    source: Source
    entries: dict[str, tuple[int, list[str]]]

    def header(self, data_start: int, lines: int) -> PcdHeader:
        if "VERSION" in self.entries and self._words("VERSION", 1)[0] not in _VERSIONS:
            raise self._error(
                "VERSION", f"expected PCD version 0.7, got {self._words('VERSION', 1)[0][:40]!r}"
            )
        fields = self._fields()
        encoding = self._words("DATA", 1)[0].lower()
        if encoding not in ENCODINGS:
            raise self._error("DATA", f"expected one of {', '.join(ENCODINGS)}, got {encoding[:40]!r}")
        return PcdHeader(fields, self._points(), self._viewpoint(), encoding, data_start, lines)

    def _error(self, key: str, rule: str) -> InputError:
        line = self.entries[key][0] if key in self.entries else None
        return InputError(self.source.name, rule, f"line {line}" if line else "header")

    def _words(self, key: str, count: int | None = None) -> list[str]:
        if key not in self.entries:
            raise self._error(key, f"the PCD header has no {key} line")
        words = self.entries[key][1]
        if count is not None and len(words) != count:
            raise self._error(
                key, f"{key} needs {count} value(s), one per field where there are fields; got {len(words)}"
            )
        return words

    def _ints(self, key: str, count: int) -> list[int]:
        words = self._words(key, count)
        for word in words:
            if not re.fullmatch(r"\d{1,18}", word):
                raise self._error(key, f"{key} expects whole numbers from 0, got {word[:40]!r}")
        return [int(w) for w in words]

    def _fields(self) -> tuple[PcdField, ...]:
        names = self._words("FIELDS")
        if not names:
            raise self._error("FIELDS", "FIELDS names no field")
        sizes, kinds = self._ints("SIZE", len(names)), self._words("TYPE", len(names))
        counts = self._ints("COUNT", len(names)) if "COUNT" in self.entries else [1] * len(names)
        fields = []
        for name, size, kind, count in zip(names, sizes, kinds, counts, strict=True):
            if size not in _SIZES.get(kind, ()):
                raise self._error("TYPE", f"field {name[:40]!r}: no PCD type {kind[:10]} of {size} bytes")
            if count < 1:
                raise self._error("COUNT", f"field {name[:40]!r}: COUNT must be at least 1")
            fields.append(PcdField(name, np.dtype(f"<{kind.lower()}{size}"), count))
        self._check(fields)
        return tuple(fields)

    def _check(self, fields: list[PcdField]) -> None:
        if sum(f.nbytes for f in fields) > MAX_POINT_BYTES:
            raise self._error("COUNT", f"a point is larger than {MAX_POINT_BYTES} bytes")
        names = [f.name for f in fields if not f.padding]
        double = {n for n in names if names.count(n) > 1}
        if double:
            raise self._error("FIELDS", f"field {min(double)[:40]!r} stands twice")
        axes = {f.name: f for f in fields if f.name in AXES}
        missing = [a for a in AXES if a not in axes]
        if missing:
            raise self._error("FIELDS", f"a point needs the fields x, y and z; missing: {', '.join(missing)}")
        bad = [a for a, f in axes.items() if f.dtype.kind != "f" or f.count != 1]
        if bad:
            raise self._error(
                "TYPE", f"x, y and z must be one F of 4 or 8 bytes each; not so: {', '.join(bad)}"
            )

    def _points(self) -> int:
        area = None
        if "WIDTH" in self.entries or "HEIGHT" in self.entries:
            area = self._ints("WIDTH", 1)[0] * self._ints("HEIGHT", 1)[0]
        if "POINTS" not in self.entries and area is not None:
            return area
        points = self._ints("POINTS", 1)[0]
        if area not in (None, points):
            raise self._error("POINTS", f"POINTS says {points}, but WIDTH times HEIGHT is {area}")
        return points

    def _viewpoint(self) -> tuple[float, ...]:
        if "VIEWPOINT" not in self.entries:
            return IDENTITY
        words = self._words("VIEWPOINT", 7)
        try:
            return tuple(float(w) for w in words)
        except ValueError:
            raise self._error("VIEWPOINT", "VIEWPOINT needs seven numbers: x y z qw qx qy qz") from None


def usable_names(names: Sequence[str], taken: Sequence[str] = ()) -> list[str]:
    """Names as a header can hold them: letters, digits and underscores, each once, none of those taken."""
    used, out = {*taken, PADDING}, []
    for given in names:
        name = base = re.sub(r"[^A-Za-z0-9_]", "_", given)[:64] or "field"
        number = 1
        while name in used:
            number += 1
            name = f"{base}_{number}"
        used.add(name)
        out.append(name)
    return out
