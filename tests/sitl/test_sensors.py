"""Readings of the sensors against the truth, and against a real AR.Drone's recording."""

import csv
import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.time import MonoNs
from sitl.scenario.scenario import Scenario
from sitl.sea.sea import SEA_STATES, Waves
from sitl.sensors.sensors import Readings, Sensors
from sitl.sensors.settings import SensorSettings
from sitl.vehicle.vehicle import Vehicle
from sitl.vessel.contact import DeckShape, Ground
from sitl.vessel.vessel import Mounted
from sitl.world.stage import airframe
from sitl.world.world import Physics, decks_of

DT = 0.004
SHAPE = DeckShape(3.0, 2.0, 1.4, 1.4)
RECORDED = Path(__file__).parents[2] / "../shared/data/flight_with_mocap"
PERFECT = SensorSettings(
    accel_bias_sigma_m_s2=0.0, accel_noise_sigma_m_s2=0.0, accel_rest_sigma_m_s2=0.0,
    gyro_bias_sigma_rad_s=0.0, gyro_noise_sigma_rad_s=0.0, gyro_rest_sigma_rad_s=0.0,
    tilt_bias_sigma_deg=0.0, tilt_drift_sigma_deg=0.0, heading_bias_sigma_deg=0.0, heading_drift_sigma_deg=0.0,
    velocity_scale=1.0, velocity_noise_sigma_m_s=0.0, ultrasound_sigma_m=0.0, ultrasound_delay_s=0.0,
    pressure_sigma_pa=0.0, pressure_drift_sigma_pa=0.0, magnetometer_sigma_t=0.0, magnetometer_bias_sigma_t=0.0,
)  # fmt: skip


def deck() -> Ground:
    """Return a deck at z = -0.5 m over water at 0."""
    return Ground.of(np.array([0.0, 0.0, -0.5]), np.zeros(3), np.eye(3), np.zeros(3))


ZERO = np.zeros((1, 1, 3))
STILL_DECK = decks_of(Mounted(np.array([[[0.0, 0.0, -0.5]]]), ZERO, ZERO, np.eye(3)[None, None], ZERO))


def setup(settings: SensorSettings, seed: int = 1, p: tuple[float, float, float] = (0.0, 0.0, -3.0)) -> tuple[Vehicle, Sensors]:
    body = airframe(Scenario(title="bench", sensors=settings))
    flight, sense = np.random.SeedSequence(seed).spawn(2)
    v = Vehicle(body, SHAPE, DT, flight)
    v.place(np.array(p), np.zeros(3), 0.0)
    return v, Sensors(settings, v, sense)


def fly_sensing(v: Vehicle, s: Sensors, steps: int) -> list[Readings]:
    physics, out = Physics(v, s, Waves.draw(SEA_STATES[0], 1)), []
    for n in range(steps):
        physics.run(STILL_DECK, 0, 1)
        out.append(s.read(MonoNs(n)))
    return out


def echo(cone_deg: float, p: tuple[float, float, float], roll_deg: float = 0.0) -> float | None:
    """Return the first echo of a perfect sensor at a place over the deck of `deck`."""
    near = msgspec.structs.replace(PERFECT, ultrasound_cone_deg=cone_deg, ultrasound_rate_hz=60.0, ultrasound_max_m=20.0)
    v, s = setup(near, p=p)
    physics = Physics(v, s, Waves.draw(SEA_STATES[0], 1))
    for _ in range(4):
        v.p, v.v, v.w = p, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        v.q = Rotation.from_rpy(math.radians(roll_deg), 0.0, 0.0).quat_wxyz.tolist()
        physics.run(STILL_DECK, 0, 1)
    return s.read(MonoNs(0)).ultrasound_m


def test_perfect_sensors_tell_the_truth() -> None:
    v, s = setup(PERFECT)
    v.command(0.3, -0.4, 0.2, 0.5, True)
    r = fly_sensing(v, s, 300)[-1]
    assert r.f_body == pytest.approx(v.f_body, abs=1e-12)
    assert r.w_body == pytest.approx(v.w_body, abs=1e-12)
    assert r.rpy_rad == pytest.approx(Rotation(v.R_ned_body).rpy_rad, abs=1e-12)
    level = Rotation.from_rpy(0.0, 0.0, Rotation(v.R_ned_body).rpy_rad[2]).matrix.T @ v.v_ned
    assert r.v_level_m_s == pytest.approx(level[:2], abs=0.15)
    assert r.magnetometer is not None
    assert v.R_ned_body @ r.magnetometer == pytest.approx((1.36e-5, 0.9e-6, 5.0e-5), abs=1e-12)
    assert r.pressure_pa == pytest.approx(101325.0 + 12.01 * v.p_ned[2], abs=0.2)
    assert r.motors_pwm[0] == pytest.approx(170, abs=25)


