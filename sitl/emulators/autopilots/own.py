"""Put our deck, air and camera around the vehicle that an autopilot program simulates by itself.

The program reports the true state of its vehicle over MAVLink, and the flight's time advances with these messages: the program is
stopped while frames are made and looked at. Its own ground is the still water below the deck, so a contact is found by the place
of the feet, and the flight ends with it. The ship waits until the vehicle has taken off.
"""

import asyncio
import math
from collections import deque
from collections.abc import Callable
from itertools import chain
from typing import NamedTuple

import numpy as np

from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.requests import message_id
from drivers.mavlink.vehicle import Stack
from estimator.contracts.geometry import F64, GeoPoint, moved, ned_between
from estimator.contracts.time import Clock
from sitl.core.library import SIM
from sitl.emulators.autopilots.body import Body, Motors, Settle
from sitl.emulators.autopilots.program import Program
from sitl.faults.fault import FaultTimer
from sitl.scenario.scenario import Scenario
from sitl.sensors.sensors import ORIGIN
from sitl.vehicle.airframe import Airframe
from sitl.vehicle.vehicle import VehiclePhase

TRUTH = {Stack.ARDUPILOT: "SIM_STATE", Stack.PX4: "HIL_STATE_QUATERNION"}
"""The message in which the simulator of each stack reports the true state."""
STEP_S = 0.005
"""Interval at which the true state is requested."""
_CLOCK = "ATTITUDE_QUATERNION"
"""The message that has the program's time; both stacks send it with the true state, which has none."""
_TURNING: Motors = (0.5, 0.5, 0.5, 0.5)
_PLACE_S = 1.0
"""Time over which the reported places, in steps of a centimetre, correct the integral of the reported velocity."""
_SLICE_S = 0.0002
"""Time for which the program runs before it is looked at again: less than it needs for a step."""
_AROUND_EVERY = 10
"""Steps from one report of the surroundings to the next."""


class TrueState(NamedTuple):
    """The true state that a simulator reports."""

    place_deg_m: tuple[float, float, float]
    """Latitude, longitude and altitude."""
    v_ned: tuple[float, ...]
    quat_wxyz: tuple[float, ...]
    w_body: tuple[float, ...]

    @property
    def place(self) -> GeoPoint:
        """The vehicle's place."""
        return GeoPoint.of_degrees(*self.place_deg_m)


def true_state(m: Message) -> TrueState | None:
    """Return the true state that a message reports; None if it reports none, or one that is not finite."""
    kind = m.get_type()
    if kind == "SIM_STATE":
        lat, lon = (1e-7 * m.lat_int, 1e-7 * m.lon_int) if m.lat_int or m.lon_int else (float(m.lat), float(m.lon))
        q, w = (m.q1, m.q2, m.q3, m.q4), (m.xgyro, m.ygyro, m.zgyro)
        state = TrueState((lat, lon, float(m.alt)), (m.vn, m.ve, m.vd), q, w)
    elif kind == "HIL_STATE_QUATERNION":
        v, w = (1e-2 * m.vx, 1e-2 * m.vy, 1e-2 * m.vz), (m.rollspeed, m.pitchspeed, m.yawspeed)
        state = TrueState((1e-7 * m.lat, 1e-7 * m.lon, 1e-3 * m.alt), v, tuple(m.attitude_quaternion), w)
    else:
        return None
    return state if all(map(math.isfinite, chain(*state))) else None


