"""Commands that ask the store, or look after it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from flexmap_tasks.errors import StoreError
from flexmap_tasks.store.store import Store
from flows import console

StoreUrl = Annotated[str, Parameter(name="--store", env_var="FLEXMAP_STORE")]
Releases = Annotated[Path | None, Parameter(name="--releases", env_var="FLEXMAP_RELEASES")]
Set = Annotated[tuple[str, ...], Parameter(name="--set", consume_multiple=True, negative="")]
Grid = Annotated[tuple[str, ...], Parameter(name="--grid", consume_multiple=True, negative="")]
STORE = "artifacts"

# What a command needs is imported by that command: `flexmap run` must not wait for what others load.

store_app = App(name="store", help="Look into the artifact store.")


def add_store_commands(app: App) -> None:
    """Give the `flexmap` command those of this module."""
    for command in (explain, lineage, diff, verify, gc, push, pull):
        app.command(command)
    app.command(store_app)


def explain(
    release: str, stage: str | None = None, *, store: StoreUrl = STORE, releases: Releases = None
) -> None:
    """Say what a release is made of: stages, actions, settings, inputs, code, when and where.

    Parameters
    ----------
    release
        Folder of a release or a file in it, a map, map/id, or the beginning of an id.
    stage
        Everything about one stage.
    store
        Folder of the artifact store, or s3://bucket/prefix.
    releases
        Folder of the releases.
    """
    from flexmap_tasks.engine.explain import explain as explain_all  # noqa: PLC0415
    from flexmap_tasks.engine.explain import explain_stage  # noqa: PLC0415
    from flexmap_tasks.engine.released import find_release  # noqa: PLC0415
    from flows import store_views  # noqa: PLC0415

    opened = Store.open(store, releases)
    found = find_release(opened, release)
    if stage is None:
        store_views.show_release(found, explain_all(opened, found))
    else:
        store_views.show_stage(explain_stage(opened, found, stage))


def lineage(
    file: str,
    *,
    lanelet: int | None = None,
    key: str | None = None,
    store: StoreUrl = STORE,
    releases: Releases = None,
) -> None:
    """Follow a released file, or a value of its map, back to what it comes from.

    Parameters
    ----------
    file
        A file in the folder of a release.
    lanelet
        Id of a lanelet: where its attributes come from.
    key
        Only this attribute of the lanelet.
    store
        Folder of the artifact store, or s3://bucket/prefix.
    releases
        Folder of the releases.
    """
    from flexmap_tasks.engine import lineage as lines  # noqa: PLC0415
    from flexmap_tasks.engine.released import find_release, released_file  # noqa: PLC0415
    from flows import store_views  # noqa: PLC0415

    opened = Store.open(store, releases)
    release = find_release(opened, file)
    path = released_file(release, file) if Path(file).is_file() else "lanelet2_map.osm"
    origin = lines.file_lineage(opened, release, path)
    if lanelet is None:
        store_views.show_file(release, origin)
    else:
        values = lines.value_lineage(release, lanelet, key)
        store_views.show_values(release, lanelet, values, origin, lines.settings_behind(release))


def diff(old: str, new: str, *, store: StoreUrl = STORE, releases: Releases = None) -> None:
    """Compare two releases: settings, inputs, code, stages, figures, and the map itself.

    Parameters
    ----------
    old
        The earlier release: folder, map/id, or the beginning of an id.
    new
        The later one.
    store
        Folder of the artifact store, or s3://bucket/prefix.
    releases
        Folder of the releases.
    """
    from flexmap_tasks.engine.diff import diff_releases  # noqa: PLC0415
    from flexmap_tasks.engine.released import find_release  # noqa: PLC0415
    from flows import store_views  # noqa: PLC0415

    opened = Store.open(store, releases)
    first, second = find_release(opened, old), find_release(opened, new)
    store_views.show_diff(first, second, diff_releases(opened, first, second))


def verify(*, repair: bool = False, store: StoreUrl = STORE, releases: Releases = None) -> None:
    """Read everything in the store and all releases, and check it.

    Parameters
    ----------
    repair
        Remove what is damaged, so that the next run makes it anew, and restore releases from the store.
    store
        Folder of the artifact store, or s3://bucket/prefix.
    releases
        Folder of the releases.
    """
    from flexmap_tasks.engine.verify import verify as verify_all  # noqa: PLC0415

    checked = verify_all(Store.open(store, releases), repair=repair)
    for damage in checked.damages:
        console.say(f"{'healed ' if damage.healed else 'damaged'}  {damage.where}: {damage.what}")
    console.say(f"{checked.entries} entries, {size(checked.bytes)} read; {len(checked.damages)} damaged")
    left = sum(not damage.healed for damage in checked.damages)
    if left:
        advice = "run the maps again" if repair else "run flexmap verify --repair"
        raise StoreError(f"artifact store {store}: {left} damaged or missing; {advice}")


def gc(
    *,
    keep_runs: int = 3,
    keep_days: float = 30.0,
    grace_hours: float = 24.0,
    dry_run: bool = False,
    store: StoreUrl = STORE,
    releases: Releases = None,
) -> None:
    """Remove what neither a release nor a recent run needs. Safe beside runs.

    Parameters
    ----------
    keep_runs
        The last runs of every map that stay.
    keep_days
        Runs of the last days stay as well.
    grace_hours
        What is younger stays: longer than the longest run.
    dry_run
        Only say what would be removed.
    store
        Folder of the artifact store, or s3://bucket/prefix.
    releases
        Folder of the releases.
    """
    from flexmap_tasks.engine.gc import collect  # noqa: PLC0415

    swept = collect(
        Store.open(store, releases),
        keep_runs=keep_runs,
        keep_days=keep_days,
        grace_s=grace_hours * 3600,
        dry_run=dry_run,
    )
    console.say(
        f"{'would remove' if dry_run else 'removed'} {swept.blobs} blobs, {swept.records} records, {swept.runs} runs "
        f"and {swept.leftovers} leftovers: {size(swept.bytes)}"
    )
    console.say(f"{swept.left_blobs} blobs and {swept.left_records} records stay: {size(swept.left_bytes)}")


@store_app.command
def stats(*, store: StoreUrl = STORE) -> None:
    """Count what is in the store.

    Parameters
    ----------
    store
        Folder of the artifact store, or s3://bucket/prefix.
    """
    from flexmap_tasks.engine.gc import stats as count  # noqa: PLC0415

    for what, number, total in count(Store.open(store)):
        console.say(f"{what:<10}{number:>9}  {size(total):>10}")


def push(url: str, *, store: StoreUrl = STORE, releases: Releases = None) -> None:
    """Copy what another store is missing to it; may be interrupted and begun again.

    Parameters
    ----------
    url
        Folder of the other store, or s3://bucket/prefix.
    store
        The store to copy from.
    releases
        Folder of its releases.
    """
    _copy(Store.open(store, releases), Store.open(url))


def pull(url: str, *, store: StoreUrl = STORE, releases: Releases = None) -> None:
    """Copy what this store is missing from another one; may be interrupted and begun again.

    Parameters
    ----------
    url
        Folder of the other store, or s3://bucket/prefix.
    store
        The store to copy to.
    releases
        Folder of its releases.
    """
    _copy(Store.open(url), Store.open(store, releases))


def _copy(source: Store, target: Store) -> None:
    from flexmap_tasks.engine.sync import copy_missing  # noqa: PLC0415

    copied = copy_missing(source, target)
    console.say(
        f"{copied.blobs} blobs ({size(copied.bytes)}), {copied.records} records and {copied.releases} releases copied"
    )
    if copied.skipped:
        console.say(f"{copied.skipped} records were not whole in {source.backend.url} and were left out")


def size(count: float) -> str:
    """Bytes as people read them."""
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000
    return f"{count:.1f} TB"
