"""LAS, LAZ and COPC: every field in every tile, and hostile files refused in one line."""

from __future__ import annotations

import io
import struct
import subprocess
import sys
from pathlib import Path

import laspy
import lazrs
import numpy as np
import pyproj
import pytest

from flexmap_tasks.config import PointCloudParams
from flexmap_tasks.errors import InputError
from flexmap_tasks.ingest.point_cloud import ingest_point_cloud
from flexmap_tasks.model.clouds import PointCloud
from flexmap_tasks.model.source import Source

PARAMS = PointCloudParams()
POINTS = 3000
WAVES = [(4, "1.3"), (5, "1.3"), (9, "1.4"), (10, "1.4")]
FORMATS = [(0, "1.2"), (1, "1.2"), (2, "1.2"), (3, "1.2"), (6, "1.4"), (7, "1.4"), (8, "1.4")]


def las(
    folder: Path, name: str, kind: int = 7, version: str = "1.4", points: int = POINTS, crs: int = 0
) -> Path:
    """A file with every dimension filled, scaled and plain extra bytes, and the row's number."""
    rng = np.random.default_rng(kind)
    header = laspy.LasHeader(point_format=kind, version=version)
    header.scales, header.offsets = [0.001, 0.002, 0.0005], [10.0, -20.0, 5.0]
    header.add_extra_dim(laspy.ExtraBytesParams("row", "u4"))
    header.add_extra_dim(laspy.ExtraBytesParams("echo width", "i4", scales=[0.01], offsets=[5.0]))
    header.add_extra_dim(laspy.ExtraBytesParams("normal", "3f4"))
    if crs:
        header.add_crs(pyproj.CRS(crs))
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = rng.uniform(-50, 50, (3, points)) * [[1], [1], [0.1]]
    for dimension in header.point_format.dimensions:
        name_ = dimension.name
        if name_ in ("X", "Y", "Z", "row", "echo width", "normal"):
            continue
        most = 1 << min(dimension.num_bits, 16) - (
            dimension.dtype is not None and dimension.dtype.kind == "i"
        )
        cloud[name_] = rng.integers(0, most, points)
    cloud["row"], cloud["echo width"] = np.arange(points), rng.integers(-500, 500, points) * 0.01
    cloud["normal"] = rng.normal(size=(points, 3)).astype("f4")
    cloud.write(folder / name)
    return folder / name


def read(path: Path) -> PointCloud:
    tiles = ingest_point_cloud(Source(path.name, path), PARAMS)
    parts = list(tiles.tiles.values())
    names = list(parts[0].fields)
    whole = PointCloud(
        np.concatenate([p.xyz_m for p in parts]),
        {n: np.concatenate([p.fields[n] for p in parts]) for n in names},
    )
    return whole.take(np.argsort(whole.fields["row"]))