class OwnBody(Body):
    """A body that another simulator moves. Our physics makes the air around it and finds its contact with our deck."""

    def __init__(self, scenario: Scenario, seed: int, clock: Clock, faults: FaultTimer) -> None:
        super().__init__(scenario, seed, STEP_S, 0.0, clock, faults)
        self.begun = False
        """False while the ship waits for the vehicle to take off."""
        self._p: F64 | None = None
        SIM.fill(self._vehicle.state, tied=0, phase=VehiclePhase.FLYING, airborne_s=1.0)

    @property
    def home(self) -> GeoPoint:
        """The place of the program's vehicle at its start: below the pad, on the still water."""
        north, east, _ = self._ground.p
        return moved(ORIGIN, np.array([north, east, 0.0]))

    @property
    def airframe(self) -> Airframe:
        """The scenario's vehicle as it is flown."""
        return self._vehicle.airframe

    @property
    def height_m(self) -> float:
        return super().height_m if self.begun else -float(self._vehicle.p[2])

    @property
    def v_pad_ned(self) -> F64:
        return super().v_pad_ned if self.begun else np.zeros(3)

    @property
    def air_ned(self) -> F64:
        """Velocity (3,) of the air, m/s."""
        v = self._vehicle
        return np.add(v.air_ned, v.gust)

    def move(self, state: TrueState, *, reported: bool) -> None:
        """Advance by one step to a state, unless a foot has touched the deck.

        Args:
            reported: whether the place is that of this step; else it is reckoned from the place before.
        """
        if self.landing() is not None:
            return
        if self.begun:
            self.step(_TURNING)
        self._truth, v, now_m_s, place = None, self._vehicle, np.array(state.v_ned), ned_between(ORIGIN, state.place)
        if self._p is None:
            self._p, self._v = place, now_m_s
        v.a = ((now_m_s - self._v) / STEP_S).tolist()
        self._p = self._p + 0.5 * STEP_S * (self._v + now_m_s)
        if reported:
            self._p = self._p + STEP_S / _PLACE_S * (place - self._p)
        self._v = now_m_s
        v.p, v.v, v.w, v.q = self._p.tolist(), state.v_ned, state.w_body, state.quat_wxyz


class OwnVehicle:
    """Lets a program that simulates its own vehicle go on, and advances the flight by what it reports.

    Args:
        stepped: called after each step.
        settle: awaited while the program stands still.
        around: returns what the program gets from the surroundings of its vehicle.
    """

    def __init__(
        self, body: OwnBody, stepped: Callable[[Body], None], settle: Settle, around: Callable[[OwnBody], list[Message]]
    ) -> None:
        self._body, self._stepped, self._settle, self._around = body, stepped, settle, around
        self._began, self._first_s, self._now_s = asyncio.Event(), math.nan, math.nan
        self._steps = 0
        self._reported = deque[tuple[int, TrueState]]()
        self._codec, self._sent_s = Codec(0, 0, datagrams=True), 0.0

    def on_message(self, message: Message, stack: Stack) -> list[Message]:
        """Process any message of the program, and return the requests for the true state until it comes."""
        state, kind = true_state(message), message.get_type()
        if kind == _CLOCK:
            self._now_s = 1e-3 * message.time_boot_ms
        elif state is not None and not math.isnan(self._now_s):
            if not self._began.is_set():
                self._began.set()
                self._first_s = self._now_s - STEP_S
            self._reported.append((round((self._now_s - self._first_s) / STEP_S), state))
        elif kind == "HEARTBEAT" and not self._began.is_set():
            interval, each_us = mav.MAV_CMD_SET_MESSAGE_INTERVAL, round(1e6 * STEP_S)
            ids = [message_id(name) for name in (_CLOCK, TRUTH[stack])]
            return [mav.MAVLink_command_long_message(1, 1, interval, 0, n, each_us, 0, 0, 0, 0, 0) for n in ids]
        return []

    def ahead_s(self, data: bytes) -> float:
        """Return the time by which the program was ahead of the flight when it sent a datagram, by the newest stamp so far, s."""
        for m in self._codec.feed(data):
            stamps = (1e-3 * getattr(m, "time_boot_ms", 0), 1e-6 * getattr(m, "time_usec", 0), 1e-9 * getattr(m, "tc1", 0))
            self._sent_s = max(self._sent_s, *stamps)
        ahead_s = self._sent_s - self._first_s - STEP_S * self._steps
        return max(ahead_s, 0.0) if math.isfinite(ahead_s) else 0.0

    async def run(self, program: Program, send: Callable[[Message], object]) -> None:
        """Go on until the flight ends."""
        await self._began.wait()
        program.run_for(0.0)
        while True:
            if not self._reported:
                program.run_for(_SLICE_S)
                await self._settle()
                continue
            due, state = self._reported.popleft()
            while self._steps < due:
                self._steps += 1
                self._body.move(state, reported=self._steps == due)
                self._stepped(self._body)
                if self._steps % _AROUND_EVERY == 0:
                    for message in self._around(self._body):
                        send(message)
                await self._settle()
