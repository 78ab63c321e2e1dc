"""A store written by the first format can be read for ever; `format_1` is never written again."""

from __future__ import annotations

from pathlib import Path

from flexmap_tasks.engine.runs import read_runs, write_last_run
from flexmap_tasks.store.artifact import Artifact, digest_of
from flexmap_tasks.store.store import ActionRecord, Store

FIRST = Path(__file__).parent / "format_1"
KEY = digest_of(b"the action")


def write(folder: Path) -> None:
    """How `format_1` was made, by the first version of the store."""
    store = Store.open(folder)
    item = store.put_record(
        ActionRecord(
            digest_of(b"the item"),
            {"stage": "split"},
            Artifact.of({"a.json": store.put_blob(b"1\n")}),
            0.5,
            "2026-11-22T04:00:00+00:00",
            "host",
        )
    )
    files = {"split/a.json": store.put_blob(b"1\n"), "split/b.parquet": store.put_blob(bytes(range(256)))}
    image = {
        "stage": "split",
        "params": {"x_m": 1.5, "name": "Straße"},
        "inputs": {"map": "0" * 64},
        "each": "tile",
    }
    store.put_record(
        ActionRecord(
            KEY, image, Artifact.of(files), 1.25, "2026-11-22T04:00:00+00:00", "host", {"a": item.key}
        )
    )
    sources = {"split.map": {"path": "map.osm", "sha256": "0" * 64, "size": 3}}
    write_last_run(store, "garching", {"split": KEY}, "0123456789abcdef", sources)


def test_the_first_format_can_be_read():
    store = Store.open(FIRST)
    record = store.find(KEY)
    assert record is not None
    assert record.preimage["params"] == {"x_m": 1.5, "name": "Straße"}
    assert record.output.names() == ["split/a.json", "split/b.parquet"]
    assert [store.read_blob(blob) for _, blob in record.output.files] == [b"1\n", bytes(range(256))]
    assert (record.seconds, record.host, record.started) == (1.25, "host", "2026-11-22T04:00:00+00:00")
    assert store.find(record.items["a"]).output.names() == ["a.json"]
    (run,) = read_runs(store)
    assert (run.map, run.release, run.actions) == ("garching", "0123456789abcdef", {"split": KEY})
    assert run.sources["split.map"]["path"] == "map.osm"