def test_inertial_errors_have_their_size() -> None:
    """Noise within a flight, biases between flights."""
    settings = SensorSettings()
    r = fly_sensing(*setup(settings), 2000)[500:]
    f, w = np.array([x.f_body for x in r]), np.array([x.w_body for x in r])
    assert (np.diff(f, axis=0).std(axis=0) / math.sqrt(2)) == pytest.approx([settings.accel_noise_sigma_m_s2] * 3, rel=0.08)
    assert (np.diff(w, axis=0).std(axis=0) / math.sqrt(2)) == pytest.approx([settings.gyro_noise_sigma_rad_s] * 3, rel=0.08)
    quiet = msgspec.structs.replace(PERFECT, accel_bias_sigma_m_s2=0.6, gyro_bias_sigma_rad_s=0.01, heading_bias_sigma_deg=3.0)
    flights = [fly_sensing(*setup(quiet, seed), 1)[0] for seed in range(150)]
    bias = np.array([x.f_body for x in flights]) - [0.0, 0.0, -9.80665]
    assert bias.std(axis=0) == pytest.approx([0.6] * 3, rel=0.2)
    assert np.array([x.w_body for x in flights]).std(axis=0) == pytest.approx([0.01] * 3, rel=0.2)
    assert np.degrees([x.rpy_rad[2] for x in flights]).std() == pytest.approx(3.0, rel=0.2)


def test_ultrasound_meets_deck_edge_and_water() -> None:
    assert echo(40.0, (0.0, 0.0, -3.0)) == pytest.approx(2.5, abs=0.001)
    assert echo(1.0, (0.0, 2.0, -3.0)) == pytest.approx(3.0, abs=0.001)
    assert echo(40.0, (0.0, 2.0, -3.0)) == pytest.approx(2.5 / math.cos(math.radians(20.0)), abs=0.002)
    assert echo(40.0, (0.0, 8.0, -3.0)) == pytest.approx(3.0, abs=0.001)
    assert echo(40.0, (0.0, 8.0, -30.0)) is None


def test_ultrasound_has_a_rate_a_delay_and_limits() -> None:
    v, s = setup(msgspec.structs.replace(PERFECT, ultrasound_sigma_m=0.005, ultrasound_delay_s=0.06))
    received_at = [x.ultrasound_m for x in fly_sensing(v, s, 500)]
    first = next(n for n, h in enumerate(received_at) if h is not None)
    assert (first + 1) * DT == pytest.approx(0.04 + 0.06, abs=DT)
    values = np.array(received_at[first:], dtype=float)
    changes = np.flatnonzero(np.diff(values))
    assert np.unique(np.diff(changes)).tolist() == [10]
    assert values[::10].std() == pytest.approx(0.005, rel=0.35)
    for height, hears in ((5.9, True), (6.2, False), (0.25, True), (0.15, False)):
        v, s = setup(PERFECT, p=(0.0, 0.0, -0.5 - height))
        assert (fly_sensing(v, s, 20)[-1].ultrasound_m is not None) is hears


@pytest.mark.skipif(not RECORDED.exists(), reason="the recorded flight is not at hand")
def test_noise_in_flight_is_that_of_the_real_drone() -> None:
    """Standard deviation above 4 Hz of a real AR.Drone's accelerometer and gyro in hover, against the settings' defaults."""
    columns = (
        _recorded("navdata.csv", ["t_stamp_s", "ax_g", "ay_g", "az_g"]),
        _recorded("imu.csv", ["t_stamp_s", "wx", "wy", "wz"]),
    )
    settings = SensorSettings()
    for table, scale, sigma in (
        (columns[0], 9.80665, settings.accel_noise_sigma_m_s2),
        (columns[1], 1.0, settings.gyro_noise_sigma_rad_s),
    ):
        hover = table[(table[:, 0] > 14.0) & (table[:, 0] < 33.0), 1:] * scale
        kernel = np.ones(25) / 25.0
        rough = np.stack([c - np.convolve(c, kernel, "same") for c in hover.T])[:, 50:-50]
        assert sigma == pytest.approx(float(np.sqrt((rough**2).mean())), rel=0.3)


def _recorded(name: str, columns: list[str]) -> F64:
    with (RECORDED / name).open() as file:
        return np.array([[float(row[c]) for c in columns] for row in csv.DictReader(file)])
