"""The page as it is written: markup, style and scripts, without data."""

from __future__ import annotations

from importlib.resources import files

from flexmap_tasks.report import vendor

SCRIPTS = (
    "data.js",
    "words.js",
    "canvas.js",
    "background.js",
    "layers.js",
    "layers_map.js",
    "inspect.js",
    "tables.js",
    "charts.js",
    "decide.js",
    "selection.js",
    "controls.js",
    "main.js",
)
"""In the order in which they stand in the page; they share one scope."""


EDITOR_SCRIPTS = (
    "data.js",
    "words.js",
    "canvas.js",
    "background.js",
    "layers.js",
    "layers_map.js",
    "editor.js",
    "editor_main.js",
)


def text(name: str) -> str:
    """One file of the page."""
    return files(__name__).joinpath(name).read_text(encoding="utf-8")


def vendored(name: str) -> str:
    """One file of a library."""
    return files(vendor).joinpath(name).read_text(encoding="utf-8")
