"""PCD files of every encoding, written as plainly as can be; the counterpart of the reader in tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from flexmap_tasks.model.source import Source


def lzf(data: bytes) -> bytes:
    """LZF with literals, near and far repeats of any length."""
    out, literal, seen, i = bytearray(), bytearray(), {}, 0

    def flush() -> None:
        while literal:
            part = literal[:32]
            out.append(len(part) - 1)
            out.extend(part)
            del literal[:32]

    while i < len(data):
        j = seen.get(data[i : i + 3], -1)
        seen[data[i : i + 3]] = i
        if j < 0 or i - j > 8192 or len(data) - i < 3:
            literal.append(data[i])
            i += 1
            continue
        flush()
        size = 3
        while i + size < len(data) and size < 264 and data[j + size] == data[i + size]:
            size += 1
        distance = i - j - 1
        out.append((min(size - 2, 7) << 5) | (distance >> 8))
        if size - 2 >= 7:
            out.append(size - 9)
        out.append(distance & 255)
        i += size
    flush()
    return bytes(out)


def header(records: np.ndarray, encoding: str, *, padding: int = 0, **changes: str) -> bytes:
    """Header lines for the records; `padding` bytes of "_" behind x; `changes` replace whole lines by keyword."""
    columns = []
    for name in records.dtype.names:
        kind = records.dtype[name]
        count = int(np.prod(kind.shape, dtype=int))
        columns.append((name, kind.base.itemsize, kind.base.kind.upper(), count))
        if name == "x" and padding:
            columns.append(("_", 1, "U", padding))
    lines = {
        "VERSION": "0.7",
        "FIELDS": " ".join(c[0] for c in columns),
        "SIZE": " ".join(str(c[1]) for c in columns),
        "TYPE": " ".join(c[2] for c in columns),
        "COUNT": " ".join(str(c[3]) for c in columns),
        "WIDTH": str(len(records)),
        "HEIGHT": "1",
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": str(len(records)),
        "DATA": encoding,
    } | changes
    return ("# .PCD v0.7\n" + "".join(f"{k} {v}\n" for k, v in lines.items() if v)).encode()


def body(records: np.ndarray, encoding: str, padding: int = 0) -> bytes:
    columns = [np.ascontiguousarray(records[n]) for n in records.dtype.names]
    gap = np.full((len(records), padding), 65, np.uint8)
    at = list(records.dtype.names).index("x") + 1
    if encoding == "ascii":
        wide = [c if c.ndim > 1 else c[:, None] for c in columns]
        wide.insert(at, gap)
        rows = zip(*[w.tolist() for w in wide], strict=True)
        return "".join(" ".join(str(v) for cell in row for v in cell) + "\n" for row in rows).encode()
    raw = [np.frombuffer(c.tobytes(), np.uint8).reshape(len(c), c[:1].nbytes or c.itemsize) for c in columns]
    raw.insert(at, gap)
    if encoding == "binary":
        return np.hstack(raw).tobytes()
    data = b"".join(r.tobytes() for r in raw)
    packed = lzf(data)
    return np.array([len(packed), len(data)], "<u4").tobytes() + packed


def pcd(records: np.ndarray, encoding: str, *, padding: int = 0, **changes: str) -> bytes:
    """A whole file."""
    return header(records, encoding, padding=padding, **changes) + body(records, encoding, padding)


def source(folder: Path, content: bytes) -> Source:
    path = folder / "cloud.pcd"
    path.write_bytes(content)
    return Source("cloud.pcd", path)
