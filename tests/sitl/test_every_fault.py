"""Every kind of fault begins, and changes something, on every vehicle that carries it."""

import tomllib
from collections.abc import Iterator
from functools import cache
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from drivers.clock import SetClock
from drivers.mavlink.dialect import Message
from drivers.mavlink.requests import RATES_HZ, message_id
from drivers.mavlink.setpoint import velocity_setpoint
from drivers.mavlink.vehicle import VELOCITY_MODE, Stack
from estimator.contracts.commands import Velocity
from estimator.contracts.time import MonoNs, after
from sitl.ardrone.drone import FlightRecorder
from sitl.emulators.autopilots.body import Body
from sitl.emulators.autopilots.lock_step import FaultyLink
from sitl.emulators.autopilots.programs.arducopter import CURVE
from sitl.emulators.autopilots.stand_in.arducopter import CopterStandIn
from sitl.emulators.autopilots.stand_in.base import IN_AIR, STEP_S
from sitl.emulators.autopilots.stand_in.px4 import Px4StandIn
from sitl.emulators.autopilots.telemetry import FaultyTelemetry
from sitl.faults.acts import STREAMS
from sitl.faults.corrupted import SIGNALS, UNSIZED, Corrupted, errors_of
from sitl.faults.fault import Fault
from sitl.faults.faulty_streams import InTransit
from sitl.faults.kinds import KINDS, PictureFault
from sitl.flight.person import SimulatedPerson
from sitl.flight.vessel_reports import VesselReporter
from sitl.perception.model import Scenes
from sitl.scenario.scenario import from_mapping
from sitl.world.world import Stick, World

LATE_S, LOOKS, OF_WIND, LOOK_S = 0.2, 35, 70, 0.02
"""Beginning of a fault, numbers of looks (the ship's wind arrives a second late) and their interval."""
SHIP = "[vessel]\nfile = 'supply_ship'\nspeed_m_s = 2.0\nmoored = false\nreports_hz = 10\nreports_place = true\n"
SHIP += "motion_hz = 10\nturn_hz = 10\nwind_hz = 10\n"
THERE = "title = 'x'\n[start]\nheight_m = 3.0\npad_forward_m = 0.5\n[rtk]\nrate_hz = 10\n[vehicle]\ngnss_hz = 10\n" + SHIP
SCENARIO = from_mapping(tomllib.loads(THERE), "mine.toml")
GIVEN: dict[str, dict[str, Any]] = {
    "accelerometer": {"offset_m_s2": 1.0}, "gyro": {"offset_deg_s": 9.0}, "attitude": {"roll_deg": 5.0},
    "heading": {"offset_deg": 5.0}, "velocity": {"offset_m_s": 1.0}, "ultrasound": {"offset_m": 1.0},
    "barometer": {"offset_pa": 90.0}, "magnetometer": {"offset_ut": 50.0}, "frames_shifted": {"forward_m": 0.2},
    "frames_misstamped": {"by_s": -0.1}, "navdata_misstamped": {"by_s": -0.1}, "other_pad": {"instead": True},
    "gust": {"for_s": 0.5}, "tilt_limited": {"to_deg": 0.5}, "ship_speed": {"to_m_s": 0.0},
    "ship_turn": {"rate_deg_s": 20.0, "over_s": 0.5},
    "vessel_reports": {"north_m_s": 2.0}, "object_on_pad": {"size_m": 1.0}, "low_battery": {"fraction": 0.1},
    **{stream: {"delay_s": 0.05} for stream in STREAMS},
}  # fmt: skip


def of_signal(signal: Any) -> Corrupted:
    error = "biased" if "biased" in errors_of(signal) else errors_of(signal)[-1]
    return Corrupted(signal=signal, error=error, size=0.0 if error in UNSIZED else 0.5, at_s=LATE_S)


FAULTS = {
    **{word: kind(at_s=LATE_S, **GIVEN.get(word, {})) for word, kind in KINDS.items() if kind is not Corrupted},
    **{f"corrupted {signal}": of_signal(signal) for signal in SIGNALS},
}


class Person:
    """Takes orders in the place of the service's arbiter."""

    def __init__(self) -> None:
        self.orders: list[str] = []

    def take(self, order: Any, *others: Any, **more: Any) -> None:
        self.orders.append(order.value)


class ArDrone:
    """The AR.Drone's sensors and sticks."""

    def __init__(self, fault: Fault | None) -> None:
        self.world = World(msgspec.structs.replace(SCENARIO, faults=(fault,) if fault else ()), 3)
        self._recorder, self._sticks = FlightRecorder(self.world), InTransit[Stick](self.world.streams.commands)

    def step(self, to: MonoNs) -> list[Any]:
        """Fly on, and return what the vehicle reports."""
        world = self.world
        self._sticks.send(lambda: Stick(roll=0.6, pitch=0.2, gaz=-0.1 - 1e-9 * to, progressive=True), world.now)
        while (stick := self._sticks.arrived(world.now)) is not None:
            world.stick(stick[1])
        world.advance(to)
        self._recorder.tick(world)
        return [msgspec.structs.astuple(world.readings()), dict(self._recorder.newest)]


