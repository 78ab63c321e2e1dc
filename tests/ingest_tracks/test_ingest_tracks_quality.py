"""Fixes that say how good they are: NMEA logs, NMEA sentences and GPSFix messages in recordings."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import ingest_track_recordings as rec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from flexmap_tasks.config import GnssParams
from flexmap_tasks.errors import InputError
from flexmap_tasks.formats.mcap_writer import NS_PER_S
from flexmap_tasks.ingest.gnss import ingest_gnss
from flexmap_tasks.model.source import Source
from flexmap_tasks.model.tracks import GnssFixes

START = datetime(2026, 11, 25, 23, 59, 58, tzinfo=UTC)
T0 = int(START.timestamp()) * NS_PER_S
STEP = NS_PER_S // 5


def sentence(body: str) -> str:
    check = 0
    for byte in body.encode():
        check ^= byte
    return f"${body}*{check:02X}"


def clock(stamp_ns: int) -> tuple[str, str]:
    at = datetime.fromtimestamp(stamp_ns // NS_PER_S, UTC)
    return f"{at:%H%M%S}.{stamp_ns % NS_PER_S // 10_000_000:02d}", f"{at:%d%m%y}"


def minutes(value: float, digits: int) -> str:
    whole = int(abs(value))
    return f"{whole:0{digits}d}{(abs(value) - whole) * 60:010.7f}"


def gga(
    stamp_ns: int, lat: float, lon: float, quality: int = 4, hdop: float = 0.8, talker: str = "GN"
) -> str:
    at = f"{minutes(lat, 2)},{'NS'[lat < 0]},{minutes(lon, 3)},{'EW'[lon < 0]}"
    if quality == 0:
        at = ",,,"
    return sentence(f"{talker}GGA,{clock(stamp_ns)[0]},{at},{quality},12,{hdop},480.25,M,46.50,M,1.0,0001")


def rmc(stamp_ns: int) -> str:
    time, day = clock(stamp_ns)
    return sentence(f"GNRMC,{time},A,4815.0,N,01140.0,E,0.1,0.0,{day},,,R")


def gst(stamp_ns: int, north: float, east: float, up: float) -> str:
    return sentence(f"GNGST,{clock(stamp_ns)[0]},0.9,,,,{north},{east},{up}")


def place(k: int) -> tuple[float, float]:
    return 48.2643 + k * 1e-6, -11.669 - k * 2e-6


def read(tmp_path: Path, lines: list[str], **params: object) -> GnssFixes:
    (tmp_path / "log.nmea").write_bytes("\r\n".join(lines).encode("latin-1"))
    return ingest_gnss(Source("log.nmea", tmp_path / "log.nmea"), GnssParams.model_validate(params))


def test_a_log_over_midnight_with_the_receiver_s_own_deviations(tmp_path: Path) -> None:
    lines = ["garbage \xff amid a line", "$GNGSV,1,1,00*79"]
    for k in range(30):
        stamp = T0 + k * STEP
        lines += [f"12:00:01.5 {gga(stamp, *place(k))}", gst(stamp, 0.02, 0.01, 0.03)]
        if k % 5 == 4:
            lines.append(rmc(stamp))
    fixes = read(tmp_path, lines)
    assert len(fixes) == 30
    np.testing.assert_array_equal(fixes.stamp_ns, T0 + np.arange(30) * STEP)
    np.testing.assert_allclose(fixes.lat_deg, [place(k)[0] for k in range(30)], atol=1e-9)
    np.testing.assert_allclose(fixes.lon_deg, [place(k)[1] for k in range(30)], atol=1e-9)
    np.testing.assert_allclose(fixes.alt_m, 526.75)
    np.testing.assert_allclose(fixes.sigma_east_m, 0.01)
    np.testing.assert_allclose(fixes.sigma_north_m, 0.02)
    np.testing.assert_allclose(fixes.sigma_up_m, 0.03)


def test_the_quality_tells_fixed_from_float_and_from_nothing(tmp_path: Path) -> None:
    qualities = [4, 5, 2, 1, 0, 6, 7, 8, 3, 9]
    lines = [gga(T0 + k * STEP, *place(k), quality=q, hdop=1.0, talker="GP") for k, q in enumerate(qualities)]
    fixes = read(tmp_path, [rmc(T0), *lines])
    assert fixes.status.tolist() == [2, 1, 1, 0, -1, -1, -1, 0, 0, -1]
    np.testing.assert_allclose(fixes.sigma_east_m[:4], [0.015, 0.4, 1.0, 2.5])
    np.testing.assert_allclose(fixes.sigma_up_m[:4], [0.03, 0.8, 2.0, 5.0])
    assert np.isnan(fixes.lat_deg[[4, 5, 6, 9]]).all()
    assert np.isnan(fixes.sigma_east_m[7]), "a simulator says nothing"


def test_a_log_without_dates_needs_the_day(tmp_path: Path) -> None:
    lines = [gga(T0 + k * STEP, *place(k)) for k in range(30)]
    with pytest.raises(InputError, match=r"log.nmea: the log says no date .*gnss\.nmea_date"):
        read(tmp_path, lines)
    fixes = read(tmp_path, lines, nmea_date="2026-11-25")
    np.testing.assert_array_equal(fixes.stamp_ns, T0 + np.arange(30) * STEP)


def test_heights_of_two_kinds_are_not_mixed(tmp_path: Path) -> None:
    bare = gga(T0 + STEP, *place(1)).replace("46.50", "")
    bare = sentence(bare[1:].partition("*")[0])
    both = read(tmp_path, [rmc(T0), gga(T0, *place(0)), bare])
    assert both.alt_m[0] == 526.75
    assert np.isnan(both.alt_m[1])
    assert read(tmp_path, [rmc(T0), bare]).alt_m.tolist() == [480.25]


def test_damaged_sentences(tmp_path: Path) -> None:
    good = [rmc(T0), *(gga(T0 + k * STEP, *place(k)) for k in range(40))]
    cut = [good[1][20:], *good, good[-1][:30]]
    assert len(read(tmp_path, cut)) == 40
    flipped = [line.replace("48", "47", 1) if k % 3 == 0 else line for k, line in enumerate(good)]
    with pytest.raises(InputError, match=r"sentences beside .* good fixes are damaged"):
        read(tmp_path, flipped)
    with pytest.raises(InputError, match="no GGA sentence with a right checksum"):
        read(tmp_path, ["$GNGGA,120000,4815,N,01140,E,4,12,0.8,480,M,46,M,,*00"] * 3)
    with pytest.raises(InputError, match="no GGA sentence"):
        read(tmp_path, ["hello"], format="nmea")


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.text(st.sampled_from("0123456789.,NSEWAM-"), max_size=60), max_size=4),
    st.sampled_from(["GGA", "RMC", "ZDA", "GST"]),
)
def test_any_text_with_a_right_checksum_is_read_or_refused(
    tmp_path: Path, bodies: list[str], kind: str
) -> None:
    lines = [rmc(T0), gga(T0, *place(0)), *(sentence(f"GN{kind},{body}") for body in bodies)]
    try:
        fixes = read(tmp_path, lines)
    except InputError as error:
        line = str(error)
    else:
        line = ""
        assert len(fixes) >= 1
    assert "\n" not in line


DEFINITIONS = {
    "gps_msgs/msg/GPSStatus": "std_msgs/Header header\nuint16 satellites_used\nint32[] satellite_used_prn\n"
    "uint16 satellites_visible\nint32[] satellite_visible_prn\nint32[] satellite_visible_z\n"
    "int32[] satellite_visible_azimuth\nint32[] satellite_visible_snr\nint16 status\nuint16 motion_source\n"
    "uint16 orientation_source\nuint16 position_source\n",
    "gps_msgs/msg/GPSFix": "std_msgs/Header header\ngps_msgs/GPSStatus status\n"
    + "".join(f"float64 {n}\n" for n in ["latitude", "longitude", "altitude", "track", "speed", "climb", "pitch", "roll", "dip", "time", "gdop", "pdop", "hdop", "vdop", "tdop", "err", "err_horz", "err_vert", "err_track", "err_speed", "err_climb", "err_time", "err_pitch", "err_roll", "err_dip"])
    + "float64[9] position_covariance\nuint8 position_covariance_type\n",
    "nmea_msgs/msg/Sentence": "std_msgs/Header header\nstring sentence\n",
}  # fmt: skip
STORE = get_typestore(Stores.ROS2_HUMBLE)
for name_, text_ in DEFINITIONS.items():
    STORE.register(get_types_from_msg(text_, name_))


def record(topic: str, log_ns: int, message: object, kind: str, little: bool = True) -> rec.Record:
    payload = bytes(STORE.serialize_cdr(message, kind, little_endian=little))
    return rec.Record(topic, kind, log_ns, payload, schema=DEFINITIONS[kind].encode())


def gps_fix(k: int, status: int, covariance: float = 0.0, errors: tuple[float, float] = (0.0, 0.0)) -> object:
    numbers = dict.fromkeys(DEFINITIONS["gps_msgs/msg/GPSFix"].split("float64 ")[1:], 0.0)
    fields = {n.split("\n")[0]: 0.0 for n in numbers if not n.startswith("[")}
    prn = np.arange(k % 4, dtype=np.int32)
    state = STORE.types["gps_msgs/msg/GPSStatus"](
        rec.header(T0, "gps" * (k % 3)), 9, prn, 12, prn, prn[:1], prn, prn[1:], status, 0, 0, 1
    )
    fields |= {"latitude": place(k)[0], "longitude": place(k)[1], "altitude": 500.0}
    fields |= {"err_horz": errors[0], "err_vert": errors[1]}
    fields.pop("position_covariance", None)
    return STORE.types["gps_msgs/msg/GPSFix"](
        header=rec.header(T0 + k * STEP, "gps"), status=state, **fields,
        position_covariance=np.diag([covariance] * 3).ravel(), position_covariance_type=2 * (covariance > 0),
    )  # fmt: skip


def test_gps_fix_messages_tell_rtk_fixed_from_float(tmp_path: Path) -> None:
    kind, states = "gps_msgs/msg/GPSFix", [19, 20, 18, 0, -1, 33, 2, 77]
    messages = [record("/gps", T0, gps_fix(k, s), kind, little=k % 2 == 0) for k, s in enumerate(states)]
    messages.append(record("/gps", T0, gps_fix(8, 19, covariance=0.25), kind))
    messages.append(record("/gps", T0, gps_fix(9, 20, errors=(2.448, 3.92)), kind))
    file = rec.write(tmp_path / "a.mcap", messages)
    fixes = ingest_gnss(Source("a.mcap", file), GnssParams())
    assert fixes.status.tolist() == [2, 1, 1, 0, -1, 1, 2, 0, 2, 1]
    np.testing.assert_array_equal(fixes.stamp_ns, T0 + np.arange(10) * STEP)
    np.testing.assert_allclose(fixes.sigma_east_m[[0, 1, 2, 3, 8, 9]], [0.015, 0.4, 1.0, 2.5, 0.5, 1.0])
    np.testing.assert_allclose(fixes.sigma_up_m[[0, 8, 9]], [0.03, 0.5, 2.0])
    usable = fixes.status >= 0
    np.testing.assert_array_equal(fixes.lat_deg[usable], [place(k)[0] for k in np.flatnonzero(usable)])


def test_nav_sat_fix_is_taken_where_both_are_there(tmp_path: Path) -> None:
    both = [record("/gps", T0, gps_fix(k, 19), "gps_msgs/msg/GPSFix") for k in range(3)]
    both += [rec.ros_record("/fix", T0 + k, rec.fix(T0 + k, (48.0, 11.0, 5.0))) for k in range(4)]
    source = Source("a.mcap", rec.write(tmp_path / "a.mcap", both))
    assert len(ingest_gnss(source, GnssParams())) == 4
    assert len(ingest_gnss(source, GnssParams(topic="/gps"))) == 3


def test_sentences_in_a_recording_keep_their_even_times_on_its_clock(tmp_path: Path) -> None:
    rng, messages = np.random.default_rng(3), []
    lag = 3_600 * NS_PER_S + 80_000_000  # another clock, and the cable
    for k in range(200):
        stamp = T0 + k * STEP
        came = stamp + lag + int(rng.exponential(5e6)) - 3_465_736
        for line in (gga(stamp, *place(k)), gst(stamp, 0.02, 0.02, 0.04)):
            message = STORE.types["nmea_msgs/msg/Sentence"](header=rec.header(came, "gps"), sentence=line)
            messages.append(record("/nmea", came, message, "nmea_msgs/msg/Sentence"))
    file = rec.write(tmp_path / "a.mcap", messages)
    fixes = ingest_gnss(Source("a.mcap", file), GnssParams())
    assert len(fixes) == 200
    assert (np.diff(fixes.stamp_ns) == STEP).all()
    assert abs(fixes.stamp_ns[0] - (T0 + lag)) < 2_000_000
    np.testing.assert_allclose(fixes.sigma_east_m, 0.02)
    assert (fixes.status == 2).all()
