"""Start ArduCopter or ArduPlane on the simulated physics, and answer by its JSON interface: servo outputs in, state out.

    sim_vehicle.py -v ArduCopter -f JSON:127.0.0.1 --no-rebuild ...      # ArduPilot sends requests, this module answers

ArduPilot sends a binary packet from its own port to 9002 and waits; the answer is one line of JSON. Its clock follows the
timestamps of the answers. A repeated frame number means that an answer was lost, a smaller one that ArduPilot was restarted.

Source: ArduPilot, libraries/SITL/examples/JSON/readme.md, SIM_JSON.cpp, its --help and the documentation of its parameters.
"""

import asyncio
import json
import math
import struct
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from msgspec import Struct

from companion.settings.load import read_text
from decklander.place import SHIPPED
from drivers.mailbox import Latest
from drivers.mavlink.dialect import Message, mav
from estimator.contracts.geometry import wrap_pi
from estimator.contracts.motion import G_M_S2
from sitl.emulators.autopilots.body import Body, BodyState, Settle, at_once
from sitl.emulators.autopilots.follow import OwnBody
from sitl.emulators.autopilots.programs.program import parameters_of
from sitl.scenario.scenario import wind_of
from sitl.sensors.sensors import ORIGIN
from sitl.vehicle.airframe import Airframe
from sitl.world.drives import Motors

PORT = 9002
"""UDP port of the JSON interface. Source: libraries/SITL/examples/JSON/readme.md."""
_MAGIC = {18458: 16, 29569: 32}
"""Number of channels by magic number of a packet."""
_HEADER = struct.Struct("<HHI")
STEP_S = 0.00125
"""Step of the physics, s: half a cycle of ArduCopter's main loop, which misses one cycle in four at a whole cycle. ArduCopter
first requests 1200 Hz and then adopts the rate of the timestamps."""

DEFAULTS, FRAME = "decklander.parm", "frame.json"
PARAMETERS = parameters_of("arducopter.parm")
"""The parameters that differ from ArduCopter's defaults."""
CURVE = PARAMETERS["MOT_THST_EXPO"]
"""The curve of its motors' thrust, which ArduCopter assumes by default."""
_REFERENCE_M_S = 10.0
"""Speed at which both drags are equal (refSpd)."""
OWN: dict[str, float] = {
    **{name: value for name, value in PARAMETERS.items() if not name.startswith("ATC_")},
    # A lidar whose readings come by MAVLink, and a wind that does not grow with height
    "RNGFND1_TYPE": 10,
    "SIM_WIND_T": 1,
}
"""The parameters for a vehicle that ArduCopter simulates by itself."""


_OUTPUTS = ("SERVO", "Q_A_")
_OWN_GAINS = {"Q_A_RAT_RLL_P": 0.15, "Q_A_RAT_PIT_P": 0.15, "Q_A_RAT_RLL_D": 0.002, "Q_A_RAT_PIT_D": 0.002}
"""Gains of ArduPlane's own QuadPlane, which swings by the defaults. Source: Tools/autotest/default_params/quadplane.parm."""
PLANE: dict[str, float] = {
    **{name: value for name, value in PARAMETERS.items() if name.startswith(("COMPASS_", "INS_", "RNGFND1_", "PLND_", "LOG_"))},
    **parameters_of("arduplane.parm"),
}
"""The parameters of a QuadPlane that differ from ArduPlane's defaults."""
PLANE_SCRIPT = "decklander_plane.lua"
"""The script that makes a QuadPlane fly our velocities, in `configs/autopilot`."""


