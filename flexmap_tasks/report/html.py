"""The page with its data inside, under a policy that lets nothing else run."""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Sequence
from urllib.parse import urlsplit

from flexmap_tasks.report import page as parts
from flexmap_tasks.report.embed import Json, script_json
from flexmap_tasks.store.artifact import digest_of

LICENCES = ("NOTICE", "LICENSE.leaflet", "LICENSE.uplot")
_SLOT = re.compile(r"<!--slot:([a-z]+)-->")
_SOURCE_MAP = re.compile(r"^//# sourceMappingURL=.*$", re.MULTILINE)


NOBODY, ITS_SERVER = "'none'", "'self'"
"""Whom a page may talk to."""
PLACES = (("points", "./", "Control points"), ("review", "review", "Review"))
"""The editor's pages: name, address beside the other, title."""


def page(title: str, data: Json) -> bytes:
    """The whole report, the same for the same data.

    The policy allows exactly the scripts and styles that stand in it, and no connection at all.
    """
    return _filled("report.html", parts.SCRIPTS, title, "report", data, NOBODY)


def review_page(title: str, data: Json, places: Sequence[str]) -> bytes:
    """The report with a server behind it, to which decisions are saved; it may talk to nobody else."""
    nav = _nav("review", places)
    return _filled("report.html", parts.SCRIPTS, title, "review", data, ITS_SERVER, nav)


def editor_page(title: str, data: Json, places: Sequence[str]) -> bytes:
    """The editor of control points; it may talk to the server it came from and to nobody else."""
    nav = _nav("points", places)
    return _filled("editor.html", parts.EDITOR_SCRIPTS, title, "editor", data, ITS_SERVER, nav)


def _nav(here: str, places: Sequence[str]) -> str:
    links = (
        f'<a href="{address}"{" aria-current=page" if name == here else ""}>{text}</a>'
        for name, address, text in PLACES
        if name in places
    )
    return f'<nav class="nav" aria-label="Pages">{"".join(links)}</nav>'


def _filled(
    template: str, names: Sequence[str], title: str, kind: str, data: Json, connect: str, nav: str = ""
) -> bytes:
    scripts = [_library("leaflet.js"), _library("uplot.js"), _own_script(names)]
    styles = [_library("leaflet.css"), _library("uplot.css"), parts.text("report.css")]
    filled = {
        "policy": html.escape(_policy(scripts, styles, connect, _origin(data.get("tiles")))),
        "title": html.escape(title),
        "kind": kind,
        "brand": parts.text("brand.html").rstrip(),
        "nav": nav,
        "styles": "\n".join(f"<style>{style}</style>" for style in styles),
        "data": script_json(data),
        "scripts": "\n".join(f"<script>{script}</script>" for script in scripts),
        "libraries": html.escape("\n".join(map(parts.vendored, LICENCES))),
    }
    filled["head"] = _fill(parts.text("head.html"), filled)
    return _fill(parts.text(template), filled).encode()


def _fill(template: str, filled: Json) -> str:
    """The template with its slots filled; what fills them is not looked at again."""
    return _SLOT.sub(lambda slot: str(filled[slot[1]]), template)


def _own_script(names: Sequence[str]) -> str:
    body = "\n".join(parts.text(name) for name in names)
    return f'(() => {{\n"use strict";\n{body}\n}})();\n'


def _library(name: str) -> str:
    return _SOURCE_MAP.sub("", parts.vendored(name))


def _origin(tiles: Json | None) -> str:
    """Where pictures may come from beside the page itself: the server of the background, if one is configured."""
    if tiles is None:
        return ""
    parts_ = urlsplit(tiles["url"])
    return f" {parts_.scheme}://{parts_.netloc}"


def _policy(scripts: list[str], styles: list[str], connect: str, pictures: str) -> str:
    rules = {
        "default-src": "'none'",
        "script-src": " ".join(map(_hash, scripts)),
        "style-src": " ".join(map(_hash, styles)),
        "img-src": f"data: blob:{pictures}",
        "connect-src": connect,
        "base-uri": "'none'",
        "form-action": "'none'",
    }
    return "; ".join(f"{name} {value}" for name, value in rules.items())


def _hash(text: str) -> str:
    digest = base64.b64encode(bytes.fromhex(digest_of(text.encode())))
    return f"'sha256-{digest.decode()}'"
