"""A scanner for the plain form of OSM XML: one pass over the bytes, everything as numbers.

It knows only what nearly all files are made of, checks it strictly, and gives up at the first byte it is not
sure of; the caller then takes the full XML parser. What it accepts is well-formed XML by construction, and means
the same to the full parser.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flexmap_tasks.formats.osm_xml_kernel import MAX_ATTRIBUTES, scan_document

Ints = NDArray[np.int64]


class Scan(NamedTuple):
    """What stands in a document. Texts are numbers of rows of `text`.

    element : (n, 7) int64 per top-level element: kind, id, where its attributes, tags and items end in the flat
        arrays, and its first byte and the byte after it
    attribute, tag : (m, 2) name and value; item : (i, 3) int64, of `nd` and `member` alike: ref, type, role
    root : (r, 2) attributes of the root element
    text : (x, 3) int64, byte span and hash
    """

    element: Ints
    attribute: NDArray[np.int32]
    tag: NDArray[np.int32]
    item: Ints
    root: NDArray[np.int32]
    text: Ints


def scan(data: NDArray[np.uint8], start: int) -> Scan | None:
    """Scan from the root element at `start` to the end; None where the plain form ends.

    data : (n,) uint8, the file and a final zero byte
    """
    # The smallest element is <a/>, the smallest attribute ' a=""': memory is bounded by the bytes there are.
    elements = min(int(np.count_nonzero(data == ord("<"))), len(data) // 4 + 1)
    attributes = min(int(np.count_nonzero(data == ord("="))), len(data) // 5 + 1)
    table = np.full(1 << max(10, int(3 * attributes).bit_length()), -1, dtype=np.int32)
    out = Scan(
        element=np.empty((elements, 7), dtype=np.int64),
        attribute=np.empty((attributes, 2), dtype=np.int32),
        tag=np.empty((attributes, 2), dtype=np.int32),
        item=np.empty((attributes, 3), dtype=np.int64),
        root=np.empty((MAX_ATTRIBUTES, 2), dtype=np.int32),
        text=np.empty((2 * attributes, 3), dtype=np.int64),
    )
    size = np.zeros(len(out), dtype=np.int64)
    if not scan_document(data, start, out, table, size):
        return None
    element, attribute, tag, item, root, text = size.tolist()
    return Scan(
        out.element[:element],
        out.attribute[:attribute],
        out.tag[:tag],
        out.item[:item],
        out.root[:root],
        out.text[:text],
    )