def argv(
    binary: Path,
    folder: Path,
    *,
    plane: bool = False,
    physics: int | OwnBody,
    mavlink_ports: tuple[int, int],
    parameters: Mapping[str, float] | None = None,
    speedup: float = 1.0,
) -> list[str]:
    """Return the command line, and write the file of parameters.

    Args:
        plane: whether it is ArduPlane; `PLANE_SCRIPT` is added to its scripts.
        physics: UDP port on which `serve_json` answers, or the body that the program simulates by itself.
        mavlink_ports: UDP ports on the loopback to which its first two MAVLink ports send.
    """
    defaults = folder / DEFAULTS
    home, model = ORIGIN, ["JSON:127.0.0.1", "--sim-address", "127.0.0.1", "--sim-port-out", str(physics)]
    asked = PLANE if plane else PARAMETERS
    if plane:
        (scripts := folder / "scripts").mkdir(exist_ok=True)
        (scripts / PLANE_SCRIPT).write_text(read_text(SHIPPED / "autopilot" / PLANE_SCRIPT))
    if isinstance(physics, OwnBody) and plane:
        home, model, away = physics.home, ["quadplane"], (*_OUTPUTS, "Q_M_THST_HOVER", "Q_P_ACCZ_FF")
        asked = {name: value for name, value in PLANE.items() if not name.startswith(away)}
        asked |= {"RNGFND1_TYPE": 10, "SIM_WIND_T": 1, **_OWN_GAINS}
    elif isinstance(physics, OwnBody):
        home, model, hover = physics.home, [f"x:{FRAME}"], physics.airframe.mass_kg * G_M_S2 / physics.airframe.thrust_max_n
        asked = {**OWN, "MOT_THST_HOVER": hover, "PSC_ACCZ_FF": hover}
        (folder / FRAME).write_text(json.dumps(frame(physics.airframe)))
    asked = {**asked, **(parameters or {})}
    defaults.write_text("".join(f"{name} {value:g}\n" for name, value in asked.items()))
    place = f"{math.degrees(home.latitude_rad):.7f},{math.degrees(home.longitude_rad):.7f},0,0"
    first, second = (f"udpclient:127.0.0.1:{port}" for port in mavlink_ports)
    others = [word for n in (2, 5, 6, 7, 8) for word in (f"--serial{n}", f"none:{n}")]
    return [
        str(binary), "--model", *model, "--home", place, "--defaults", str(defaults), "--speedup", f"{speedup:g}",
        "--rc-in-port", "0", "--wipe", "--serial0", first, "--serial1", second, *others,
    ]  # fmt: skip


def around(body: OwnBody) -> list[Message]:
    """Return our wind at ArduCopter's own vehicle, and what its lidar measures over our deck."""
    north, east, down = body.air_ned.tolist()
    speed, reach = math.hypot(north, east, down), body.state().range_m
    up_deg, mean_deg = math.degrees(math.atan2(-down, math.hypot(north, east))), wind_of(body.scenario).from_deg
    # ArduCopter turns its wind slowly from one direction to the next, so these must not leap by a whole turn.
    from_deg = mean_deg + math.degrees(wrap_pi(math.atan2(-east, -north) - math.radians(mean_deg)))
    given = {"SIM_WIND_SPD": speed, "SIM_WIND_DIR": from_deg, "SIM_WIND_DIR_Z": up_deg}
    if body.begun:
        given["SIM_SPEEDUP"] = 1.0  # so that it is not far ahead of us
    out = [mav.MAVLink_param_set_message(1, 1, name.encode(), value, mav.MAV_PARAM_TYPE_REAL32) for name, value in given.items()]
    if reach is not None:
        reading = (round(1e3 * body.t_s), 2, 4000, round(100.0 * reach), mav.MAV_DISTANCE_SENSOR_LASER, 0)
        out.append(mav.MAVLink_distance_sensor_message(*reading, mav.MAV_SENSOR_ROTATION_PITCH_270, 0))
    return out


def frame(airframe: Airframe) -> dict[str, object]:
    """Return a vehicle as ArduCopter's own physics describes it, with our drag at `_REFERENCE_M_S`."""
    f, v = airframe, _REFERENCE_M_S
    weight_n, drag = f.mass_kg * G_M_S2, f.drag_per_s[0] * v + f.effects.drag_per_m * v * v
    return {
        "mass": f.mass_kg, "diagonal_size": 2.0 * math.sqrt(2.0) * f.arm_m, "moment_inertia": list(f.inertia_kg_m2),
        "refSpd": v, "refAngle": math.degrees(math.atan(drag / G_M_S2)), "hoverThrOut": weight_n / f.thrust_max_n,
        # The default's current for each newton, and so its air through the rotors
        "refCurrent": 1.0 * weight_n, "disc_area": 4.0 * math.pi * f.rotor_radius_m**2, "propExpo": CURVE,
    }  # fmt: skip


