"""The simulated flight as its users meet it: time, commands, readings, frames, truth, faults, touchdown.

Readings of the sensors stand against the truth, and against a real AR.Drone's recording.
"""

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from companion.base.mission import State
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.time import MonoNs, after
from sitl.emulators.ardrone.truth_log import TruthLog, read
from sitl.flight.ending import outside_commit
from sitl.scenario.scenario import Scenario, Start, load
from sitl.sea.sea import SEA_STATES, Sea, Waves
from sitl.sensors.sensors import Readings, Sensors
from sitl.sensors.settings import SensorSettings
from sitl.vehicle.vehicle import MOTORS_TURN, Vehicle, VehiclePhase
from sitl.vessel.contact import DeckShape
from sitl.vessel.file import VesselSettings
from sitl.vessel.vessel import Mounted
from sitl.world.stage import airframe
from sitl.world.truth import RenderedFrame, Truth
from sitl.world.world import Physics, Stick, World, decks_of
from tests.fly import near
from tests.make import change, same_bits

CALM = near(start={"height_m": 3.0})


def run_world(world: World, seconds: float) -> None:
    world.advance(after(world.now, seconds))


def phase_of(world: World) -> VehiclePhase:
    return world.phase


def test_starts_where_the_scenario_says() -> None:
    for heading in (0.0, 35.0, -170.0):
        start = Start(height_m=5.0, pad_forward_m=1.5, pad_right_m=2.6, heading_deg=heading)
        ship = VesselSettings(heading_deg=70.0, pad_yaw_deg=20.0)
        world = World(change(CALM, start=start, vessel=ship, sea=Sea()), 1)
        truth = world.truth()
        assert truth.d_body_pad_level == pytest.approx([1.5, 2.6, 5.0], abs=1e-9)
        assert math.degrees(truth.yaw_rad) == pytest.approx(heading, abs=1e-9)
        assert truth.phase == VehiclePhase.HOVERING
        assert truth.touchdown is None
    world = World(change(CALM, start=Start(where="pad", heading_deg=15.0)), 1)
    run_world(world, 1.0)
    truth = world.truth()
    assert truth.phase == VehiclePhase.LANDED
    assert truth.d_body_pad_level == pytest.approx([0.0, 0.0, 0.045], abs=1e-9)
    assert math.degrees(truth.yaw_rad) == pytest.approx(15.0)


def test_truth_keeps_the_conventions() -> None:
    """d_body_pad_level by rotations of the contracts; v_pad_level is its rate in a frame that does not turn."""
    world = World(load("demo"), 2)
    world.stick(Stick(0.3, -0.2, 0.1, 0.5, True))
    run_world(world, 2.0)
    t = world.truth()
    R_level_ned = Rotation.from_rpy(0.0, 0.0, t.R_ned_body.rpy_rad[2]).inv
    assert t.d_body_pad_level == pytest.approx(R_level_ned @ (t.p_pad_ned - t.p_body_ned), abs=1e-12)
    before = t.p_pad_ned - t.p_body_ned
    run_world(world, 0.004)
    later = world.truth()
    rate = R_level_ned @ ((later.p_pad_ned - later.p_body_ned - before) / 0.004)
    assert t.v_pad_level == pytest.approx(rate, abs=0.02)
    yaw = (t.R_ned_pad.inv @ t.R_ned_body).rpy_rad[2]
    assert t.yaw_rad == pytest.approx(yaw, abs=0.01)


def same(a: Readings | Truth | RenderedFrame, b: Readings | Truth | RenderedFrame) -> bool:
    def bits(x: Any) -> Any:
        if isinstance(x, np.ndarray):
            return x.tobytes()
        return x.matrix.tobytes() if isinstance(x, Rotation) else x

    return all(bits(getattr(a, n)) == bits(getattr(b, n)) for n in type(a).__slots__)


def test_same_seed_same_flight_to_the_bit() -> None:
    """However the time is cut into calls, and whatever is asked in between; another seed flies otherwise."""
    scenario = load("demo")
    one, two, other = World(scenario, 5), World(scenario, 5), World(scenario, 6)
    for world in (one, two, other):
        world.stick(Stick(0.1, -0.1, -0.2, 0.3, True))
    for n in range(400):
        one.advance(MonoNs(n * 7_000_000))
        if n % 3 == 0:
            one.readings()
        if n % 100 == 0:
            one.render()
            one.truth()
    end = MonoNs(399 * 7_000_000)
    two.advance(end)
    other.advance(end)
    assert same(one.truth(), two.truth())
    assert same(one.readings(), two.readings())
    assert same(one.render(), two.render())
    assert not same(one.readings(), other.readings())
    assert not same(one.truth(), other.truth())


