"""The core's step against another implementation in plain floats, over random flights.

WHY: vehicle, contacts, air and sensors fly in C; the formulae were written a second time, in Python, and the two must agree.
WHAT: every number of the state after every step of random sticks, decks, winds, faults, starts and landings, to 1e-9.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from companion.settings.load import SHIPPED
from estimator.contracts.geometry import Rotation
from estimator.contracts.time import MonoNs
from sitl.core.library import places_of
from sitl.emulators.autopilots.motors import MotorVehicle, wrench
from sitl.sea.sea import SeaState, Waves
from sitl.sensors.sensors import Sensors
from sitl.sensors.settings import SensorSettings
from sitl.vehicle.airframe import Airframe, Avionics
from sitl.vehicle.disturbances import Wind
from sitl.vehicle.file import load
from sitl.vehicle.rotors import rotors
from sitl.vehicle.vehicle import SEA, Vehicle, VehiclePhase
from sitl.vessel.air import AirModel, GustOnce
from sitl.vessel.contact import DeckShape, Ground
from sitl.vessel.seakeeping import Superstructure
from sitl.vessel.vessel import Mounted
from sitl.world.physics import Physics, decks_of
from tests.sitl.oracle.algebra import rotation_of
from tests.sitl.oracle.sensors import PlainSensors
from tests.sitl.oracle.vehicle import PlainVehicle

DT = 0.004
SHAPES = (DeckShape(3.0, 2.0, 1.4, 1.4), DeckShape(3.0, 2.0, 1.0, 1.5, taper_m=1.0, pad_yaw_rad=0.6))
HEXA = load(SHIPPED / "vehicles/hexa_7kg.toml").airframe()
FRAMES = (
    Airframe(),
    HEXA,
    replace(Airframe(), ground_effect="rotors", avionics=Avionics(flow_sees_deck=False)),
    replace(Airframe(), command_delay_s=0.0, motor_lag_s=0.0),
)
GUSTS = (GustOnce(0.5, 0.4, 0.6, (3.0, -2.0)), GustOnce(0.2, 0.3, 0.1, (1.0, 1.0)))
AIRS = (
    None,
    AirModel(
        7.0, 2.0, logarithmic=True, dryden=True, gusts=(GustOnce(0.5, 0.4, 0.6, (3.0, -2.0)), GustOnce(0.2, 0.3, 0.1, (1.0, 1.0)))
    ),
    AirModel(9.0, math.pi, wake=Superstructure(6.0, 0.5, 4.0, 5.0, 4.0), pad_m=(-2.0, 0.3), pad_yaw_rad=0.4),
)
VECTORS = ("p", "v", "q", "w", "a", "torque_n_m", "flow", "integral", "attached_d", "attached_q", "touched_d", "touched_v")
NUMBERS = (
    "seconds", "thrust_n", "z_hold", "phase", "tied", "ditched", "contact_s", "airborne_s", "touched_what", "touched_s",
    "touched_yaw",
)  # fmt: skip
WHOLE = ("phase", "tied", "ditched", "touched_what")
READ = ("f_body", "w_body", "rpy_rad", "v_level_m_s", "magnetometer", "pressure_pa", "battery_fraction", "motors_pwm")


def moving(rng: np.random.Generator, steps: int) -> Mounted:
    """Return a pad that heaves, rolls, pitches, turns and goes ahead."""
    t = DT * np.arange(1, steps + 1)
    w, phase, size = rng.uniform(0.4, 1.6, 4), rng.uniform(0, 6, 4), rng.uniform(0, 1, 4) * [0.5, 0.2, 0.1, 0.3]
    heave, roll, pitch, yaw = (a * np.sin(f * t + b) for a, f, b in zip(size, w, phase, strict=True))
    v_ne = rng.uniform(-1, 1, 2)
    p = np.stack([v_ne[0] * t, v_ne[1] * t, -1.0 + heave], axis=1)
    v = np.gradient(p, DT, axis=0)
    R = np.array([Rotation.from_rpy(*each).matrix for each in zip(roll, pitch, yaw, strict=True)])
    rates = np.gradient(np.stack([roll, pitch, yaw], axis=1), DT, axis=0)
    return Mounted(p[None], v[None], np.zeros_like(v)[None], R[None], rates[None])


def ground(pads: Mounted, i: int, sea_z: float, sea_vz: float) -> Ground:
    return Ground.of(pads.p_ned[0, i], pads.v_ned[0, i], pads.R_ned[0, i], pads.w[0, i], sea_z, sea_vz)


def packed(v: Vehicle, name: str) -> list[float]:
    """Return a member of the core's state."""
    place = places_of("vehicle")[name]
    return (v.state.words.view(np.int64) if name in WHOLE else v.state.words)[place].tolist()


