"""Roads from any OpenStreetMap file: the content decides whether it is XML, gzip of it, or PBF."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from typing import BinaryIO

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.osm_roads_elements import RoadElements
from flexmap_tasks.formats.osm_roads_pbf import read_pbf_roads
from flexmap_tasks.formats.osm_roads_xml import read_xml_roads
from flexmap_tasks.model.source import Source

PIECE = 1 << 20
INFLATED_PER_BYTE = 50
"""OpenStreetMap XML shrinks to a twelfth under gzip, the dullest to a thirtieth; beyond this it is a bomb."""
FREE_BYTES = 64 << 20
"""Up to this size it may inflate at any ratio."""
PBF_HEADER = b"\n\tOSMHeader"


def read_road_elements(source: Source, highways: frozenset[str]) -> RoadElements:
    """Ways whose `highway` is one of the given values, newest state of each, and their nodes.

    Raises InputError when the file is absent, empty, cut off, or no OpenStreetMap data.
    """
    try:
        with source.path.open("rb") as file:
            head = file.read(4 + len(PBF_HEADER))
            file.seek(0)
            if not head:
                raise InputError(source.name, "the file is empty; expected OpenStreetMap data")
            if head[4:] == PBF_HEADER:
                return read_pbf_roads(source, highways)
            pieces = _inflated(source.name, file) if head[:2] == b"\x1f\x8b" else _plain(file)
            return read_xml_roads(source.name, _checked(source.name, pieces), highways)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise InputError(source.name, f"the file cannot be read ({reason})") from None


def _plain(file: BinaryIO) -> Iterator[bytes]:
    while piece := file.read(PIECE):
        yield piece


def _inflated(name: str, file: BinaryIO) -> Iterator[bytes]:
    """Content of all members of a gzip file, in pieces of bounded size."""
    size_in = size_out = 0
    inflate = zlib.decompressobj(wbits=31)
    while data := inflate.unconsumed_tail or inflate.unused_data or file.read(PIECE):
        if inflate.eof:
            data = data.lstrip(b"\0") or file.read(PIECE)
            if not data:
                break
            inflate = zlib.decompressobj(wbits=31)
        try:
            piece = inflate.decompress(data, PIECE)
        except zlib.error as error:
            raise InputError(name, f"the gzip file is damaged ({error}); fetch it again") from None
        size_in, size_out = file.tell(), size_out + len(piece)
        if size_out > max(FREE_BYTES, INFLATED_PER_BYTE * size_in):
            rule = (
                f"the gzip file inflates to over {INFLATED_PER_BYTE} times its size; refused, unpack it first"
            )
            raise InputError(name, rule)
        yield piece
    if not inflate.eof:
        raise InputError(name, "the gzip file is cut off; fetch it again")


def _checked(name: str, pieces: Iterator[bytes]) -> Iterator[bytes]:
    """The same pieces, unless the first byte that is no space shows that this is no XML."""
    head = b""
    for piece in pieces:
        if len(head) < 64:
            head = (head + piece).lstrip(b"\xef\xbb\xbf \t\r\n")[:64]
            if head and not head.startswith((b"<", b"\xff\xfe", b"\xfe\xff")):
                rule = f"expected OpenStreetMap XML, gzip of it, or PBF; it begins with {head[:16]!r}"
                raise InputError(name, rule)
        yield piece
    if not head:
        raise InputError(name, "the file holds nothing; expected OpenStreetMap data")
