"""The physics backends against stand-ins that follow the published interfaces: flown, landed, restarted."""

import json
import math
import struct
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from drivers.mavlink.dialect import mav
from estimator.contracts.errors import SetupImpossible
from estimator.contracts.geodesy import GeoPoint, ned_between
from sitl.emulators.autopilots.arducopter import CURVE, JsonBackend, decode
from sitl.emulators.autopilots.body import Body, wrench
from sitl.emulators.autopilots.px4 import HilBackend, SensorNoise, gnss, motors_of, sensors, serve_hil
from sitl.scenario.scenario import Scenario, load
from sitl.sensors.sensors import ORIGIN
from sitl.vehicle.airframe import Airframe

HOST = "127.0.0.1"
REST = (0.0, 0.0, 0.0, 0.0)


def on_the_pad(name: str = "calm") -> Scenario:
    scenario = load(name)
    return replace(scenario, start=replace(scenario.start, where="pad"))


def servo_packet(frame: int, motors: tuple[float, ...], rate_hz: int = 400, channels: int = 16) -> bytes:
    pwm = [round(1000 + 1000 * m) for m in motors] + [1500] * (channels - 4)
    return struct.pack(f"<HHI{channels}H", 18458 if channels == 16 else 29569, rate_hz, frame, *pwm)


# Motors


def test_each_motor_turns_the_body_the_way_the_autopilots_expect() -> None:
    f = Airframe()
    turns = [wrench(f, [1.0 if n == m else 0.0 for n in range(4)], 0.0)[1] for m in range(4)]
    signs = [tuple(int(math.copysign(1, t)) for t in turn) for turn in turns]
    # roll right, nose up, nose clockwise
    assert signs == [(-1, 1, 1), (1, -1, 1), (1, 1, -1), (-1, -1, -1)], "front right, rear left, front left, rear right"
    thrust, torque = wrench(f, [1.0] * 4, 0.0)
    assert thrust == pytest.approx(f.thrust_max_n)
    assert torque == pytest.approx((0.0, 0.0, 0.0))


def test_a_body_stands_on_a_moving_deck_and_goes_with_it() -> None:
    body = Body(on_the_pad("sea_state_4"), 1, 0.0025)
    for _ in range(2000):
        body.step(REST)
    state = body.state()
    assert np.linalg.norm(state.p_ned - body.p_pad_ned) < 0.1
    assert np.linalg.norm(state.v_ned - body.v_pad_ned) < 0.1
    assert state.range_m is not None
    assert state.range_m < 0.1
    assert np.linalg.norm(state.f_body) == pytest.approx(9.81, abs=1.5)


# ArduPilot


def test_packets_of_both_sizes_and_what_is_none() -> None:
    for channels in (16, 32):
        servos = decode(servo_packet(7, (0.1, 0.2, 0.3, 0.4), channels=channels))
        assert servos is not None
        assert (servos.rate_hz, servos.frame, len(servos.pwm_us)) == (400, 7, channels)
        assert servos.motors == pytest.approx((0.1, 0.2, 0.3, 0.4))
    whole = servo_packet(7, REST)
    for bad in (b"", whole[:-1], whole + b"\0", b"\0" * len(whole), servo_packet(7, REST, rate_hz=0)):
        assert decode(bad) is None


def test_a_lost_answer_is_repeated_and_a_restart_begins_again() -> None:
    backend = JsonBackend(lambda step_s: Body(on_the_pad(), 1, step_s, CURVE))
    first = backend.on_packet(servo_packet(1, REST))
    assert backend.on_packet(servo_packet(1, REST)) == first
    for n in range(2, 50):
        later = backend.on_packet(servo_packet(n, REST))
    assert later is not None
    assert json.loads(later)["timestamp"] == pytest.approx(49 / 400)
    again = backend.on_packet(servo_packet(0, REST))
    assert again is not None
    assert json.loads(again)["timestamp"] == pytest.approx(1 / 400)
    assert backend.restarts == 1
    assert backend.on_packet(b"rubbish") is None
    assert backend.refused == 1


# PX4


def test_sensors_say_what_the_state_is() -> None:
    body = Body(on_the_pad(), 1, 0.004)
    for _ in range(100):
        body.step(REST)
    state = body.state()
    rng = np.random.default_rng(1)
    still = SensorNoise(0.0, 0.0, 0.0, 0.0, 0.0)
    m = sensors(state, still, rng)
    assert m.time_usec == 400_000
    assert m.fields_updated == 0x1FFF
    assert (m.xacc, m.yacc, m.zacc) == pytest.approx(tuple(state.f_body))
    assert math.hypot(m.xmag, m.ymag, m.zmag) == pytest.approx(0.515, abs=0.01)
    assert m.pressure_alt == pytest.approx(-state.p_ned[2])
    assert 990 < m.abs_pressure < 1014
    g = gnss(state, still, rng)
    seen = ned_between(ORIGIN, GeoPoint.of_degrees(1e-7 * g.lat, 1e-7 * g.lon, 1e-3 * g.alt))
    assert seen == pytest.approx(state.p_ned, abs=0.02), "the ship's receiver has the same origin"
    assert g.alt == pytest.approx(-1000 * state.p_ned[2], abs=1)
    assert (g.fix_type, g.satellites_visible) == (3, 14)


def actuators(motors: tuple[float, ...], armed: bool = True) -> Any:
    return mav.MAVLink_hil_actuator_controls_message(0, [*motors, *[math.nan] * 12], 129 if armed else 1, 0)


def test_motors_rest_while_not_armed_or_not_a_number() -> None:
    assert motors_of(actuators((0.1, 0.2, 0.3, 0.4))) == pytest.approx((0.1, 0.2, 0.3, 0.4))
    assert motors_of(actuators((0.1, 0.2, 0.3, 0.4), armed=False)) == REST
    assert motors_of(actuators((math.nan, 2.0, -1.0, 0.4))) == (0.0, 1.0, 0.0, pytest.approx(0.4))


async def test_a_second_flight_beside_px4_s_simulator_is_reported() -> None:
    backend = HilBackend(Body(on_the_pad(), 1, 0.004), seed=1)
    async with serve_hil(backend, HOST, 0) as port:
        with pytest.raises(SetupImpossible, match="another flight or simulator"):
            async with serve_hil(backend, HOST, port):
                pass
