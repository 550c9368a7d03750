"""Places on the Earth against published figures, and the way there and back."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.contracts.geodesy import GeoPoint, moved, ned_between

PLACES = st.builds(GeoPoint.of_degrees, st.floats(-85, 85), st.floats(-180, 180), st.floats(-50, 3000))
METRES = st.floats(-20_000, 20_000)


@pytest.mark.parametrize(
    ("latitude_deg", "north_m", "east_m"),
    # Lengths of a degree of latitude and longitude of WGS-84: Rapp, Geometric Geodesy I, table 3.1 (there to the metre).
    [(0.0, 110_574.0, 111_320.0), (45.0, 111_132.0, 78_847.0), (60.0, 111_412.0, 55_800.0)],
)
def test_a_thousandth_of_a_degree_is_as_long_as_the_tables_say(latitude_deg: float, north_m: float, east_m: float) -> None:
    here = GeoPoint.of_degrees(latitude_deg, 10.0, 0.0)
    assert ned_between(here, GeoPoint.of_degrees(latitude_deg + 1e-3, 10.0, 0.0))[0] == pytest.approx(1e-3 * north_m, abs=0.01)
    assert ned_between(here, GeoPoint.of_degrees(latitude_deg, 10.001, 0.0))[1] == pytest.approx(1e-3 * east_m, abs=0.01)
    assert ned_between(here, GeoPoint.of_degrees(latitude_deg, 10.0, 7.0)) == pytest.approx([0.0, 0.0, -7.0], abs=1e-6)


@given(PLACES, METRES, METRES, st.floats(-500, 500))
def test_a_place_that_was_moved_lies_where_it_was_moved_to(here: GeoPoint, north: float, east: float, down: float) -> None:
    way = np.array([north, east, down])
    assert ned_between(here, moved(here, way)) == pytest.approx(way, abs=2e-3)


def test_the_date_line_and_unknown_heights() -> None:
    west, east = GeoPoint.of_degrees(0.0, 179.9995), GeoPoint.of_degrees(0.0, -179.9995)
    assert ned_between(west, east) == pytest.approx([0.0, 111.32, 0.0], abs=0.01)
    high = GeoPoint.of_degrees(0.0, 179.9995, 40.0)
    assert abs(ned_between(west, high)[2]) < 1e-6, "a height that is not known counts as the other's"


@pytest.mark.parametrize(
    ("lat", "lon", "height"), [(91, 0, 0), (0, 181, 0), (math.nan, 0, 0), (0, math.inf, 0), (0, 0, math.nan)]
)
def test_no_such_place(lat: float, lon: float, height: float) -> None:
    with pytest.raises(ValueError, match=r"no such place|no height"):
        GeoPoint.of_degrees(lat, lon, height)
