"""A stand-in for the ArduCopter program, as a process of its own: its command line, its JSON physics client, its MAVLink.

It follows the published interfaces and none of ArduPilot's code: packets of servo outputs out, lines of JSON in, a plain cascade
in between; GUIDED take-off, velocity setpoints, LAND on LANDING_TARGETs.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import socket
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np

from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.endpoint import parse_endpoint
from drivers.mavlink.links import LinkOptions, ReceivedMessage, open_links
from drivers.mavlink.vehicle import Stack
from estimator.contracts.geometry import Rotation
from sitl.airframe import Airframe
from sitl.autopilots.ardupilot_json import CURVE
from sitl.autopilots.lock_step import LockStepClock
from sitl.testing.fake_autopilot import FakeAutopilot
from tests.sitl.autopilots.pilot import Cascade

HOST = "127.0.0.1"
STEP_S = 0.00125
GUIDED_TIMEOUT_S = 3.0
"""A velocity setpoint older than this makes it stand still, as ArduCopter's GUID_TIMEOUT does."""
NOT_READY_S = 1.0
"""Arming is refused until then, as long as the filter has no place."""


class StandIn(FakeAutopilot):
    """Flies by the state that the physics tells."""

    def __init__(self, clock: LockStepClock, parameters: dict[str, float]) -> None:
        super().__init__(Stack.ARDUPILOT, system=1, mode="stabilize", armed=False, landed_state=1, clock=clock)
        self.parameters = dict(parameters)
        self._cascade = Cascade(Airframe(), CURVE, STEP_S, most_m_s2=1.5)
        self._began_s = self.now_s
        self._wanted, self._wanted_s = np.zeros(3), self.now_s
        self._hold: Any = None
        self._take_off_to: float | None = None
        self._target: Any = None
        self._still_s = 0.0
        self._home: Any = None
        self.said: dict[str, Any] = {}
        self.rpy = lambda t: tuple(self._rotation.rpy_rad) if self.said else (0.0, 0.0, 0.0)  # type: ignore[assignment, return-value]

    @property
    def _rotation(self) -> Rotation:
        return Rotation.from_quat(self.said["quaternion"])

    def _on_command_long(self, m: Message, received: ReceivedMessage) -> None:
        early = self.now_s - self._began_s < NOT_READY_S
        if m.command == mav.MAV_CMD_COMPONENT_ARM_DISARM and (early or self.mode != "guided"):
            self.text(2, "Arm: Need Position Estimate")
            self.send(mav.MAVLink_command_ack_message(m.command, 4, 0, 0, received.system, received.component))
            return
        if m.command == mav.MAV_CMD_NAV_TAKEOFF:
            if self.armed and self.landed_state == 1:
                self.landed_state, self._take_off_to = 2, float(m.param7)
            self.send(mav.MAVLink_command_ack_message(m.command, 0, 0, 0, received.system, received.component))
            return
        super()._on_command_long(m, received)

    def _on_set_position_target_local_ned(self, m: Message, received: ReceivedMessage) -> None:
        if self.mode == "guided" and m.coordinate_frame == 1 and m.type_mask == 0x05C7:
            self._take_off_to, self._wanted, self._wanted_s = None, np.array([m.vx, m.vy, m.vz]), self.now_s

    def _on_landing_target(self, m: Message, received: ReceivedMessage) -> None:
        if m.frame == 12 and m.position_valid == 1 and m.distance > 0:
            self._target = self._rotation @ np.array([m.x, m.y, m.z])

    def _streams(self, t: float) -> list[Message]:
        if not self.said:
            return []
        f, w = (np.array(self.said["imu"][name]) for name in ("accel_body", "gyro"))
        out = [m for m in super()._streams(t) if m.get_type() not in ("RAW_IMU", "DISTANCE_SENSOR")]
        if t >= self._next.get(-1, 0.0):
            self._next[-1] = t + 0.01
            milli = [round(c) for c in (*(f / 9.80665 * 1e3), *(w * 1e3))]
            out.append(mav.MAVLink_raw_imu_message(self.boot_ns // 1000, *milli, 0, 0, 0))
        return out

    def _on_message(self, received: ReceivedMessage) -> None:
        """What is meant for another component, or for all, goes on to the other link, as the program routes it."""
        assert self.links is not None
        m = received.message
        if getattr(m, "target_component", 0) != 1 and m.get_type() != "TIMESYNC":
            wire = self.links.all[1 - received.link]._wire
            if wire is not None:
                wire.send(bytes(m.get_msgbuf()), None)
        super()._on_message(received)

    def fly(self, said: dict[str, Any]) -> tuple[float, float, float, float]:
        """The motors for this state."""
        self.said = said
        p, v = np.array(said["position"]), np.array(said["velocity"])
        self._home = p if self._home is None or not self.armed else self._home
        self.p_ned, self.v_ned = p - self._home, v
        if not self.armed:
            self._hold, self._wanted = None, np.zeros(3)
            return (0.0, 0.0, 0.0, 0.0)
        if self.landed_state == 1:
            return (0.1, 0.1, 0.1, 0.1)
        wanted = self._wanted if self.now_s - self._wanted_s < GUIDED_TIMEOUT_S else np.zeros(3)
        if self._take_off_to is not None:
            wanted = np.array([0.0, 0.0, max(-1.0, -(self._take_off_to + self.p_ned[2]))])
        if self.mode == "land":
            wanted = np.array([0.0, 0.0, 0.4])
            if self._target is not None:
                wanted[:2] = np.clip(1.0 * self._target[:2], -0.4, 0.4)
            down = said.get("rng_1", 1.0) < 0.06 and abs(v[2]) < 0.1
            self._still_s = self._still_s + STEP_S if down else 0.0
            if self._still_s > 0.4:
                self.landed_state, self.armed = 1, False
                self.text(6, "Disarming motors")
        # The place held is led along with the velocity wanted, and never let far away.
        self._hold = p + np.clip((p if self._hold is None else self._hold) + wanted * STEP_S - p, -0.15, 0.15)
        return self._cascade.motors(p, v, self._rotation, np.array(said["imu"]["gyro"]), self._hold, wanted)


async def run(args: argparse.Namespace, parameters: dict[str, float]) -> None:
    """Step by step, until the physics is gone."""
    clock = LockStepClock()
    standin = StandIn(clock, parameters)
    options = []
    for serial in (args.serial0, args.serial1):
        _, host, port = serial.split(":")
        options.append(LinkOptions(parse_endpoint(f"udpout://{host}:{port}")))
    physics = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    physics.setblocking(False)
    physics.connect((HOST, args.sim_port_out))
    loop, motors, frame, t_s = asyncio.get_running_loop(), (0.0, 0.0, 0.0, 0.0), 0, 0.0
    async with open_links(options, clock, (1, 1)) as links, asyncio.TaskGroup() as group:
        standin.links = links
        group.create_task(standin._live())
        group.create_task(standin._read(links))
        while True:
            frame += 1
            pwm = [round(1000 + 1000 * m) for m in motors] + [1500] * 12
            await loop.sock_sendall(physics, struct.pack("<HHI16H", 18458, round(1 / STEP_S), frame, *pwm))
            async with asyncio.timeout(20):
                said = json.loads(await loop.sock_recv(physics, 4096))
            clock.advance(said["timestamp"] - t_s)
            t_s = said["timestamp"]
            motors = standin.fly(said)
            await clock.settle()


def main(argv: list[str]) -> None:
    parser = argparse.ArgumentParser()
    serials = [f"serial{n}" for n in (0, 1, 2, 5, 6, 7, 8)]
    for name in ("model", "sim-address", "home", "defaults", "speedup", "rc-in-port", *serials):
        parser.add_argument(f"--{name}")
    parser.add_argument("--sim-port-out", type=int)
    parser.add_argument("--wipe", action="store_true")
    args = parser.parse_args(argv)
    if args.model != f"JSON:{HOST}":
        sys.exit(f"Vehicle model ({args.model}) not found")
    lines = (line.split() for line in Path(args.defaults).read_text().splitlines())
    asyncio.run(run(args, {name: float(value) for name, value in lines}))


if __name__ == "__main__":
    main(sys.argv[1:])
