"""Text that every format can carry."""

from __future__ import annotations

import re

_NOT_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


def clean(text: str) -> str:
    """The text with characters that neither XML nor UTF-8 can carry replaced by U+FFFD."""
    return _NOT_XML.sub("\ufffd", text)
