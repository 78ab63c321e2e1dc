"""The `flexmap` command.

Exit codes: 0 done; 1 an error inside FlexMap; 2 an input, the configuration or the store is at fault;
3 the gate holds the release for a person; 4 the gate rejects it; 5 some maps of a fleet failed; 130 interrupted.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from cyclopts import App
from rich.console import Console

from flexmap_tasks.errors import FlexMapError
from flexmap_tasks.store.store import Store
from flows import cli_fleet, commands
from flows.editor import command as edit_command
from flows.store_commands import STORE, Grid, Releases, Set, StoreUrl, add_store_commands
from flows.world_commands import add_world_commands

app = App(name="flexmap", help=__doc__, version="0.1.0")
cli_fleet.add_to(app)
add_world_commands(app)


@app.command
def run(
    config: Path, *, set_: Set = (), grid: Grid = (), table: Path | None = None, best_by: str | None = None,
    store: StoreUrl = STORE, releases: Releases = None, prefect: bool = True,
) -> None:  # fmt: skip
    """Make a release: compute what changed, reuse everything else.

    Parameters
    ----------
    config
        YAML file of one map; see configs/defaults.yaml.
    set_
        Settings to override, as key.path=value; paths relative to the working directory.
    grid
        Settings to try, as key.path=value,value,...: one release per combination, none published, and a table.
    table
        File for that table: .md, .parquet or .csv; trials.md and trials.parquet beside the releases when empty.
    best_by
        Figure of quality.json that says which combination is best.
    store
        Folder of the artifact store, or s3://bucket/prefix.
    releases
        Folder of the releases; <store>/releases, or artifacts/releases when the store is no folder.
    prefect
        Run as a Prefect flow; with --no-prefect in this process, without server and dashboard.
    """
    if grid:
        opened = Store.open(store, releases)
        commands.run_grid(config, set_, grid, opened, table, best_by, through_prefect=prefect)
    else:
        commands.run(config, set_, store, releases, through_prefect=prefect)


@app.command
def plan(config: Path, *, set_: Set = (), store: StoreUrl = STORE) -> None:
    """Say what a run would do and why: cached, run, or depends on what comes before.

    Parameters
    ----------
    config
        YAML file of one map.
    set_
        Settings to override, as key.path=value.
    store
        Folder of the artifact store.
    """
    commands.plan(config, set_, store)


@app.command(name="show-config")
def show_config(config: Path, *, set_: Set = ()) -> None:
    """Print the whole configuration, defaults included, as YAML.

    Parameters
    ----------
    config
        YAML file of one map.
    set_
        Settings to override, as key.path=value.
    """
    commands.show_config(config, set_)


@app.command
def defaults() -> None:
    """Print every setting with its default and meaning, as YAML (this is configs/defaults.yaml)."""
    commands.defaults()


@app.command
def demo(*, store: StoreUrl = STORE, prefect: bool = True) -> None:
    """Simulate a small town and make its map: the main job from a recording to a finished release.

    Parameters
    ----------
    store
        Folder of the artifact store; the town's files go to <store>/demo.
    prefect
        Run as a Prefect flow.
    """
    commands.demo(store, through_prefect=prefect)


add_store_commands(app)
edit_command.add_to(app)


def main() -> None:
    """Entry point: every error a user can cause is one line on stderr."""
    errors = Console(stderr=True, soft_wrap=True, highlight=False)
    try:
        app()
    except FlexMapError as error:
        errors.print(f"flexmap: {error}", markup=False, style="red")
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        errors.print("flexmap: interrupted; what was finished is kept", markup=False)
        sys.exit(130)
    except Exception as error:
        if os.environ.get("FLEXMAP_DEBUG"):
            raise
        errors.print(
            f"flexmap: internal error, {type(error).__name__}: {error} (FLEXMAP_DEBUG=1 shows where)",
            markup=False,
        )
        sys.exit(1)


if __name__ == "__main__":
    main()
