import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from estimator.contracts.commands import Velocity
from estimator.contracts.errors import BadInput, DecklanderError, Recoverable, SetupImpossible
from estimator.contracts.estimates import Pose6, RelativeState, Sighting
from estimator.contracts.geometry import GeoPoint, Rotation, fixed_matrix, fixed_vector, moved, ned_between
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Frame, Imu, Range, VesselReport, known
from estimator.contracts.time import MonoNs, Stamp, after, seconds_between

STAMP = Stamp(MonoNs(0), MonoNs(0), 0.001, "sim")
OTHER = Stamp(MonoNs(5), MonoNs(6), 0.001, "hw")
V = np.array([1.0, 2.0, 3.0])
C3, C4, C7 = np.eye(3), np.eye(4), np.eye(7)
R = Rotation.identity()


def any_sighting(d=V, yaw=0.1, cov=C4, confidence=0.5):
    return Sighting(STAMP, 0, "ellipse", d, yaw, False, cov, confidence)


def state(d=V, v=V, cov=C7):
    return RelativeState(MonoNs(0), "ekf", d, v, 0.1, cov, MonoNs(0), True)


VECTORS = {
    "Imu.w": lambda v: Imu(STAMP, v, V),
    "Imu.f": lambda v: Imu(STAMP, V, v),
    "BodyVelocity": lambda v: BodyVelocity(STAMP, v, C3),
    "VesselReport": lambda v: VesselReport(STAMP, v, C3, None, None),
    "Sighting": lambda v: any_sighting(d=v),
    "Pose6": lambda v: Pose6(v, R, np.eye(6)),
    "RelativeState.d": lambda v: state(d=v),
    "RelativeState.v": lambda v: state(v=v),
    "Velocity": lambda v: Velocity(v, 0.0),
}
COVARIANCES = {
    "Attitude": (3, lambda c: Attitude(STAMP, R, c)),
    "BodyVelocity": (3, lambda c: BodyVelocity(STAMP, V, c)),
    "VesselReport": (3, lambda c: VesselReport(STAMP, V, c, None, None)),
    "Sighting": (4, lambda c: any_sighting(cov=c)),
    "Pose6": (6, lambda c: Pose6(V, R, c)),
    "RelativeState": (7, lambda c: state(cov=c)),
}


@pytest.mark.parametrize("make", VECTORS.values(), ids=VECTORS)
@pytest.mark.parametrize("bad", [np.array([1.0, math.nan, 0.0]), np.array([math.inf, 0, 0]), np.zeros(2), np.zeros((3, 1))])
def test_a_vector_that_is_not_finite_or_not_three_long_is_refused(make, bad):
    make(V)
    with pytest.raises(ValueError, match="finite"):
        make(bad)


@pytest.mark.parametrize(("n", "make"), COVARIANCES.values(), ids=COVARIANCES)
def test_what_is_no_covariance_is_refused(n, make):
    make(np.eye(n))
    skewed, negative, nan, alike = np.eye(n), np.eye(n), np.eye(n), np.eye(n) + 1.001 * np.eye(n)[::-1]
    skewed[0, 1], negative[1, 1], nan[0, 0] = 0.5, -1.0, math.nan
    for bad in (skewed, negative, nan, np.eye(n + 1), np.ones(n), *([alike] if n in (3, 4) else [])):
        with pytest.raises(ValueError, match=r"finite|symmetric|definite"):
            make(bad)


@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.floats(-6.0, 6.0))
def test_rounding_makes_no_covariance_of_known_directions_a_wrong_one(seed, rank, size):
    half = 10.0**size * np.random.default_rng(seed).standard_normal((4, rank))
    any_sighting(cov=half @ half.T)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Range(STAMP, math.nan, 0.1),
        lambda: Range(STAMP, -0.1, 0.1),
        lambda: Range(STAMP, 1.0, 0.0),
        lambda: Range(STAMP, 1.0, math.inf),
        lambda: Baro(STAMP, math.nan, 0.1),
        lambda: Baro(STAMP, 1.0, -0.1),
        lambda: Velocity(V, math.nan),
        lambda: any_sighting(yaw=math.nan),
        lambda: any_sighting(yaw=4.0),
        lambda: any_sighting(confidence=math.nan),
        lambda: any_sighting(confidence=1.1),
        lambda: VesselReport(STAMP, V, None, None, None),
        lambda: VesselReport(STAMP, None, None, 0.1, None),
        lambda: Frame(STAMP, 0, np.zeros((4, 4), np.uint8)),
        lambda: Frame(STAMP, 0, np.zeros((4, 4, 3))),
    ],
)
def test_nonsense_is_refused_at_the_border(make):
    with pytest.raises(ValueError, match=r"need|must"):
        make()