def begin_as(plain: PlainVehicle, v: Vehicle) -> None:
    """Start the oracle where the vehicle was placed."""
    for name in VECTORS:
        if not name.startswith("touched"):
            setattr(plain, name, tuple(packed(v, name)))
    for name in ("thrust_n", "z_hold", "phase", "airborne_s"):
        setattr(plain, name, packed(v, name)[0])
    plain.tied, plain.limits, plain.current = bool(packed(v, "tied")[0]), v.limits, (v.current[0], v.current[1])


def assert_same(v: Vehicle, plain: PlainVehicle, step: int) -> None:
    ours = [x for name in (*VECTORS, *NUMBERS) for x in packed(v, name)]
    theirs = [x for name in VECTORS for x in getattr(plain, name)] + [float(getattr(plain, name)) for name in NUMBERS]
    ours += [*v.R_ned_body.ravel().tolist(), *v.tilt_error_rad]
    theirs += [*(x for row in rotation_of(plain.q) for x in row), *plain.tilt_error_rad]
    if not all(math.isclose(x, y, rel_tol=1e-9, abs_tol=1e-9) or (x != x and y != y) for x, y in zip(ours, theirs, strict=True)):
        named = [name for name in VECTORS for _ in getattr(plain, name)] + list(NUMBERS)
        differ = [(n, x, y) for n, x, y in zip(named, ours, theirs, strict=False) if not math.isclose(x, y, rel_tol=1e-9)]
        raise AssertionError(f"at step {step}: {differ}")


def disturb(v: Vehicle | PlainVehicle, kind: int, extra: tuple[float, float, float]) -> None:
    """Let a fault begin: of a rotor, of the tilt, of the optical flow, a gust; or end them all."""
    n = len(rotors(v.airframe))
    v.rotor_health = tuple(0.7 if kind == 1 and i == 1 else 1.0 for i in range(n))
    v.tilt_max_rad = 0.05 if kind == 2 else v.airframe.loops.tilt_max_rad
    v.flow_works = kind != 3
    v.extra_wind = extra if kind == 4 else (0.0, 0.0, 0.0)


