"""An artifact: a set of files, each named by what it contains."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


def canonical_json(value: Any) -> bytes:
    """One spelling per value: sorted keys, no spaces, finite numbers only."""
    text = json.dumps(value, ensure_ascii=False, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return text.encode()


def digest_of(content: bytes) -> str:
    """Sha-256 in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def seal(body: dict[str, Any]) -> bytes:
    """A small document with a checksum of its own."""
    return canonical_json({**body, "checksum": digest_of(canonical_json(body))})


def unseal(content: bytes | None) -> dict[str, Any] | None:
    """The document, or None when it is absent, damaged or cut short."""
    try:
        body: dict[str, Any] = json.loads(content or b"{}")
        return body if body.pop("checksum") == digest_of(canonical_json(body)) else None
    except (ValueError, KeyError, TypeError, AttributeError):
        return None


@dataclass(frozen=True, slots=True)
class Blob:
    """Content by digest: `sha256` in hexadecimal, `size` in bytes."""

    sha256: str
    size: int


@dataclass(frozen=True, slots=True)
class Artifact:
    """Files by path; two artifacts with the same files are the same."""

    files: tuple[tuple[str, Blob], ...]

    @classmethod
    def of(cls, files: Mapping[str, Blob]) -> Artifact:
        """An artifact from its files in any order."""
        return cls(tuple(sorted(files.items())))

    @property
    def digest(self) -> str:
        """Digest over names and contents."""
        return digest_of(canonical_json(self.to_json()))

    def to_json(self) -> dict[str, list[Any]]:
        """Path to [sha256, size]."""
        return {path: [blob.sha256, blob.size] for path, blob in self.files}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Artifact:
        """The inverse of `to_json`; raises on anything else."""
        return cls.of({str(path): Blob(_sha256(pair[0]), int(pair[1])) for path, pair in data.items()})

    def names(self) -> list[str]:
        """All paths, sorted."""
        return [path for path, _ in self.files]

    def sub(self, prefix: str) -> Artifact:
        """The files below a prefix, by the rest of their path."""
        return Artifact(tuple((p[len(prefix) :], b) for p, b in self.files if p.startswith(prefix)))

    def field(self, base: str, field: str) -> Artifact:
        """One field of the composite that was stored under `base`."""
        inner = self.sub(f"{base}/")
        kept = tuple((p, b) for p, b in inner.files if p.split("/")[0].split(".")[0] == field)
        return Artifact(kept)

    def items(self) -> dict[str, Artifact]:
        """A collection's items by key: the first part of the path (or the file's stem)."""
        found: dict[str, list[tuple[str, Blob]]] = {}
        for path, blob in self.files:
            found.setdefault(path.split("/")[0].split(".")[0], []).append((path, blob))
        return {key: Artifact(tuple(found[key])) for key in sorted(found)}


def _sha256(text: Any) -> str:
    if not (isinstance(text, str) and len(text) == 64 and set(text) <= set("0123456789abcdef")):
        raise ValueError("not a sha-256")
    return text
