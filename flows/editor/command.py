"""`flexmap edit`."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

from cyclopts import App

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.formats.config_file import load_config
from flexmap_tasks.store.store import Store
from flows import console
from flows.store_commands import STORE, Set, StoreUrl

if TYPE_CHECKING:  # `flexmap run` that has nothing to do must not load the stages
    from flexmap_tasks.engine.execute import Outcome


def add_to(app: App) -> None:
    """The command on the application."""
    app.command(edit)


def edit(
    config: Path, *, set_: Set = (), store: StoreUrl = STORE, port: int = 0, browser: bool = True
) -> None:
    """Pick control points and decide on what is up for review, in the browser. Ctrl+C ends it.

    Saves to the files the configuration names: alignment.control_points_file and conflation.review_file.

    Parameters
    ----------
    config
        YAML file of one map.
    set_
        Settings to override, as key.path=value.
    store
        Folder of the artifact store.
    port
        On the loopback; 0 takes one that is free.
    browser
        Open the page at once.
    """
    from flows.editor.editors import edit_server  # noqa: PLC0415 - loads the stages

    settings = load_config(FlexMapConfig, config, set_)
    with edit_server(settings, Store.open(store), port, _told) as server:
        console.say(f"editing; open {server.address} (Ctrl+C ends it)")
        if browser:
            webbrowser.open(server.address)
        server.serve_forever()


def _told(outcome: Outcome) -> None:
    """A word on every stage that had to be computed: the first time takes as long as a run."""
    if not outcome.cached:
        console.say(f"computed {outcome.name}, {outcome.seconds:.1f} s")
