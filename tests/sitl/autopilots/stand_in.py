"""The stand-in for ArduCopter as a process of its own: its command line, its JSON physics client, its MAVLink.

It follows the published interface of the program: packets of servo outputs out, lines of JSON in.
"""

import argparse
import asyncio
import json
import math
import socket
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np

from drivers.endpoint import parse_endpoint
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import LinkOptions, open_links
from estimator.contracts.geometry import GeoPoint, Rotation, moved
from estimator.contracts.time import MonoNs
from sitl.emulators.autopilots.body import BodyState
from sitl.emulators.autopilots.lock_step import LockStepClock
from sitl.emulators.autopilots.stand_in.arducopter import CopterStandIn
from sitl.vehicle.airframe import ardrone2
from sitl.vehicle.vehicle import Vehicle
from sitl.vessel.contact import DeckShape, Ground
from sitl.world.drives import MotorDrive, Motors

HOST = "127.0.0.1"
STEP_S = 0.004


NOISE = np.random.default_rng(1)
"""Noise of its IMU, as SITL adds it: without one a steady descent repeats its readings to the bit, as a dead sensor does."""


def state_of(said: dict[str, Any]) -> BodyState:
    """Return the state in a line of JSON."""
    imu = said["imu"]
    p, v, w, f = (np.array(x) for x in (said["position"], said["velocity"], imu["gyro"], imu["accel_body"]))
    w, f = w + 0.002 * NOISE.standard_normal(3), f + 0.03 * NOISE.standard_normal(3)
    return BodyState(said["timestamp"], p, v, Rotation.from_quat(said["quaternion"]), w, f, said.get("rng_1"))


class OwnVehicle:
    """The vehicle that the program simulates by itself, on a ground at the height of its home, which reports its truth."""

    def __init__(self, home: str) -> None:
        latitude, longitude, *_ = map(float, home.split(","))
        self._home, self.t_s = GeoPoint.of_degrees(latitude, longitude, 0.0), 0.0
        around = DeckShape(1e3, 1e3, 1e3, 1e3, 0.0)
        self._drive, self._vehicle = MotorDrive(STEP_S), Vehicle(ardrone2(), around, STEP_S, np.random.SeedSequence(1))
        self._ground = Ground.of(np.zeros(3), np.zeros(3), np.eye(3), np.zeros(3))
        self._ground.sea_z = 9.0
        self._vehicle.stand(self._ground, np.array([0.0, 0.0, -self._vehicle.airframe.feet.below_m]), 0.0)

    def step(self, motors: Motors) -> dict[str, Any]:
        """Advance, and return the state as our physics' line of JSON has it."""
        v = self._vehicle
        self._drive.newest = motors
        self._drive.arrive(v, MonoNs(0))
        v.step(self._ground)
        self.t_s += STEP_S
        imu = {"gyro": v.w, "accel_body": v.f_body.tolist()}
        return {"timestamp": self.t_s, "position": v.p, "velocity": v.v, "quaternion": v.q, "imu": imu}

    def truth(self, boot_ms: int) -> list[Message]:
        """Return the time and the true state."""
        v, at = self._vehicle, moved(self._home, self._vehicle.p_ned)
        lat, lon = math.degrees(at.latitude_rad), math.degrees(at.longitude_rad)
        return [
            mav.MAVLink_attitude_quaternion_message(boot_ms, *v.q, *v.w),
            mav.MAVLink_sim_state_message(
                *v.q, 0, 0, 0, 0, 0, 0, *v.w, lat, lon, at.height_m, 0, 0, *v.v, round(1e7 * lat), round(1e7 * lon)
            ),
        ]


async def serve(args: argparse.Namespace, parameters: dict[str, float]) -> None:
    """Step by step, until the physics is gone."""
    clock = LockStepClock()
    standin = CopterStandIn(clock, parameters, STEP_S)
    options = []
    for serial in (args.serial0, args.serial1):
        _, host, port = serial.split(":")
        options.append(LinkOptions(parse_endpoint(f"udpout://{host}:{port}")))
    own = OwnVehicle(args.home) if args.model.startswith("x:") else None
    physics = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    physics.setblocking(False)
    if own is None:
        physics.connect((HOST, args.sim_port_out))
    loop, motors, frame, t_s = asyncio.get_running_loop(), (0.0, 0.0, 0.0, 0.0), 0, 0.0
    async with open_links(options, clock, (1, 1)) as links, asyncio.TaskGroup() as group:
        standin.links = links
        group.create_task(standin._live())
        group.create_task(standin._read(links))
        while True:
            frame += 1
            if own is not None:
                output = own.step(motors)
                if mav.MAVLINK_MSG_ID_SIM_STATE in standin.intervals:
                    for message in own.truth(standin.boot_ns // 1_000_000):
                        links.send(message)
                await clock.settle()
            pwm = [round(1000 + 1000 * m) for m in motors] + [1500] * 12
            if own is None:
                await loop.sock_sendall(physics, struct.pack("<HHI16H", 18458, round(1 / STEP_S), frame, *pwm))
                async with asyncio.timeout(20):
                    output = json.loads(await loop.sock_recv(physics, 4096))
            clock.advance(output["timestamp"] - t_s)
            t_s = output["timestamp"]
            motors = standin.step(state_of(output))
            await clock.settle()


def start(argv: list[str]) -> None:
    parser = argparse.ArgumentParser()
    serials = [f"serial{n}" for n in (0, 1, 2, 5, 6, 7, 8)]
    for name in ("model", "sim-address", "home", "defaults", "speedup", "rc-in-port", *serials):
        parser.add_argument(f"--{name}")
    parser.add_argument("--sim-port-out", type=int)
    parser.add_argument("--wipe", action="store_true")
    args = parser.parse_args(argv)
    if args.model not in ("x:frame.json", f"JSON:{HOST}"):
        sys.exit(f"Vehicle model ({args.model}) not found")
    lines = (line.split() for line in Path(args.defaults).read_text().splitlines())
    asyncio.run(serve(args, {name: float(value) for name, value in lines}))


if __name__ == "__main__":
    start(sys.argv[1:])