def test_takes_off_from_a_moving_deck_and_comes_back() -> None:
    world = World(change(load("demo"), start=Start(where="pad")), 1)
    world.vehicle.land()
    assert phase_of(world) == VehiclePhase.LANDED
    world.vehicle.take_off()
    assert phase_of(world) == VehiclePhase.TAKING_OFF
    run_world(world, 6.0)
    assert phase_of(world) == VehiclePhase.HOVERING
    assert world.truth().d_body_pad_level[2] > 0.6
    assert world.truth().touchdown is None
    world.stick(Stick(0.0, 0.0, 0.0, 0.0, True))
    run_world(world, 0.1)
    assert phase_of(world) == VehiclePhase.FLYING
    world.vehicle.land()
    run_world(world, 8.0)
    assert phase_of(world) == VehiclePhase.LANDED
    touch = world.truth().touchdown
    assert touch.surface in ("pad", "deck")


def test_every_contact_of_a_flight_is_kept_with_what_the_vehicle_was_doing(tmp_path: Path) -> None:
    """It strikes the deck in flight, hops off, is landed, and nothing of it is overwritten."""
    world = World(change(CALM, start=Start(height_m=0.6)), 1)
    world.guidance_phase = State.DESCEND.value
    world.stick(Stick(gaz=-0.8, progressive=True))
    run_world(world, 1.5)
    world.stick(Stick(gaz=1.0, progressive=True))
    run_world(world, 1.0)
    world.guidance_phase = State.COMMIT.value
    world.vehicle.land()
    run_world(world, 4.0)
    truth = world.truth()
    strike, landing = truth.contacts
    assert truth.touchdown is landing
    assert (strike.phase, strike.motors, strike.guidance_phase) == (VehiclePhase.FLYING, True, State.DESCEND.value)
    assert (landing.phase, landing.motors, landing.guidance_phase) == (VehiclePhase.LANDING, True, State.COMMIT.value)
    assert strike.at < landing.at
    assert strike.vertical_speed_m_s == pytest.approx(0.8 * 0.7, abs=0.1)
    assert landing.vertical_speed_m_s == pytest.approx(0.4, abs=0.1)
    assert strike.surface == landing.surface == "pad"
    assert outside_commit(truth.contacts) == 1
    with TruthLog(tmp_path / "truth.jsonl") as log:
        log.write(truth)
    (logged,) = read(tmp_path / "truth.jsonl")
    assert same_bits(logged, truth)


def test_velocity_may_be_reported_against_the_water() -> None:
    """The two frames of velocity differ over a deck of 1.5 m/s by the deck's speed times the scale."""
    reported = []
    for over in ("seen", "water"):
        ship = VesselSettings(hull="supply_ship", moored=False, speed_m_s=1.5)
        quiet = SensorSettings(velocity_over=over, tilt_bias_sigma_deg=0.0, tilt_drift_sigma_deg=0.0)
        world = World(change(CALM, vessel=ship, sensors=quiet), 1)
        run_world(world, 0.2)
        reported.append(world.readings().v_level_m_s[0])
    assert reported[1] - reported[0] == pytest.approx(0.83 * 1.5, abs=0.1)


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
    near = change(PERFECT, ultrasound_cone_deg=cone_deg, ultrasound_rate_hz=60.0, ultrasound_max_m=20.0)
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
    quiet = change(PERFECT, accel_bias_sigma_m_s2=0.6, gyro_bias_sigma_rad_s=0.01, heading_bias_sigma_deg=3.0)
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
    v, s = setup(change(PERFECT, ultrasound_sigma_m=0.005, ultrasound_delay_s=0.06))
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


def test_an_empty_battery_ends_a_flight_as_in_reality() -> None:
    """WHY: the simulated vehicle hovered on at 0 % of charge, and nobody saw what a person's hold came to."""
    sensors = replace(CALM.sensors, battery_start=0.01, battery_life_s=100.0)
    world = World(replace(CALM, sensors=sensors), seed=1)
    run_world(world, 0.9)
    assert phase_of(world) in MOTORS_TURN
    before_m = world.truth().p_body_ned[2]
    for _ in range(60):
        run_world(world, 0.01)
    assert (phase_of(world), world.battery) == (VehiclePhase.EMERGENCY, 0.0)
    assert world.truth().p_body_ned[2] - before_m > 0.5, "it falls"