class Servos(Struct, frozen=True):
    """One packet from ArduPilot."""

    rate_hz: int
    frame: int
    pwm_us: tuple[int, ...]

    @property
    def motors(self) -> Motors:
        """Commands 0..1 of the first four motors; 1000 us and less is a stopped motor."""
        a, b, c, d = (min(max((p - 1000) / 1000, 0.0), 1.0) for p in self.pwm_us[:4])
        return (a, b, c, d)


def decode(data: bytes) -> Servos | None:
    """Return the decoded packet, or None if the bytes are not one."""
    if len(data) < _HEADER.size:
        return None
    magic, rate_hz, frame = _HEADER.unpack_from(data)
    channels = _MAGIC.get(magic)
    if channels is None or len(data) != _HEADER.size + 2 * channels or not 50 <= rate_hz <= 10_000:
        return None
    return Servos(rate_hz, frame, struct.unpack_from(f"<{channels}H", data, _HEADER.size))


def encode(state: BodyState) -> bytes:
    """Return the answer for a state: a line of JSON in SI units, ned and body axes."""
    output: dict[str, Any] = {
        "timestamp": state.t_s,
        "imu": {"gyro": _list(state.w_body), "accel_body": _list(state.f_body)},
        "position": _list(state.p_ned),
        "quaternion": _list(state.R_ned_body.quat_wxyz),
        "velocity": _list(state.v_ned),
    }
    if state.range_m is not None:
        output["rng_1"] = state.range_m
    return json.dumps(output, separators=(",", ":")).encode() + b"\n"


def _list(values: Any) -> list[float]:
    return [float(v) for v in values]


class JsonBackend:
    """One body behind the JSON interface. It does no I/O: it takes a packet and returns the answer.

    Args:
        make: makes a body with a physics step of the given length, s; called again when ArduPilot was restarted.
        stepped: called after each step.
        body: the first body, with a physics step of `STEP_S`; None to make it with the first packet.
    """

    def __init__(
        self, make: Callable[[float], Body], stepped: Callable[[Body], None] = lambda body: None, body: Body | None = None
    ) -> None:
        self._make = make
        self._stepped = stepped
        self._frame: int | None = None
        self._answer = b""
        self.body = body
        self.refused = 0
        """Number of datagrams that were not packets."""
        self.restarts = 0

    def on_packet(self, data: bytes) -> bytes | None:
        """Return the answer to a datagram, or None if it needs none."""
        servos = decode(data)
        if servos is None:
            self.refused += 1
            return None
        if self._frame is not None and servos.frame == self._frame:
            return self._answer
        if self.body is None or (self._frame is not None and servos.frame < self._frame):
            self.restarts += self.body is not None
            self.body = self._make(STEP_S)
        self._frame = servos.frame
        for _ in range(max(round(1.0 / servos.rate_hz / self.body.step_s), 1)):
            self.body.step(servos.motors)
            self._stepped(self.body)
        self._answer = encode(self.body.state())
        return self._answer


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self) -> None:
        self.inbox: Latest[tuple[bytes, Any]] = Latest()
        self.answering = b""
        """The packet that is being answered. ArduPilot repeats a packet after one second without an answer."""
        self._transport: Any = None  # the event loops' datagram transports share no class that has sendto

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        if data != self.answering:
            self.inbox.offer((data, addr))

    async def answer(self, backend: JsonBackend, settle: Settle) -> None:
        async for data, addr in self.inbox:
            self.answering = data
            answer = backend.on_packet(data)
            if answer is not None:
                await settle()
                self._transport.sendto(answer, addr)
            self.answering = b""


@asynccontextmanager
async def serve_json(
    backend: JsonBackend, host: str = "127.0.0.1", port: int = PORT, *, settle: Settle = at_once
) -> AsyncIterator[int]:
    """Answer ArduPilot on this port (0: any free one) until the context ends, and yield the port.

    Raises:
        OSError: the port is in use.
    """
    loop = asyncio.get_running_loop()
    transport, protocol = await loop.create_datagram_endpoint(_Datagrams, local_addr=(host, port))
    failed: Exception | None = None
    try:
        async with asyncio.TaskGroup() as group:
            task = group.create_task(protocol.answer(backend, settle))
            try:
                yield int(transport.get_extra_info("sockname")[1])
            except Exception as why:  # the caller's own error must not come out wrapped in a group
                failed = why
            finally:
                task.cancel()
    finally:
        transport.close()
    if failed is not None:
        raise failed
