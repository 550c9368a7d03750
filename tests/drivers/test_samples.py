import math
from typing import Any, TypeVar

import numpy as np
import pytest
from msgspec.structs import replace

from drivers.ardrone import navdata as nd
from drivers.ardrone.options import ArDroneOptions
from drivers.ardrone.samples import AS_REPORTED, NavdataSampler, time_us
from estimator.contracts.geodesy import height_of_pressure_m, pressure_of_height_pa
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, Baro, BodyVelocity, GeoFix, Imu, Range, Sample, VehicleStatus
from estimator.contracts.time import MonoNs, Stamp
from tests.drivers.captures import CAPTURES, needs_captures

STAMP = Stamp(MonoNs(0), MonoNs(0), 0.001, "synced")
DEMO = nd.Demo(nd.ControlState.FLYING.word, 42, 2000.0, -3000.0, 90000.0, 1500, 410.0, -230.0, 0.0)
S = TypeVar("S")


def the(kind: type[S], samples: list[Sample]) -> S:
    (found,) = [s for s in samples if isinstance(s, kind)]
    return found


def of(*options: Any, state: int = 0) -> nd.Navdata:
    return nd.Navdata.of(state, 1, options)


def stamp_of_ms(ms: int) -> Stamp:
    return Stamp(MonoNs(ms * 1_000_000), MonoNs(ms * 1_000_000), 0.001, "synced")


@needs_captures
def test_the_captured_drone_stands_with_its_nose_up() -> None:
    navdata = nd.decode((CAPTURES / "navdata_full_gps.bin").read_bytes())
    assert isinstance(navdata, nd.Navdata)
    samples = NavdataSampler().samples(navdata, STAMP)
    assert [type(s) for s in samples] == [Imu, Attitude, BodyVelocity, Range, Baro, GeoFix, VehicleStatus]
    imu, attitude = the(Imu, samples), the(Attitude, samples)
    np.testing.assert_allclose(imu.f_body, np.array([80.297, -33.3186, -942.528]) * 9.80665e-3, rtol=1e-4)
    np.testing.assert_allclose(imu.w_body, np.radians([-0.112365, 0.0687213, 0.0620099]), rtol=1e-4)
    roll, pitch, yaw = np.degrees(attitude.R_ned_body.rpy_rad)
    assert (roll, pitch, yaw) == pytest.approx((0.550, 2.974, 1.933), abs=1e-3)
    # What the accelerometer says of roll and pitch has the same signs as the attitude: both are forward-right-down.
    assert math.degrees(math.asin(imu.f_body[0] / 9.3)) == pytest.approx(4.866, abs=0.1)
    assert math.degrees(math.asin(-imu.f_body[1] / 9.3)) == pytest.approx(2.024, abs=0.1)
    assert the(Range, samples).range_m == pytest.approx(0.243)
    fix = the(GeoFix, samples)
    assert (fix.whose, fix.sigma_m) == ("vehicle", 2.5)
    assert np.degrees([fix.place.latitude_rad, fix.place.longitude_rad]) == pytest.approx([34.0905, -118.2767], abs=1e-4)
    assert fix.place.height_m == pytest.approx(122.64)
    status = the(VehicleStatus, samples)
    assert (status.flying, status.mode, status.battery_fraction, status.emergency, status.link_ok) == (
        False,
        "landed",
        0.5,
        False,
        False,
    )
    assert time_us(navdata) == 362_979_125


def test_units_and_signs_of_everything_in_flight() -> None:
    navdata = of(
        DEMO,
        nd.PhysMeasures(40.0, 0, (100.0, 200.0, -1000.0), (10.0, -20.0, 30.0)),
        nd.Altitude(altitude_raw_mm=1400),
        nd.PressureRaw(0, 0, 400, 101325),
        state=nd.NavdataState.FLYING,
    )
    samples = NavdataSampler(AS_REPORTED).samples(navdata, STAMP)
    np.testing.assert_allclose(the(Imu, samples).f_body, [0.980665, 1.96133, -9.80665])
    np.testing.assert_allclose(the(Imu, samples).w_body, np.radians([10.0, -20.0, 30.0]))
    np.testing.assert_allclose(the(Attitude, samples).R_ned_body.rpy_rad, np.radians([-3.0, 2.0, 90.0]), atol=1e-9)
    velocity = the(BodyVelocity, samples)
    np.testing.assert_allclose(velocity.v_level, [0.41, -0.23, 0.0])
    assert velocity.cov_level[2, 2] == UNKNOWN_VAR
    assert the(Range, samples).range_m == pytest.approx(1.4)
    assert the(Baro, samples).height_m == pytest.approx(0.0, abs=1e-6)
    status = the(VehicleStatus, samples)
    assert (status.flying, status.mode, status.battery_fraction, status.link_ok) == (True, "flying", 0.42, True)
    assert all(s.stamp is STAMP for s in samples)