@given(
    seed=st.integers(0, 2**32 - 1),
    frame=st.sampled_from(FRAMES),
    shape=st.sampled_from(SHAPES),
    air=st.sampled_from(AIRS),
    start=st.sampled_from(["air", "low", "deck", "beside", "tumbling"]),
)
@settings(max_examples=14, derandomize=True, phases=[Phase.generate])
def test_every_number_of_the_state_agrees_step_by_step(
    seed: int, frame: Airframe, shape: DeckShape, air: AirModel | None, start: str
) -> None:
    rng = np.random.default_rng(seed)
    steps, wind = 500, Wind(tuple(rng.uniform(-3, 3, 3)), 0.5)
    v, plain = (kind(frame, shape, DT, np.random.SeedSequence(seed), wind, air) for kind in (Vehicle, PlainVehicle))
    assert isinstance(v, Vehicle)
    assert isinstance(plain, PlainVehicle)
    v.current = tuple(rng.uniform(-1, 1, 2))
    pads = moving(rng, steps)
    aside = {"air": 0.5, "low": 0.3, "beside": 4.0, "tumbling": 0.2}.get(start, 0.0)
    if start == "deck":
        v.stand(ground(pads, 0, 0.0, 0.0), np.array([0.1, 0.2, -frame.feet.below_m]), 0.3)
    else:
        height = {"air": 3.0, "low": 0.2, "beside": 0.6, "tumbling": 1.5}[start]
        v.place(pads.p_ned[0, 0] + [aside, -aside, -height], pads.v_ned[0, 0] + rng.uniform(-0.5, 0.5, 3), rng.uniform(-3, 3))
    if start == "tumbling":
        v.q, v.w = Rotation.from_rpy(*rng.uniform(-2, 2, 3)).quat_wxyz.tolist(), tuple(rng.uniform(-4, 4, 3))
    begin_as(plain, v)
    for i in range(steps):
        if i % 80 == 0:
            roll, pitch = rng.uniform(-1.0, 1.0, 2).tolist()
            plain.sticks = (roll, pitch, float(rng.choice([0.0, -0.5, 1.0])), 0.3, bool(rng.random() < 0.7))
            v.command(*plain.sticks)
            kind, extra = int(rng.integers(0, 6)), tuple(rng.uniform(-4, 4, 3).tolist())
            disturb(v, kind, extra)
            disturb(plain, kind, extra)
        for at, order in ((120, VehiclePhase.LANDING), (420, VehiclePhase.EMERGENCY)):
            if i == at and v.phase not in (VehiclePhase.LANDED, VehiclePhase.EMERGENCY):
                v.phase, plain.phase = order, float(order)
        if i == 40 and v.phase == VehiclePhase.LANDED:
            v.take_off()
            plain.phase = float(VehiclePhase.TAKING_OFF)
        g = ground(pads, i, 0.1 * math.sin(i * DT), 0.1 * math.cos(i * DT))
        v.step(g)
        plain.step(g)
        assert_same(v, plain, i)
    np.testing.assert_allclose(v.unasked_rad_s2, plain._unasked.rad_s2, rtol=1e-9, atol=1e-9)


def test_the_flights_above_touch_deck_and_water_and_rest() -> None:
    """The property means little unless its flights come where the formulae differ."""
    met: set[tuple[str, float]] = set()
    for start, aside in (("deck", 0.0), ("water", 4.0)):
        v = Vehicle(Airframe(), SHAPES[0], DT, np.random.SeedSequence(3), Wind())
        pads = moving(np.random.default_rng(3), 1500)
        v.place(pads.p_ned[0, 0] + [0.0, aside, -0.5], pads.v_ned[0, 0], 0.0)
        v.land()
        for i in range(1500):
            v.step(ground(pads, i, 0.0, 0.0))
        met |= {(start, v.touched_what), (start + " tied", v.tied)}
    assert met == {("deck", 1.0), ("deck tied", 1.0), ("water", float(SEA)), ("water tied", 0.0)}


@pytest.mark.parametrize("frame", [Airframe(), HEXA])
def test_readings_and_water_agree_whatever_the_number_of_steps_of_a_call(frame: Airframe) -> None:
    """One core over calls of random length and one over single steps against the oracle: no noise is lost where a block ends."""
    rng, steps = np.random.default_rng(5), 900
    waves = Waves.draw(SeaState(1.0, 5.0), 4)
    seeds = np.random.SeedSequence(9).spawn(2)
    pads = moving(rng, steps)
    decks = decks_of(pads)
    ours = [Vehicle(frame, SHAPES[0], DT, seeds[0]) for _ in range(2)]
    plain = PlainVehicle(frame, SHAPES[0], DT, seeds[0])
    sensed = [Sensors(SensorSettings(), v, np.random.SeedSequence(4)) for v in ours]
    plain_sensed = PlainSensors(SensorSettings(), SHAPES[0], np.random.SeedSequence(4), DT)
    for v in ours:
        v.place(pads.p_ned[0, 0] + [0.3, 0.2, -1.0], pads.v_ned[0, 0], 0.3)
        v.land()
    begin_as(plain, ours[0])
    by_one, by_many = (Physics(v, s, waves) for v, s in zip(ours, sensed, strict=True))
    z = vz = 0.0
    heard = done = 0
    for i in range(steps):
        if i == 0 or (i + 1) % 5 == 0:
            t = 0.0 if i == 0 and (i + 1) % 5 else (i + 1) * DT
            now, then = waves.elevation(np.array(plain.p[:2]), np.array([t, t + 5 * DT]))[0]
            z, vz = -float(now), -float(then - now) / (5 * DT)
        g = ground(pads, i, z + vz * ((i + 1) % 5) * DT, vz)
        plain.step(g)
        plain_sensed.step(plain, g, plain.phase not in (VehiclePhase.LANDED, VehiclePhase.EMERGENCY))
        assert by_one.run(decks, i, 1) == 1
        assert_same(ours[0], plain, i)
        read = sensed[0].read(MonoNs(i))
        expected = plain_sensed.read(MonoNs(i), plain, plain.phase not in (VehiclePhase.LANDED, VehiclePhase.EMERGENCY))
        for name in (
            "f_body",
            "w_body",
            "rpy_rad",
            "v_level_m_s",
            "magnetometer",
            "pressure_pa",
            "battery_fraction",
            "motors_pwm",
        ):
            np.testing.assert_allclose(getattr(read, name), getattr(expected, name), rtol=1e-9, atol=1e-9, err_msg=f"{name} {i}")
        assert read.ultrasound_m == (None if expected.ultrasound_m is None else pytest.approx(expected.ultrasound_m, rel=1e-9))
        heard += read.ultrasound_m is not None
    while done < steps:
        done += by_many.run(decks, done, min(int(rng.integers(1, 400)), steps - done))
    assert np.array_equal(by_many._vehicle.state.words, by_one._vehicle.state.words, equal_nan=True)
    assert np.array_equal(sensed[1].state.words, sensed[0].state.words, equal_nan=True)
    assert heard > 100
    assert ours[0].touched_what