@pytest.mark.parametrize("suffix", ["las", "laz"])
@pytest.mark.parametrize(("kind", "version"), FORMATS)
def test_every_field_of_every_point_format_arrives(
    tmp_path: Path, kind: int, version: str, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("flexmap_tasks.formats.las.BLOCK_BYTES", 40_000)
    path = las(tmp_path, f"cloud.{suffix}", kind, version)
    cloud, truth = read(path), laspy.read(path)
    np.testing.assert_array_equal(cloud.xyz_m, truth.xyz)
    renamed = {d.name: d.name.replace(" ", "_") for d in truth.point_format.dimensions}
    assert set(cloud.fields) == set(renamed.values()) - {"X", "Y", "Z"}
    for name, mine in renamed.items():
        if name not in ("X", "Y", "Z"):
            np.testing.assert_array_equal(cloud.fields[mine], np.asarray(truth[name]), err_msg=name)
    assert cloud.fields["echo_width"].dtype == np.float64
    assert cloud.fields["intensity"].dtype == np.uint16
    assert cloud.fields["normal"].shape == (POINTS, 3)


def copc(folder: Path, path: Path) -> Path:
    """The points of a LAS file as COPC lays them out: chunks of any size, records "copc" before and behind."""
    whole = laspy.read(path)
    kind = whole.header.point_format
    vlr = lazrs.LazVlr.new_for_compression(kind.id, kind.num_extra_bytes, True)
    info = struct.pack("<H16sHH32s", 0, b"copc", 1, 160, b"") + bytes(160)
    laszip = vlr.record_data()
    extra = next(v for v in whole.header.vlrs if v.user_id == "LASF_Spec").record_data_bytes()
    records = info
    for user, number, content in ((b"laszip encoded", 22204, laszip), (b"LASF_Spec", 4, extra)):
        records += struct.pack("<H16sHH32s", 0, user, number, len(content), b"") + content
    start = 375 + len(records)
    points = np.frombuffer(whole.points.array.tobytes(), np.uint8).reshape(len(whole), -1)
    out = io.BytesIO(bytes(start))
    out.seek(start)
    packer = lazrs.LasZipCompressor(out, vlr)
    for part in np.split(points, [100, 101, 1700]):
        packer.compress_many(part.reshape(-1))
        packer.finish_current_chunk()
    packer.done()
    body = out.getvalue()[start:]
    hierarchy = struct.pack("<H16sHQ32s", 0, b"copc", 1000, 32, b"") + bytes(32)
    head = bytearray(path.read_bytes()[:375])
    struct.pack_into("<HIIB", head, 94, 375, start, 3, kind.id | 0x80)
    struct.pack_into("<QI", head, 235, start + len(body), 1)
    (folder / "cloud.copc.laz").write_bytes(bytes(head) + records + body + hierarchy)
    return folder / "cloud.copc.laz"


def test_copc_is_read_like_any_other(tmp_path: Path) -> None:
    plain = las(tmp_path, "cloud.las")
    mine, packed = read(plain), read(copc(tmp_path, plain))
    np.testing.assert_array_equal(packed.xyz_m, mine.xyz_m)
    assert {n: v.tobytes() for n, v in packed.fields.items()} == {
        n: v.tobytes() for n, v in mine.fields.items()
    }


@pytest.mark.parametrize(("kind", "version"), WAVES)
def test_waveform_packets_are_kept_as_numbers(tmp_path: Path, kind: int, version: str) -> None:
    path = las(tmp_path, "cloud.las", kind, version)
    cloud, truth = read(path), laspy.read(path)
    np.testing.assert_array_equal(cloud.fields["wavepacket_offset"], truth["wavepacket_offset"])
    np.testing.assert_array_equal(
        cloud.fields["return_point_wave_location"], truth["return_point_wave_location"]
    )


def test_a_file_that_declares_a_map_s_system_is_told(tmp_path: Path) -> None:
    path = las(tmp_path, "cloud.laz", crs=25832)
    found = ingest_point_cloud(Source("cloud.laz", path), PARAMS).findings
    assert found.code.tolist() == ["cloud-declares-crs"]
    assert "ETRS89 / UTM zone 32N (EPSG:25832)" in found.message[0]
    assert "must not be aligned again" in found.message[0]
    plain = ingest_point_cloud(Source("cloud.laz", las(tmp_path, "cloud.laz")), PARAMS)
    assert len(plain.findings) == 0


def patched(content: bytes, at: int, form: str, *values: float) -> bytes:
    return content[:at] + struct.pack(form, *values) + content[at + struct.calcsize(form) :]


def _old_compressor(content: bytes) -> bytes:
    """LAZ from before chunks; a LAS file without the record is cut instead."""
    at = content.find(b"laszip encoded")
    return patched(content, at + 52, "<H", 1) if at > 0 else content[:-1]


HOSTILE = {
    "cut in the header": (lambda c: c[:200], "cut off"),
    "cut in the points": (lambda c: c[:-5000], "cut off|damaged"),
    "one byte less": (lambda c: c[:-1], "cut off|damaged"),
    "version": (lambda c: patched(c, 24, "<B", 2), "expected LAS 1.0 to 1.4"),
    "header size": (lambda c: patched(c, 94, "<H", 100), "header of 375 bytes"),
    "points behind the end": (lambda c: patched(c, 96, "<I", 1 << 31), "points start at byte"),
    "points in the header": (lambda c: patched(c, 96, "<I", 30), "points start at byte"),
    "records": (lambda c: patched(c, 100, "<I", 0xFFFFFFFF), "record|points' start"),
    "record length": (lambda c: patched(c, 375 + 20, "<H", 0xFFFF), "claims 65,535 bytes"),
    "point format": (lambda c: patched(c, 104, "<B", c[104] & 0xC0 | 40), "point format 40"),
    "point length": (lambda c: patched(c, 105, "<H", 3), "36 bytes or more"),
    "point count": (lambda c: patched(c, 247, "<Q", 1 << 60), "points"),
    "one point more": (lambda c: patched(c, 247, "<Q", POINTS + 60_000), "points"),
    "scale": (lambda c: patched(c, 131, "<d", float("nan")), "scales must be positive"),
    "compressor": (_old_compressor, "compressor 1 is not read|^bad.las"),
    "zero scale": (lambda c: patched(c, 139, "<d", 0.0), "scales must be positive"),
    "offset": (lambda c: patched(c, 155, "<d", float("inf")), "offsets finite"),
    "extended records": (lambda c: patched(c, 235, "<QI", 1 << 62, 5), "behind the file's end"),
}  # fmt: skip


@pytest.mark.parametrize("suffix", ["las", "laz"])
@pytest.mark.parametrize("harm", HOSTILE)
def test_hostile_headers_are_refused(tmp_path: Path, harm: str, suffix: str) -> None:
    content = las(tmp_path, f"cloud.{suffix}").read_bytes()
    damage, rule = HOSTILE[harm]
    (tmp_path / "bad.las").write_bytes(damage(content))
    with pytest.raises(InputError, match=rule) as caught:
        ingest_point_cloud(Source("bad.las", tmp_path / "bad.las"), PARAMS)
    assert str(caught.value).startswith("bad.las")
    assert "\n" not in str(caught.value)


def test_points_outside_of_the_stated_box_are_told(tmp_path: Path) -> None:
    content = las(tmp_path, "cloud.las").read_bytes()
    (tmp_path / "cloud.las").write_bytes(patched(content, 179, "<d", 0.0))
    found = ingest_point_cloud(Source("cloud.las", tmp_path / "cloud.las"), PARAMS).findings
    assert found.code.tolist() == ["cloud-outside-its-header"]


FUZZ = """
import resource, sys
from pathlib import Path
import numpy as np
from flexmap_tasks.config import PointCloudParams
from flexmap_tasks.errors import InputError
from flexmap_tasks.ingest.point_cloud import ingest_point_cloud
from flexmap_tasks.model.source import Source
resource.setrlimit(resource.RLIMIT_CPU, (120, 120))
folder, rounds = Path(sys.argv[1]), int(sys.argv[2])
rng, refused = np.random.default_rng(4), 0
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for name in ("cloud.las", "cloud.laz"):
    whole = np.frombuffer((folder / name).read_bytes(), np.uint8)
    for n in range(rounds):
        bad = whole[: rng.integers(1, len(whole))] if n % 4 == 0 else whole.copy()
        if n % 4:
            low, high = ((0, 1200), (0, len(bad)), (len(bad) - 200, len(bad)))[n % 4 - 1]
            bad[rng.integers(low, high, rng.integers(1, 4))] ^= np.uint8(1 << rng.integers(8))
        (folder / "bad").write_bytes(bad.tobytes())
        try:
            ingest_point_cloud(Source("bad", folder / "bad"), PointCloudParams())
        except InputError as error:
            refused += 1
            assert "\\n" not in str(error)
grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
assert grown < 300_000, f"{grown} kB"
print(refused)
"""


def test_flipped_bits_and_cuts_end_in_a_line_or_in_points(tmp_path: Path) -> None:
    for name in ("cloud.las", "cloud.laz"):
        las(tmp_path, name, points=600)
    run = [sys.executable, "-c", FUZZ, str(tmp_path), "80"]  # a process of its own: an abort must not hide
    done = subprocess.run(run, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert int(done.stdout) > 40
    assert not done.stderr
