"""`flexmap fleet`, `flexmap release` and `flexmap up`."""

from __future__ import annotations

from pathlib import Path

from cyclopts import App

from flexmap_tasks.store.store import Store
from flows.store_commands import STORE, Releases, StoreUrl

fleet_app = App(name="fleet", help="Keep many maps up to date.")
release_app = App(
    name="release", help="Decide what is published: exit code 3 of a run means held, 4 rejected."
)

# What loads Prefect or the stages is imported where it is needed.


@fleet_app.command
def update(fleet: Path, *, prefect: bool = True) -> None:
    """Find new recordings, plan every map, run those that have something to do.

    Parameters
    ----------
    fleet
        YAML file of the fleet.
    prefect
        Run as a Prefect flow, on the fleet's work pool if it has one; with --no-prefect as processes of this machine.
    """
    from flows import fleet_commands  # noqa: PLC0415

    fleet_commands.update(fleet, through_prefect=prefect)


@fleet_app.command
def status(fleet: Path, *, json: bool = False) -> None:
    """Say for every map what is published, how old and how good it is, and what waits.

    Parameters
    ----------
    fleet
        YAML file of the fleet.
    json
        For other programs.
    """
    from flows import fleet_commands  # noqa: PLC0415

    fleet_commands.status(fleet, as_json=json)


@fleet_app.command
def recordings(fleet: Path, *maps: str) -> None:
    """Say for every recording that arrived whether it is used, and why.

    Parameters
    ----------
    fleet
        YAML file of the fleet.
    maps
        Only these maps.
    """
    from flows import fleet_commands  # noqa: PLC0415

    fleet_commands.recordings(fleet, maps)


@fleet_app.command
def deploy(fleet: Path) -> None:
    """Register work pool, deployments, schedules and automations on the Prefect server of PREFECT_API_URL.

    Parameters
    ----------
    fleet
        YAML file of the fleet; deploy again when it changes.
    """
    from flows import fleet_commands  # noqa: PLC0415

    fleet_commands.deploy(fleet)


@fleet_app.command
def notify(fleet: Path, *maps: str) -> None:
    """Tell the Prefect server that recordings arrived, which starts an update.

    Parameters
    ----------
    fleet
        YAML file of the fleet.
    maps
        Names of the maps, for the record.
    """
    from flows import fleet_commands  # noqa: PLC0415

    fleet_commands.notify(fleet, maps)


@fleet_app.command
def watch(fleet: Path, *, every_s: float = 10.0) -> None:
    """Look for recordings until interrupted, and tell the Prefect server when some arrived.

    Parameters
    ----------
    fleet
        YAML file of the fleet.
    every_s
        Seconds between two looks.
    """
    from flows import fleet_commands  # noqa: PLC0415

    fleet_commands.watch(fleet, every_s)


@release_app.command(name="list")
def list_(map_: str, *, store: StoreUrl = STORE, releases: Releases = None) -> None:
    """List the releases of a map and what was decided about them.

    Parameters
    ----------
    map_
        Name of the map.
    store
        Folder of the artifact store, or s3://bucket/prefix.
    releases
        Folder of the releases.
    """
    from flows import release_commands  # noqa: PLC0415

    release_commands.list_releases(Store.open(store, releases), map_)


@release_app.command
def show(
    map_: str, release: str | None = None, *, store: StoreUrl = STORE, releases: Releases = None
) -> None:
    """Show a release beside what is published.

    Parameters
    ----------
    map_
        Name of the map.
    release
        Its id or the beginning of it; what is published when empty.
    store
        Folder of the artifact store, or s3://bucket/prefix.
    releases
        Folder of the releases.
    """
    from flows import release_commands  # noqa: PLC0415

    release_commands.show(Store.open(store, releases), map_, release)


@release_app.command
def compare(
    map_: str, *release: str, table: Path | None = None, best_by: str | None = None, store: StoreUrl = STORE,
    releases: Releases = None,
) -> None:  # fmt: skip
    """Compare releases of a map: settings that differ, figures, and which is best.

    Parameters
    ----------
    map_
        Name of the map.
    release
        Their ids or the beginnings of them; all releases of the map when empty.
    table
        File for the table with every figure: .md, .parquet or .csv.
    best_by
        Figure of quality.json that says which is best.
    store
        Folder of the artifact store, or s3://bucket/prefix.
    releases
        Folder of the releases.
    """
    from flows import release_commands  # noqa: PLC0415

    release_commands.compare(Store.open(store, releases), map_, release, table, best_by)


@release_app.command
def publish(map_: str, release: str, *, store: StoreUrl = STORE, releases: Releases = None) -> None:
    """Publish a release, whatever the gate said.

    Parameters
    ----------
    map_
        Name of the map.
    release
        Its id or the beginning of it.
    store
        Folder of the artifact store, or s3://bucket/prefix.
    releases
        Folder of the releases.
    """
    from flows import release_commands  # noqa: PLC0415

    release_commands.publish(Store.open(store, releases), map_, release)


@release_app.command
def rollback(
    map_: str, release: str | None = None, *, store: StoreUrl = STORE, releases: Releases = None
) -> None:
    """Withdraw what is published and go back to the release before, or to a given one.

    Parameters
    ----------
    map_
        Name of the map.
    release
        Its id or the beginning of it; the one published before when empty.
    store
        Folder of the artifact store, or s3://bucket/prefix.
    releases
        Folder of the releases.
    """
    from flows import release_commands  # noqa: PLC0415

    release_commands.rollback(Store.open(store, releases), map_, release)


def up(fleet: Path, *, port: int = 4200, workers: int = 1, watch_recordings: bool = True) -> None:
    """Start a Prefect server, workers and the schedules of a fleet on this machine; ends with Ctrl-C.

    Parameters
    ----------
    fleet
        YAML file of the fleet.
    port
        Of the server, on the loopback interface.
    workers
        How many worker processes.
    watch_recordings
        Also look for recordings and start an update when some arrived.
    """
    from flows import fleet_up  # noqa: PLC0415

    fleet_up.up(fleet, port, workers, watch_recordings=watch_recordings)


def add_to(app: App) -> None:
    """Give the command its sub-commands."""
    app.command(fleet_app)
    app.command(release_app)
    app.command(up)
