"""MGRS, against known places and against the definition of the grid."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Transformer

from flexmap_tasks.geometry import mgrs

KNOWN = [
    (-77.036527, 38.897957, "18SUJ2338907396"),  # the White House
    (2.294481, 48.858370, "31UDQ4825111932"),  # the Eiffel Tower
    (151.215297, -33.856784, "56HLH3490152289"),  # Sydney Opera House
    (0.0, 0.0, "31NAA6602100000"),
]


@pytest.mark.parametrize(("lon", "lat", "code"), KNOWN)
def test_known_places(lon: float, lat: float, code: str) -> None:
    place = np.array([[lon, lat]])
    found = str(mgrs.codes(place, 5)[0])
    assert found[:5] == code[:5]
    east, north = int(found[5:10]), int(found[10:])
    assert abs(east - int(code[5:10])) <= 60
    assert abs(north - int(code[10:])) <= 60
    assert mgrs.codes(place, 3)[0] == found[:8] + found[10:13]
    assert mgrs.codes(place, 0)[0] == found[:5]


def test_widened_zones() -> None:
    bergen, longyearbyen = (5.324383, 60.397076), (15.633333, 78.223056)
    assert mgrs.codes(np.array([bergen, longyearbyen]), 0).tolist() == ["32VKN", "33XWG"]


def test_codes_of_the_real_maps() -> None:
    # The file says 32UPU: its origin is made up, and 47.8 degrees lie in band T of the same square.
    garching = np.array([[10.33850333544957, 47.84819088742739]])
    tokyo = np.array([[139.9322321670175, 35.90204788912795]])
    assert mgrs.codes(garching, 3).tolist() == ["32TPU001002"]
    assert mgrs.codes(tokyo, 3).tolist() == ["54SVE036736"]


@given(st.floats(-179.99, 179.99), st.floats(-79.9, 83.9))
@settings(deadline=None, max_examples=60)
def test_square_by_definition(lon: float, lat: float) -> None:
    """Letters counted from the definition: column sets of three zones, rows of 2,000 km shifted in even zones."""
    (name,), within = mgrs.squares(np.array([[lon, lat]]))
    zone, band, column, row = int(name[:2]), name[2], name[3], name[4]
    to_utm = Transformer.from_crs(4326, (32600 if lat >= 0 else 32700) + zone, always_xy=True)
    east, north = to_utm.transform(lon, lat)
    letters = "ABCDEFGHJKLMNPQRSTUVWXYZ"
    assert letters.index(column) == ((zone - 1) % 3) * 8 + int((east + 1e-6) // 1e5) - 1
    assert letters.index(row) == (int((north + 1e-6) // 1e5) + (0 if zone % 2 else 5)) % 20
    south = -80 + 8 * letters[2:].index(band)
    assert south - 1e-9 <= lat < south + (12.0001 if band == "X" else 8)
    assert within == pytest.approx(np.array([[east % 1e5, north % 1e5]]), abs=1e-3) or (within < 1e-3).any()


def test_beyond_the_grid() -> None:
    with pytest.raises(ValueError, match="80 degrees"):
        mgrs.squares(np.array([[10.0, 85.0]]))
