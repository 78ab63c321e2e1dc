"""PCD files: what is written is read, and nothing else is."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pcd_writer import body, header, lzf, pcd, source

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.pcd import PcdReader, pcd_bytes, read_pcd
from flexmap_tasks.formats.pcd_lzf import BEFORE_START, OVERLONG, TRUNCATED, lzf_decode
from flexmap_tasks.model.clouds import PointCloud
from flexmap_tasks.model.source import Source

ENCODINGS = ("ascii", "binary", "binary_compressed")
SCALARS = ("<i1", "<i2", "<i4", "<i8", "<u1", "<u2", "<u4", "<u8", "<f4", "<f8")


@st.composite
def clouds(draw: st.DrawFn) -> np.ndarray:
    """Records with x, y, z in any order among up to five fields of any type, some of several values."""
    axis = draw(st.sampled_from(["<f4", "<f8"]))
    fields = [("x", axis, ()), ("y", axis, ()), ("z", axis, ())]
    for i in range(draw(st.integers(0, 5))):
        shape = draw(st.sampled_from([(), (2,), (5,)]))
        fields.append((f"field{i}", draw(st.sampled_from(SCALARS)), shape))
    dtype = np.dtype(draw(st.permutations(fields)))
    return draw(hnp.arrays(dtype, draw(st.integers(0, 12))))


@settings(max_examples=120, deadline=None)
@given(clouds(), st.sampled_from(ENCODINGS), st.integers(0, 3))
def test_every_type_and_encoding_reads_back_bit_for_bit(
    records: np.ndarray, encoding: str, padding: int
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        cloud = read_pcd(source(Path(folder), pcd(records, encoding, padding=padding)))
    expected = np.column_stack([records[a].astype("f8") for a in "xyz"])
    np.testing.assert_array_equal(cloud.xyz_m, expected)
    assert list(cloud.fields) == [n for n in records.dtype.names if n not in ("x", "y", "z")]
    for name, values in cloud.fields.items():
        assert values.dtype == records.dtype[name].base
        np.testing.assert_array_equal(values, records[name])
        if encoding != "ascii":
            assert values.tobytes() == np.ascontiguousarray(records[name]).tobytes()


@settings(max_examples=40, deadline=None)
@given(clouds())
def test_written_files_read_back_and_are_the_same_twice(records: np.ndarray) -> None:
    xyz_m = np.nan_to_num(np.column_stack([records[a].astype("f8") for a in "xyz"]), posinf=1, neginf=1)
    xyz_m = np.clip(xyz_m, -1e30, 1e30)
    cloud = PointCloud(xyz_m, {n: records[n].copy() for n in records.dtype.names if n not in ("x", "y", "z")})
    content = pcd_bytes(cloud)
    assert content == pcd_bytes(cloud)
    with tempfile.TemporaryDirectory() as folder:
        back = read_pcd(source(Path(folder), content))
    np.testing.assert_array_equal(back.xyz_m, xyz_m.astype("f4"))
    for name, values in cloud.fields.items():
        assert back.fields[name].tobytes() == values.tobytes()
        assert back.fields[name].dtype == values.dtype


def test_open3d_reads_what_we_write_and_we_read_what_it_writes(tmp_path: Path) -> None:
    o3d = pytest.importorskip("open3d")
    rng = np.random.default_rng(7)
    cloud = PointCloud(
        rng.normal(0, 50, (5000, 3)).astype("f4").astype("f8"),
        {"intensity": rng.random(5000).astype("f4"), "ring": rng.integers(0, 9, 5000).astype("u2")},
    )
    path = tmp_path / "ours.pcd"
    path.write_bytes(pcd_bytes(cloud))
    peer = o3d.t.io.read_point_cloud(str(path))
    np.testing.assert_array_equal(peer.point.positions.numpy(), cloud.xyz_m)
    for name, values in cloud.fields.items():
        np.testing.assert_array_equal(peer.point[name].numpy()[:, 0], values)
    for ascii_, compressed in ((False, True), (False, False), (True, False)):
        theirs = tmp_path / "theirs.pcd"
        assert o3d.t.io.write_point_cloud(str(theirs), peer, write_ascii=ascii_, compressed=compressed)
        back = read_pcd(source(tmp_path, theirs.read_bytes()))
        np.testing.assert_allclose(back.xyz_m, cloud.xyz_m, rtol=0, atol=1e-5 if ascii_ else 0)
        np.testing.assert_array_equal(back.fields["ring"], cloud.fields["ring"])


def test_real_scans(shared_data: Path) -> None:
    scans = sorted((shared_data / "pcd").glob("*.pcd"))
    assert scans
    for path in scans:
        records = np.frombuffer(path.read_bytes().split(b"DATA binary\n", 1)[1], "<f4").reshape(-1, 4)
        cloud = read_pcd(source_of(path))
        np.testing.assert_array_equal(cloud.xyz_m, records[:, :3])
        np.testing.assert_array_equal(cloud.fields["intensity"], records[:, 3])
        assert pcd_bytes(cloud).split(b"DATA binary\n", 1)[1] == records.tobytes()


def source_of(path: Path) -> Source:
    return Source(path.name, path)


def test_ascii_keeps_all_digits_of_large_coordinates(tmp_path: Path) -> None:
    records = np.zeros(1, [("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    content = header(records, "ascii") + b"698073.91706 5349128.20088 1e-3\n"
    assert read_pcd(source(tmp_path, content)).xyz_m.tolist() == [[698073.91706, 5349128.20088, 0.001]]


def test_ascii_of_other_people_s_taste(tmp_path: Path) -> None:
    records = np.zeros(3, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("i", "u1")])
    text = b"  1 2\t3  4 \r\n\r\nnan -nan inf 5\n7 +8. .9 255"
    cloud = read_pcd(source(tmp_path, header(records, "ascii") + text))
    np.testing.assert_array_equal(cloud.xyz_m, [[1, 2, 3], [np.nan, np.nan, np.inf], [7, 8, 0.9]])
    assert cloud.fields["i"].tolist() == [4, 5, 255]


def test_a_header_may_be_old_or_sparse(tmp_path: Path) -> None:
    records = np.zeros(2, [("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    for changes in (
        {"COUNT": ""},
        {"VIEWPOINT": ""},
        {"POINTS": ""},
        {"WIDTH": "", "HEIGHT": ""},
        {"VERSION": ".5"},
    ):
        assert len(read_pcd(source(tmp_path, pcd(records, "binary", **changes)))) == 2
    crlf = header(records, "binary").replace(b"\n", b"\r\n") + body(records, "binary")
    assert len(read_pcd(source(tmp_path, crlf))) == 2


POINT = np.zeros(4, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("ring", "<u2")])

BAD_HEADERS = {
    "POINTS -4": ({"POINTS": "-4"}, "whole numbers"),
    "POINTS word": ({"POINTS": "many"}, "whole numbers"),
    "POINTS twice": ({"POINTS": "4 4"}, "needs 1 value"),
    "POINTS differs": ({"POINTS": "5"}, "POINTS says 5, but WIDTH times HEIGHT is 4"),
    "HEIGHT alone": ({"WIDTH": ""}, "no WIDTH line"),
    "no count at all": ({"POINTS": "", "WIDTH": "", "HEIGHT": ""}, "no POINTS line"),
    "huge": ({"POINTS": "999999999999999999", "WIDTH": "999999999999999999"}, "cut off|declares"),
    "too long a number": ({"POINTS": "9" * 5000}, "whole numbers"),
    "no z": ({"FIELDS": "x y w ring"}, "missing: z"),
    "x twice": ({"FIELDS": "x x y z"}, "'x' stands twice"),
    "no fields": ({"FIELDS": " "}, "names no field"),
    "fewer sizes": ({"SIZE": "4 4 4"}, "SIZE needs 4"),
    "size 3": ({"SIZE": "4 4 4 3"}, "no PCD type U of 3 bytes"),
    "half floats": ({"SIZE": "2 4 4 2"}, "no PCD type F of 2 bytes"),
    "type Q": ({"TYPE": "F F F Q"}, "no PCD type Q"),
    "integer x": ({"TYPE": "I F F U"}, "not so: x"),
    "two x": ({"COUNT": "2 1 1 1"}, "not so: x"),
    "count 0": ({"COUNT": "1 1 1 0"}, "COUNT must be at least 1"),
    "count huge": ({"COUNT": "1 1 1 99999999999999"}, "larger than"),
    "version": ({"VERSION": "0.8"}, "version 0.7"),
    "viewpoint": ({"VIEWPOINT": "0 0 0 1"}, "VIEWPOINT needs 7"),
    "viewpoint word": ({"VIEWPOINT": "0 0 0 a 0 0 0"}, "seven numbers"),
    "data": ({"DATA": "zip"}, "expected one of"),
    "unknown line": ({"VERSION": "0.7\nSECRET 1"}, "'SECRET'"),
    "doubled line": ({"VERSION": "0.7\nVERSION 0.7"}, "stands twice"),
}


@pytest.mark.parametrize("case", BAD_HEADERS)
@pytest.mark.parametrize("encoding", ["binary", "binary_compressed"])
def test_a_bad_header_is_one_clear_line(tmp_path: Path, case: str, encoding: str) -> None:
    changes, message = BAD_HEADERS[case]
    with pytest.raises(InputError, match=message) as error:
        read_pcd(source(tmp_path, pcd(POINT, encoding, **changes)))
    assert re.fullmatch(r"cloud\.pcd[^\n]*", str(error.value))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"\n", "ends before its DATA line"),
        (b"VERSION 0.7\nFIELDS x y z\n", "ends before its DATA line"),
        (b"LASF\x00\x00\xff\xfe\n", "is this a PCD file"),
        (b"\x89MCAP0\r\n", "is this a PCD file"),
        (b"# " + b"a" * 100_000, "is this a PCD file"),
        (b"# a\n" * 30_000, "is this a PCD file"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, content: bytes, message: str) -> None:
    with pytest.raises(InputError, match=message):
        PcdReader(source(tmp_path, content))


def test_a_missing_file_or_a_folder_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        PcdReader(source_of(tmp_path / "none.pcd"))
    with pytest.raises(InputError, match="cannot be read"):
        PcdReader(source_of(tmp_path))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_truncated_data_is_refused_wherever_it_ends(tmp_path: Path, encoding: str) -> None:
    rng = np.random.default_rng(1)
    records = np.zeros(4, POINT.dtype)
    records["x"] = rng.random(4)
    whole, start = pcd(records, encoding), len(header(records, encoding))
    for end in range(start, len(whole) - (2 if encoding == "ascii" else 0)):
        with pytest.raises(InputError, match=r"cut off|expected|ends in the middle"):
            read_pcd(source(tmp_path, whole[:end]))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_more_data_than_declared_is_refused(tmp_path: Path, encoding: str) -> None:
    more = body(np.concatenate([POINT, POINT]), "ascii" if encoding == "ascii" else "binary")
    content = (
        header(POINT, encoding) + (body(POINT, encoding) if encoding == "binary_compressed" else b"") + more
    )
    with pytest.raises(InputError, match=r"mend POINTS|more lines"):
        read_pcd(source(tmp_path, content))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (b"1 2 3", "line 14: expected 4 values per point, got 3"),
        (b"1 2 3 4 5", "line 14: expected 4 values per point, got 5"),
        (b"1 2 three 4", "line 14: field z: expected a number, got 'three'"),
        (b"1 2 3 4.5", "line 14: field ring: expected a whole number, got '4.5'"),
        (b"1 2 3 65536", "line 14: field ring: expected 0 to 65535, got '65536'"),
        (b"1 2 3 -1", "line 14: field ring: expected 0 to 65535, got '-1'"),
        (b"1 2 \x00\xff 1", "line 14: field z"),
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, line: bytes, message: str) -> None:
    content = header(POINT, "ascii") + b"0 0 0 0\n\n" + line + b"\n0 0 0 0\n0 0 0 0\n"
    with pytest.raises(InputError) as error:
        read_pcd(source(tmp_path, content))
    assert str(error.value).startswith(f"cloud.pcd {message}")


def test_blocks_of_ascii_join_without_a_seam(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flexmap_tasks.formats.pcd_ascii.BLOCK_BYTES", 100)
    monkeypatch.setattr("flexmap_tasks.formats.pcd_ascii.MAX_NUMBER_BYTES", 30)
    records = np.zeros(500, POINT.dtype)
    records["x"], records["ring"] = np.arange(500) / 7, np.arange(500)
    reader = PcdReader(source(tmp_path, pcd(records, "ascii")))
    assert sum(1 for _ in reader.blocks()) > 20
    np.testing.assert_array_equal(np.concatenate([b["ring"] for b in reader.blocks()]), records["ring"])
    endless = header(POINT, "ascii") + b"1" * 1000
    with pytest.raises(InputError, match="a line without an end"):
        read_pcd(source(tmp_path, endless))


@pytest.mark.parametrize("encoding", ["binary", "binary_compressed"])
def test_blocks_of_binary_join_without_a_seam(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, encoding: str
) -> None:
    monkeypatch.setattr("flexmap_tasks.formats.pcd.BLOCK_BYTES", 100)
    records = np.zeros(500, POINT.dtype)
    records["ring"] = np.arange(500)
    reader = PcdReader(source(tmp_path, pcd(records, encoding)))
    blocks = list(reader.blocks())
    assert {len(b) for b in blocks} == {7, 3}
    np.testing.assert_array_equal(np.concatenate([b["ring"] for b in blocks]), records["ring"])


def packed(data: bytes) -> np.ndarray:
    array = np.frombuffer(data, np.uint8)
    array.flags.writeable = False
    return array


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=400) | st.text("ab", max_size=900).map(str.encode))
def test_lzf_unpacks_what_was_packed(data: bytes) -> None:
    out = np.zeros(len(data), np.uint8)
    assert lzf_decode(packed(lzf(data)), out) == len(data)
    assert out.tobytes() == data


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=300), st.integers(0, 600))
def test_lzf_is_safe_on_any_bytes(data: bytes, size: int) -> None:
    room = np.full(size + 64, 99, np.uint8)
    made = lzf_decode(packed(data), room[:size])
    assert made in (TRUNCATED, OVERLONG, BEFORE_START) or 0 <= made <= size
    assert (room[size:] == 99).all()


@pytest.mark.parametrize(
    ("stream", "message"),
    [
        (b"\x00\x07" + b"\xe0\xff\x00" * 3, "cannot unpack to"),  # 3 tokens of at most 264 bytes
        (b"\x00\x07" + b"\xe0\xff\x00" * 60, "holds more than it declares"),
        (b"\x3f\x10" + b"\x00\x01" * 20, "before its start"),
        (
            b"\x1f" + b"\x01" * 5 + b"\x1f" * 60 + b"\xe0",
            "ends in the middle|unpacks to|holds more|before its start",
        ),
        (b"\x00\x07" * 30, "unpacks to 30 bytes"),
    ],
)
def test_broken_lzf_is_refused(tmp_path: Path, stream: bytes, message: str) -> None:
    records = np.zeros(500 if len(stream) < 12 or len(stream) > 100 else 100, POINT.dtype)
    sizes = np.array([len(stream), records.nbytes], "<u4").tobytes()
    with pytest.raises(InputError, match=message):
        read_pcd(source(tmp_path, header(records, "binary_compressed") + sizes + stream))


def test_a_coordinate_beyond_float32_is_not_written() -> None:
    with pytest.raises(ValueError, match="float32"):
        pcd_bytes(PointCloud(np.array([[1e39, 0, 0]]), {}))


def test_fields_with_names_made_of_axes_keep_their_type() -> None:
    content = pcd_bytes(PointCloud(np.zeros((1, 3)), {"xy": np.array([3], "u1"), "z_err": np.zeros((1, 2))}))
    assert b"FIELDS x y z xy z_err\nSIZE 4 4 4 1 8\nTYPE F F F U F\nCOUNT 1 1 1 1 2\n" in content


@settings(max_examples=400, deadline=None)
@given(
    st.sampled_from(ENCODINGS),
    st.lists(
        st.tuples(st.integers(0, 400), st.integers(0, 3), st.binary(max_size=6)), min_size=1, max_size=4
    ),
)
def test_a_damaged_file_is_read_or_refused_but_nothing_else(
    encoding: str, edits: list[tuple[int, int, bytes]]
) -> None:
    content = bytearray(pcd(POINT, encoding))
    for at, removed, added in edits:
        content[at : at + removed] = added
    with tempfile.TemporaryDirectory() as folder:
        try:
            cloud = read_pcd(source(Path(folder), bytes(content)))
            outcome = "" if cloud.xyz_m.shape == (len(cloud), 3) else "a wrong shape\n"
        except InputError as error:
            outcome = str(error)
    assert "\n" not in outcome
