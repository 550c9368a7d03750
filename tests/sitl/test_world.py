"""The simulated flight as its users meet it: time, commands, readings, frames, truth, faults, touchdown."""

import math
from typing import Any

import msgspec
import numpy as np
import pytest

from companion.base.mission import State
from estimator.contracts.geometry import Rotation
from estimator.contracts.time import MonoNs, after
from sitl.emulators.ardrone.truth_log import record
from sitl.flight.ending import outside_commit
from sitl.scenario.scenario import Scenario, Start, load
from sitl.sea.sea import Sea
from sitl.sensors.sensors import Readings
from sitl.sensors.settings import SensorSettings
from sitl.vehicle.vehicle import VehiclePhase
from sitl.vessel.air import WindSettings
from sitl.vessel.file import VesselSettings
from sitl.world.truth import RenderedFrame, Truth
from sitl.world.world import Stick, World

CALM = Scenario(
    title="bench",
    sea=Sea(significant_height_m=0.0),
    vessel=VesselSettings(moored=False),
    wind=WindSettings(speed_m_s=0.0, gust_sigma_m_s=0.0),
    start=Start(height_m=3.0),
)


def with_(scenario: Scenario, **parts: Any) -> Scenario:
    return msgspec.structs.replace(scenario, **parts)


def run_world(world: World, seconds: float) -> None:
    world.advance(after(world.now, seconds))


def phase_of(world: World) -> VehiclePhase:
    return world.phase


def test_starts_where_the_scenario_says() -> None:
    for heading in (0.0, 35.0, -170.0):
        start = Start(height_m=5.0, pad_forward_m=1.5, pad_right_m=2.6, heading_deg=heading)
        ship = VesselSettings(heading_deg=70.0, pad_yaw_deg=20.0)
        world = World(with_(CALM, start=start, vessel=ship, sea=Sea()), 1)
        truth = world.truth()
        assert truth.d_body_pad_level == pytest.approx([1.5, 2.6, 5.0], abs=1e-9)
        assert math.degrees(truth.yaw_rad) == pytest.approx(heading, abs=1e-9)
        assert truth.phase == VehiclePhase.HOVERING
        assert truth.touchdown is None
    world = World(with_(CALM, start=Start(where="pad", heading_deg=15.0)), 1)
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
    world = World(with_(load("demo"), start=Start(where="pad")), 1)
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
    assert touch is not None
    assert touch.surface in ("pad", "deck")


def test_every_contact_of_a_flight_is_kept_with_what_the_vehicle_was_doing() -> None:
    """It strikes the deck in flight, hops off, is landed, and nothing of it is overwritten."""
    world = World(with_(CALM, start=Start(height_m=0.6)), 1)
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
    output = record(truth)
    assert [contact["phase"] for contact in output["contacts"]] == ["flying", "landing"]
    assert output["touchdown"] == output["contacts"][-1]
    assert output["touchdown"]["on_pad"] is True


def test_velocity_may_be_reported_against_the_water() -> None:
    """The two frames of velocity differ over a deck of 1.5 m/s by the deck's speed times the scale."""
    reported = []
    for over in ("seen", "water"):
        ship = VesselSettings(hull="supply_ship", moored=False, speed_m_s=1.5)
        quiet = SensorSettings(velocity_over=over, tilt_bias_sigma_deg=0.0, tilt_drift_sigma_deg=0.0)
        world = World(with_(CALM, vessel=ship, sensors=quiet), 1)
        run_world(world, 0.2)
        reported.append(world.readings().v_level_m_s[0])
    assert reported[1] - reported[0] == pytest.approx(0.83 * 1.5, abs=0.1)
