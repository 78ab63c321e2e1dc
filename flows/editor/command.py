"""`flexmap edit`."""

from __future__ import annotations

import webbrowser
from pathlib import Path

from cyclopts import App

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.errors import ConfigError
from flexmap_tasks.formats.config_file import load_config
from flexmap_tasks.store.store import Store
from flows import console
from flows.store_commands import STORE, Set, StoreUrl


def add_to(app: App) -> None:
    """The command on the application."""
    app.command(edit)


def edit(
    config: Path, *, set_: Set = (), store: StoreUrl = STORE, port: int = 0, browser: bool = True
) -> None:
    """Pick control points in the browser; saves them to the file the configuration names. Ctrl+C ends it.

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
    from flows.editor.server import EditServer  # noqa: PLC0415 - loads the stages
    from flows.editor.session import EditSession  # noqa: PLC0415 - the same

    session = EditSession(load_config(FlexMapConfig, config, set_), Store.open(store))
    try:
        server = EditServer(session, port)
    except (OSError, OverflowError) as error:
        raise ConfigError("--port", f"cannot listen on port {port} ({error}); leave it out") from error
    with server:
        console.say(f"editing; open {server.address} (Ctrl+C ends it)")
        if browser:
            webbrowser.open(server.address)
        server.serve_forever()