class Autopilot:
    """A stand-in in the air, with its wires."""

    def __init__(self, stack: Stack, fault: Fault | None) -> None:
        there, copter = msgspec.structs.replace(SCENARIO, faults=(fault,) if fault else ()), stack is Stack.ARDUPILOT
        self.world = Body(there, 3, STEP_S, CURVE if copter else 0.0)
        self.world.begin()
        self.clock = SetClock(self.world.at)
        self.pilot: Any = CopterStandIn(self.clock, None, STEP_S) if copter else Px4StandIn(self.clock)
        self.world.on_failsafe = self.pilot.acts_by_failsafe
        wires = FaultyTelemetry(self.world.faults, 3, self.clock)
        streams, told = self.world.streams, list[Message]()
        self.link = FaultyLink(streams, self.clock, lambda m: None, lambda m: None, wires.reported, wires.ordered)
        self.told, self.link.to_daemon, self.link.to_program = told, told.append, self._obey
        self.pilot.send = self.link.from_program  # type: ignore[method-assign, assignment]
        self.pilot.step(self.world.state())
        self.pilot.armed, self.pilot.landed_state, self.pilot.mode, self.pilot._lifted = True, IN_AIR, VELOCITY_MODE[stack], True
        self.pilot.intervals = {message_id(name): 1.0 / hz for name, hz in RATES_HZ[stack].items()}

    def _obey(self, message: Message) -> None:
        self.pilot._on_set_position_target_local_ned(message, SimpleNamespace(message=message))

    def step(self, to: MonoNs) -> list[Any]:
        """Fly on, and return what the service receives."""
        self.told.clear()
        way = Velocity(np.array([1.5, 1.5, 0.3 + 1e-10 * to]), 0.0)
        self.link.from_daemon(velocity_setpoint(0, (1, 1), way, 0.0))
        while self.world.at < to:
            self.world.step(self.pilot.step(self.world.state()))
            self.clock.t = self.world.at
            for message in self.pilot._streams(self.pilot.now_s):
                self.pilot.send(message)
            self.link.deliver()
        self.pilot.send(self.pilot.heartbeat())
        return [str(message) for message in self.told]


VEHICLES: dict[str, Any] = {
    "ardrone": ArDrone,
    "arducopter": lambda fault: Autopilot(Stack.ARDUPILOT, fault),
    "px4": lambda fault: Autopilot(Stack.PX4, fault),
}


def shows(vehicle: str, fault: Fault | None, looks: int, *, rendered: bool) -> Iterator[str]:
    """Yield all that a flight shows, look by look, or its last picture alone."""
    flown = VEHICLES[vehicle](fault)
    world, person = flown.world, Person()
    reporter, scenes = VesselReporter(world), Scenes(world.camera, world)
    acts = SimulatedPerson(world.faults, by_remote=person.orders.append)
    for n in range(1, looks + 1):
        reported = flown.step(after(world.started, n * LOOK_S))
        acts.act(person, world.at)  # type: ignore[arg-type]
        frame = None if rendered else world.expose(camera=scenes.expose)()
        scene = next(reversed(scenes._scenes.values()), None)
        truth = world.truth()
        yield "" if rendered else repr([
            reported, list(person.orders), world.reached, world.faults.service_gone, world.battery,
            *(world.corruptions.of("sighting", (1.0, 2.0, 3.0), world.at),),
            [msgspec.structs.astuple(r) if isinstance(r, msgspec.Struct) else r for r in reporter.reports(world.at)],
            [truth.p_body_ned, truth.v_body_ned, truth.p_pad_ned, truth.v_pad_ned],
            frame and [frame.px[0, :8, 0], frame.stamp_error_s, frame.true_view],
            scene and [scene.view, scene.focal, scene.light_stops],
            [(stream.silent, stream.delay_s) for stream in (getattr(world.streams, name) for name in STREAMS)],
        ])  # fmt: skip
    if rendered:
        yield str(world.expose()().px.tobytes())


@cache
def without(vehicle: str, *, rendered: bool) -> list[str]:
    """Return the same of a flight without a fault."""
    return list(shows(vehicle, None, LOOKS if rendered else OF_WIND, rendered=rendered))


@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("word", FAULTS)
def test_every_fault_changes_something_on_every_vehicle_that_carries_it(word: str, vehicle: str) -> None:
    fault = FAULTS[word]
    if not fault.carried_by("ardrone" if vehicle == "ardrone" else "stand-in"):
        assert (word, vehicle == "ardrone") in {("failsafe", True), ("flow_blind", False)}
        return
    rendered = isinstance(fault, PictureFault)
    looks = shows(vehicle, fault, OF_WIND if word.endswith("wind") else LOOKS, rendered=rendered)
    true = without(vehicle, rendered=rendered)
    first = next((n for n, (look, right) in enumerate(zip(looks, true, strict=False), 1) if look != right), None)
    assert first is not None, "it does nothing"
    assert rendered or first * LOOK_S >= LATE_S - 1e-9, "and nothing before it begins"