def test_velocity_scale_is_corrected_unless_velocities_are_taken_as_reported() -> None:
    plain = the(BodyVelocity, NavdataSampler(AS_REPORTED).samples(of(DEMO), STAMP))
    scaled = the(BodyVelocity, NavdataSampler(ArDroneOptions(velocity_scale=0.8)).samples(of(DEMO), STAMP))
    np.testing.assert_allclose(scaled.v_level[:2], plain.v_level[:2] / 0.8)
    speed = float(np.hypot(*plain.v_level[:2]))
    assert math.sqrt(plain.cov_level[0, 0]) >= 0.2 * speed, "an under-reading of a fifth must lie within a sigma"
    assert scaled.cov_level[0, 0] < plain.cov_level[0, 0]


def test_demo_mode_has_no_imu_and_its_range_is_along_the_body() -> None:
    tilted = replace(DEMO, theta_mdeg=20000.0, phi_mdeg=0.0, altitude_mm=1000)
    samples = NavdataSampler().samples(of(tilted), STAMP)
    assert not [s for s in samples if isinstance(s, Imu)]
    assert the(Range, samples).range_m == pytest.approx(1.0 / math.cos(math.radians(20.0)))


@pytest.mark.parametrize(
    ("navdata", "absent"),
    [
        (of(DEMO, nd.Altitude(altitude_raw_mm=0)), Range),
        (of(DEMO, nd.Altitude(altitude_raw_mm=900), state=nd.NavdataState.ULTRASOUND_DEAF), Range),
        (of(replace(DEMO, altitude_mm=0)), Range),
        (of(replace(DEMO, psi_mdeg=math.nan)), Attitude),
        (of(replace(DEMO, vy_mm_s=math.inf)), BodyVelocity),
        (of(nd.PhysMeasures(0.0, 0, (0.0, math.nan, 0.0), (0.0, 0.0, 0.0))), Imu),
        (of(nd.PressureRaw(0, 0, 0, 0)), Baro),
    ],
)
def test_what_is_not_known_is_left_out(navdata: nd.Navdata, absent: type[Any]) -> None:
    assert not [s for s in NavdataSampler().samples(navdata, STAMP) if isinstance(s, absent)]


def test_faults_reach_the_status() -> None:
    navdata = of(state=nd.NavdataState.EMERGENCY | nd.NavdataState.COM_WATCHDOG)
    status = the(VehicleStatus, NavdataSampler().samples(navdata, STAMP))
    assert (status.emergency, status.link_ok, status.mode, status.battery_fraction) == (True, False, "unknown", None)


def test_repeats_of_slow_sensors_are_left_out() -> None:
    sampler = NavdataSampler(repeat_s=0.1)
    given: dict[type[Any], list[int]] = {Range: [], Baro: [], VehicleStatus: [], Imu: []}
    for k in range(40):  # 200 Hz; ultrasound again every 40 ms, barometer every 10 ms
        navdata = of(
            DEMO,
            nd.PhysMeasures(40.0, 0, (0.0, 0.0, -1000.0), (0.0, 0.0, 0.0)),
            nd.RawMeasures(nb_echo=k // 8),
            nd.Altitude(altitude_raw_mm=900),
            nd.PressureRaw(k // 2, 0, 0, 100000),
            state=nd.NavdataState.FLYING | (nd.NavdataState.COMMAND_ACK if k % 2 else 0),
        )
        for sample in sampler.samples(navdata, stamp_of_ms(5 * k)):
            if type(sample) in given:
                given[type(sample)].append(k)
    assert given[Range] == [0, 8, 16, 24, 32]
    assert given[Baro] == list(range(0, 40, 2))
    assert given[VehicleStatus] == [0, 20]
    assert len(given[Imu]) == 40


@pytest.mark.parametrize("height_m", [-300.0, 0.0, 12.5, 3000.0])
def test_pressure_and_height_are_inverses(height_m: float) -> None:
    assert height_of_pressure_m(pressure_of_height_pa(height_m)) == pytest.approx(height_m, abs=1e-6)
    assert height_of_pressure_m(100129.0) == pytest.approx(100.0, abs=0.5)  # ISO 2533: 1001.29 hPa at 100 m


@pytest.mark.parametrize(
    "wrong",
    [
        {"gps_plugged": 0}, {"data_available": 0}, {"nb_satellites": 4}, {"lat_deg": math.nan}, {"lat_deg": 95.0}, {"hdop": 0.0},
        {"elevation_m": math.inf},
    ],
)  # fmt: skip
def test_a_place_that_the_receiver_does_not_have_is_none(wrong: dict[str, float]) -> None:
    right = {"lat_deg": 54.4, "lon_deg": 10.2, "elevation_m": 5.0, "hdop": 2.0, "data_available": 1, "nb_satellites": 7}

    def fixes(**changed: float) -> list[GeoFix]:
        gps = nd.Gps(**{**right, "gps_plugged": 1, **changed})  # type: ignore[arg-type]
        made = NavdataSampler().samples(of(gps), STAMP)
        return [sample for sample in made if isinstance(sample, GeoFix)]

    assert fixes(**wrong) == []
    assert [fix.sigma_m for fix in fixes()] == [5.0]