def test_a_call_ends_with_the_step_of_a_contact() -> None:
    v = Vehicle(Airframe(), SHAPES[0], DT, np.random.SeedSequence(1))
    pads = moving(np.random.default_rng(1), 2000)
    v.place(pads.p_ned[0, 0] + [0.0, 0.0, -0.6], pads.v_ned[0, 0], 0.0)
    v.land()
    physics, decks, done = Physics(v, Sensors(SensorSettings(), v, np.random.SeedSequence(2)), Waves.flat()), decks_of(pads), 0
    while not v.touched_what:
        done += physics.run(decks, done, 2000 - done)
    assert v.touched_s == pytest.approx(done * DT)
    assert v.touched_phase == VehiclePhase.LANDING


def test_motors_drive_the_body_as_their_thrust_and_torque_do() -> None:
    """A body under motor commands against the loops' oracle with its thrust and torque in their place."""

    class Driven(PlainVehicle):
        def _loops(self, *_: object) -> tuple[float, tuple[float, float, float]]:
            return wrench(self.airframe, motors, 0.4)

    v = MotorVehicle(Airframe(), SHAPES[0], DT, np.random.SeedSequence(1), Wind((1.0, 0.0, 0.0), 0.3))
    plain = Driven(Airframe(), SHAPES[0], DT, np.random.SeedSequence(1), Wind((1.0, 0.0, 0.0), 0.3))
    v.curve = 0.4
    pads, rng = moving(np.random.default_rng(1), 400), np.random.default_rng(2)
    v.place(pads.p_ned[0, 0] + [0.0, 0.0, -1.0], pads.v_ned[0, 0], 0.0)
    begin_as(plain, v)
    for i in range(400):
        a, b, c, d = rng.uniform(0.4, 0.7, 4).tolist()
        motors = v.motors = (a, b, c, d)
        if plain.phase != VehiclePhase.EMERGENCY:
            plain.phase, plain.sticks = float(VehiclePhase.FLYING), (0.0, 0.0, 0.0, 0.0, True)
        v.step(ground(pads, i, 0.0, 0.0))
        plain.step(ground(pads, i, 0.0, 0.0))
        assert_same(v, plain, i)


def test_a_delay_beyond_the_core_s_queue_is_refused() -> None:
    with pytest.raises(ValueError, match="more than 1024 steps"):
        Vehicle(replace(Airframe(), command_delay_s=0.5), SHAPES[0], 0.0004, np.random.SeedSequence(1))
    sensors = SensorSettings(ultrasound_rate_hz=60.0, ultrasound_delay_s=0.5)
    v = Vehicle(replace(Airframe(), command_delay_s=0.0), SHAPES[0], 0.0001, np.random.SeedSequence(1))
    Sensors(sensors, v, np.random.SeedSequence(1))
