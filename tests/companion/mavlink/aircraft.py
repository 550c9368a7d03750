"""The simulated body over the simulated deck behind a MAVLink bridge, flown by velocity setpoints alone, in virtual time.

Messages cross real sockets; the clock stands still until they have arrived and the frames of the instant were looked at, so a
flight is the same on a machine however busy.
"""

import asyncio
from collections.abc import Callable

import numpy as np
from msgspec.structs import replace

from drivers.mavlink.dialect import Message
from drivers.mavlink.links import Links, ReceivedMessage
from drivers.mavlink.vehicle import Stack
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Frame
from estimator.contracts.time import Stamp, after
from sitl.emulators.autopilots.body import Body
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from sitl.scenario.scenario import load
from sitl.vehicle.airframe import Airframe
from tests.companion.mavlink.receivers import Px4Receiver
from tests.sitl.autopilots.pilot import Cascade

STEP_S = 0.005
TICK_S = 0.01


async def wait_until_calm(one: Links, other: Links, also: Callable[[], bool], over: Callable[[], bool]) -> None:
    """Wait, in real time, until what one side sent the other has received, and `also` is so, or all is `over`."""
    calm = 0
    async with asyncio.timeout(60):
        while calm < 3 and not over():
            await asyncio.sleep(0)
            there = all(
                a.all[0].counters.bytes_out == b.all[0].counters.bytes_in and len(b.received) == 0
                for a, b in ((one, other), (other, one))
            )
            calm = calm + 1 if there and also() else 0


class Aircraft(MiniatureAutopilot):
    """A PX4 in miniature with a body, a sea under it and a camera."""

    def __init__(self, clock: Clock, scenario: str, *, height_m: float, forward_m: float, right_m: float, seed: int = 1) -> None:
        super().__init__(Stack.PX4, mode="auto.loiter", clock=clock)
        start = load(scenario)
        start = replace(
            start, start=replace(start.start, height_m=height_m, pad_forward_m=forward_m, pad_right_m=right_m, with_vessel=True)
        )
        self.body = Body(start, seed, STEP_S)
        self._cascade = Cascade(Airframe(), 0.0, STEP_S, most_m_s2=1.0)
        self._hold = self.body.state().p_ned
        self._wanted = self.body.state().v_ned
        self._since = clock.now()
        self.rpy = lambda t: self.body.state().R_ned_body.rpy_rad
        self.images = 0
        self.told_off_m: list[float] = []
        """Horizontal distance from the pad of each place we were told of, when we were told."""

    def _on_landing_target(self, m: Message, received: ReceivedMessage) -> None:
        reported = Px4Receiver().on_message(m)
        if reported is not None and reported[0] == "absolute":
            off = np.array(reported[1])[:2] - self.body.p_pad_ned[:2]
            self.told_off_m.append(float(np.hypot(off[0], off[1])))

    def _on_set_position_target_local_ned(self, m: Message, received: ReceivedMessage) -> None:
        super()._on_set_position_target_local_ned(m, received)
        if self.mode == "offboard":
            self._wanted = np.array([m.vx, m.vy, m.vz])

    def fly(self) -> None:
        """Catch up with the clock."""
        while self.body.t_s + STEP_S <= (self.clock.now() - self._since) * 1e-9:
            s = self.body.state()
            if self.body.landing() is not None and self.landed_state == 2:
                self.landed_state, self.armed = 1, False
            # The place it holds is led along with the velocity requested, and not let far away
            self._hold = s.p_ned + np.clip(self._hold + self._wanted * STEP_S - s.p_ned, -0.2, 0.2)
            motors = self._cascade.motors(s.p_ned, s.v_ned, s.R_ned_body, s.w_body, self._hold, self._wanted)
            self.body.step(motors if self.armed else (0.0, 0.0, 0.0, 0.0))
        state = self.body.state()
        self.p_ned, self.v_ned = state.p_ned, state.v_ned

    def frame(self) -> Frame:
        """Return the frame that the camera sees now."""
        measured_at = after(self._since, self.body.t_s)
        image = self.body.expose()()
        self.images += 1
        return Frame(Stamp(measured_at, self.clock.now(), 0.001, "sim"), self.images, image.px, image.exposure_s)