def test_samples_keep_their_own_copy_and_cannot_be_written():
    source = V.copy()
    sample = Imu(STAMP, source, V)
    source[0] = 99.0
    assert sample.w_body[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        sample.w_body[0] = 5.0
    frame = Frame(STAMP, 0, np.zeros((2, 2, 3), np.uint8))
    with pytest.raises(ValueError, match="read-only"):
        frame.px[0, 0, 0] = 1


def test_height_lateral_and_age():
    s = RelativeState(MonoNs(5), "ekf", np.array([3.0, -4.0, 2.5]), V, None, C7, MonoNs(1_000_000_000), True)
    assert s.height_m == 2.5
    assert s.lateral_m == 5.0
    assert s.age_s(MonoNs(1_250_000_000)) == 0.25


def test_what_the_caller_has_checked_makes_the_same_samples():
    v, cov, R = fixed_vector(1.0, 2.0, 3.0), fixed_matrix(1.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 3.0), Rotation.identity()
    for cls, *values in (Imu, v, v), (Attitude, R, cov), (BodyVelocity, v, cov):
        made, checked = known(cls, STAMP, *values), cls(STAMP, *values)
        assert type(made) is cls
        assert all(getattr(made, name) is getattr(checked, name) for name in cls.__struct_fields__)
        assert known(cls, OTHER, *values).stamp is OTHER
        assert made.stamp is STAMP, "one sample does not change with the next"


instants = st.integers(0, 10**15).map(MonoNs)


@given(instants, st.integers(-(10**6), 10**6))
def test_after_and_between_are_inverse(t, ms):
    later = after(t, ms / 1e3)
    assert later == t + ms * 1_000_000
    assert seconds_between(t, later) == ms / 1e3
    assert seconds_between(later, t) == -ms / 1e3


@given(instants, st.integers(0, 10**9))
def test_a_stamp_knows_its_delay(t, delay_ns):
    assert Stamp(t, MonoNs(t + delay_ns), 0.0, "hw").delay_s == pytest.approx(delay_ns * 1e-9)


@pytest.mark.parametrize("sigma", [-1e-9, 1.0, 2.0, float("nan"), float("inf")])
def test_an_absurd_uncertainty_is_refused(sigma):
    with pytest.raises(ValueError, match="sigma"):
        Stamp(MonoNs(0), MonoNs(0), sigma, "hw")


def test_a_sample_may_be_early_within_five_sigma_and_no_more():
    assert Stamp(MonoNs(5_000_000), MonoNs(0), 0.001, "synced").delay_s == -0.005
    with pytest.raises(ValueError, match="arrive before"):
        Stamp(MonoNs(5_000_001), MonoNs(0), 0.001, "synced")


@pytest.mark.parametrize("kind", [BadInput, Recoverable, SetupImpossible])
@given(text=st.text())
def test_a_text_is_one_printable_line(kind: type[DecklanderError], text: str) -> None:
    output = str(kind(text))
    assert output.isprintable()
    assert output == text or not text.isprintable()


def test_a_line_break_becomes_a_space_and_an_escape_sequence_is_shown() -> None:
    assert str(BadInput("log.bin: format '\n' of \x1b[31mIMU, 3 µs, 0.5°")) == r"log.bin: format ' ' of \x1b[31mIMU, 3 µs, 0.5°"


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


@given(st.floats(-90, 90), st.floats(-180, 180), st.sampled_from((-360, 360)))
def test_a_longitude_that_counts_on_beyond_180_is_the_same_place(lat: float, lon: float, turn: float) -> None:
    assume(abs(lon + turn) <= 360)
    there, on = GeoPoint.of_degrees(lat, lon), GeoPoint.of_degrees(lat, lon + turn)
    assert abs(on.longitude_rad) <= math.pi
    assert np.linalg.norm(ned_between(there, on)) < 1e-5


def test_the_date_line_and_unknown_heights() -> None:
    west, east = GeoPoint.of_degrees(0.0, 179.9995), GeoPoint.of_degrees(0.0, -179.9995)
    assert ned_between(west, east) == pytest.approx([0.0, 111.32, 0.0], abs=0.01)
    high = GeoPoint.of_degrees(0.0, 179.9995, 40.0)
    assert abs(ned_between(west, high)[2]) < 1e-6, "a height that is not known counts as the other's"


@pytest.mark.parametrize(
    ("lat", "lon", "height"), [(91, 0, 0), (0, 361, 0), (math.nan, 0, 0), (0, math.inf, 0), (0, 0, math.nan)]
)
def test_no_such_place(lat: float, lon: float, height: float) -> None:
    with pytest.raises(ValueError, match=r"no such place|no height"):
        GeoPoint.of_degrees(lat, lon, height)
