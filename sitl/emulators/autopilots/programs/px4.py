"""Start PX4 on the simulated physics, and step with it by its simulator interface, in lock step over TCP.

    PX4_SIM_HOSTNAME=127.0.0.1 px4 -i 0 ...      # with the airframe of "none_iris"; PX4 connects to port 4560

The simulator listens and PX4 connects. Each HIL_SENSOR sets PX4's clock; in lock step PX4 answers it with one
HIL_ACTUATOR_CONTROLS before the next is sent. PX4's ports are fixed: it sends to companions on 14540 and to ground stations on
14550.

Source: PX4 1.16, SimulatorMavlink.cpp, docs "Simulator MAVLink API" and ROMFS/px4fmu_common/init.d-posix (rcS,
px4-rc.simulator, px4-rc.mavlink).
"""

import asyncio
import math
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping
from contextlib import asynccontextmanager
from pathlib import Path

import numpy as np
from msgspec import Struct

from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from estimator.contracts.errors import BadInput, SetupImpossible
from estimator.contracts.geometry import GeoPoint, moved, pressure_of_height_pa
from sitl.emulators.autopilots.body import Body, BodyState, Settle, at_once
from sitl.emulators.autopilots.programs.program import GUIDE, parameters_of
from sitl.sensors.sensors import ORIGIN
from sitl.world.drives import Motors

PHYSICS_PORT = 4560
"""TCP port to which PX4's first instance connects (simulator_mavlink)."""
MAVLINK_PORTS = (14540, 14550)
STEP_S = 0.004
"""Step of the physics, s: PX4's start-up files set IMU_INTEG_RATE to 250 Hz in simulation."""
PARAMETERS = parameters_of("px4.parm")
"""The parameters that differ from PX4's defaults."""
OWN = {"SIH_DISTSNSR_OVR": 10_000.0}
"""The parameters for PX4's own vehicle (SIH): its lidar, which knows nothing of our deck, is off."""
_ALL_SENSORS = 0x1FFF
"""fields_updated of HIL_SENSOR with every field."""
_ARMED = 128
"""MAV_MODE_FLAG_SAFETY_ARMED."""
_GNSS_S = 0.1
"""Interval of HIL_GPS."""
_NUDGE_S = 0.004
"""Interval at which the world moves one step until PX4 sends its first actuator message."""


_FIELD_NED_GAUSS = np.array([0.136, 0.008, 0.497])
"""The magnetic field at the world's origin, Trondheim, by the World Magnetic Model, rounded."""


class SensorNoise(Struct, frozen=True):
    """Standard deviation of each reading: PX4's filter takes a sensor without noise for a stuck one."""

    acc_m_s2: float = 0.02
    gyro_rad_s: float = 0.001
    mag_gauss: float = 0.002
    pressure_hpa: float = 0.01
    gnss_m: float = 0.05


def sensors(state: BodyState, noise: SensorNoise, rng: np.random.Generator) -> Message:
    """Return the HIL_SENSOR message for a state."""
    acc = state.f_body + rng.normal(0.0, noise.acc_m_s2, 3)
    gyro = state.w_body + rng.normal(0.0, noise.gyro_rad_s, 3)
    mag = state.R_ned_body.inv @ _FIELD_NED_GAUSS + rng.normal(0.0, noise.mag_gauss, 3)
    height_m = -float(state.p_ned[2])
    pressure_hpa = pressure_of_height_pa(height_m) / 100.0 + float(rng.normal(0.0, noise.pressure_hpa))
    return mav.MAVLink_hil_sensor_message(
        _us(state), *map(float, acc), *map(float, gyro), *map(float, mag), pressure_hpa, 0.0, height_m, 20.0, _ALL_SENSORS
    )


def gnss(state: BodyState, noise: SensorNoise, rng: np.random.Generator) -> Message:
    """Return the HIL_GPS message for a state."""
    p_ned = state.p_ned + rng.normal(0.0, noise.gnss_m, 3)
    place = moved(ORIGIN, p_ned)
    latitude, longitude = math.degrees(place.latitude_rad), math.degrees(place.longitude_rad)
    vn, ve, vd = (round(100.0 * float(v)) for v in state.v_ned)
    speed, course = round(math.hypot(vn, ve)), math.degrees(math.atan2(ve, vn)) % 360.0
    return mav.MAVLink_hil_gps_message(
        _us(state), 3, round(latitude * 1e7), round(longitude * 1e7), round(-1000.0 * float(p_ned[2])), 30, 40,
        min(speed, 65535), vn, ve, vd, round(100.0 * course) % 36000, 14,
    )  # fmt: skip


def motors_of(message: Message) -> Motors:
    """Return the motors of a HIL_ACTUATOR_CONTROLS. All are at rest while not armed; one whose value is not finite is at rest."""
    if not message.mode & _ARMED:
        return (0.0, 0.0, 0.0, 0.0)
    a, b, c, d = (min(max(float(v), 0.0), 1.0) if math.isfinite(v) else 0.0 for v in message.controls[:4])
    return (a, b, c, d)


def _us(state: BodyState) -> int:
    return round(state.t_s * 1e6)


class HilBackend:
    """One body behind the simulator interface. It does no I/O: it takes messages and returns messages.

    Args:
        stepped: called after each step.
    """

    def __init__(self, body: Body, *, seed: int = 0, stepped: Callable[[Body], None] = lambda body: None) -> None:
        self.body = body
        self._noise = SensorNoise()
        self._rng = np.random.default_rng(seed)
        self._next_gnss_s = 0.0
        self._stepped = stepped

    def begin(self) -> list[Message]:
        """Return the first readings; PX4 sends nothing before it has the time from them."""
        return self._readings()

    def nudge(self) -> list[Message]:
        """Return the readings one step later, with all motors stopped."""
        self.body.step((0.0, 0.0, 0.0, 0.0))
        self._stepped(self.body)
        return self._readings()

    def on_message(self, message: Message) -> list[Message]:
        """Return the readings one step after an actuator message, or nothing for any other message."""
        if message.get_type() != "HIL_ACTUATOR_CONTROLS":
            return []
        self.body.step(motors_of(message))
        self._stepped(self.body)
        return self._readings()

    def _readings(self) -> list[Message]:
        state = self.body.state()
        out = [sensors(state, self._noise, self._rng)]
        if state.t_s >= self._next_gnss_s:
            self._next_gnss_s += _GNSS_S
            out.append(gnss(state, self._noise, self._rng))
        return out


async def _converse(backend: HilBackend, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, settle: Settle) -> None:
    codec = Codec(1, 51)
    first = True
    try:
        for message in backend.begin():
            writer.write(codec.pack(message))
        while True:
            try:
                async with asyncio.timeout(_NUDGE_S if first else None):
                    data = await reader.read(4096)
            except TimeoutError:
                # Before its loops run, PX4 answers nothing but needs time to advance.
                messages = backend.nudge()
                await settle()
                for message in messages:
                    writer.write(codec.pack(message))
                continue
            if not data:
                return
            for received_at in codec.feed(data):
                messages = backend.on_message(received_at)
                if messages:
                    first = False
                    await settle()
                for message in messages:
                    writer.write(codec.pack(message))
            await writer.drain()
    except ConnectionError:
        return
    finally:
        writer.close()


@asynccontextmanager
async def serve_hil(
    backend: HilBackend, host: str = "127.0.0.1", port: int = PHYSICS_PORT, *, settle: Settle = at_once
) -> AsyncIterator[int]:
    """Wait for PX4 on this port (0: any free one), step with it until the context ends, and yield the port.

    Raises:
        SetupImpossible: the port is in use.
    """
    open_writers: set[asyncio.StreamWriter] = set()

    def met(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> Coroutine[None, None, None]:
        open_writers.add(writer)  # before its task begins, which an end of the flight may cancel
        return conversed(reader, writer)

    async def conversed(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            await _converse(backend, reader, writer, settle)
        except asyncio.CancelledError:
            # asyncio's streams write a traceback for a conversation that ends cancelled; this one ends with the flight.
            writer.close()
        finally:
            open_writers.discard(writer)

    try:
        server = await asyncio.start_server(met, host, port)
    except OSError as why:
        raise SetupImpossible(
            f"PX4 looks for its simulator at {host}:{port}, which is taken: another flight or simulator runs there"
        ) from why
    try:
        yield int(server.sockets[0].getsockname()[1])
    finally:
        server.close()
        for writer in tuple(open_writers):
            writer.close()
        await server.wait_closed()


def start(
    binary: Path, *, height_m: float, parameters: Mapping[str, float] | None = None, own: GeoPoint | None = None
) -> tuple[list[str], dict[str, str]]:
    """Return the command line and the variables to add to the environment.

    Args:
        height_m: height to which AUTO.TAKEOFF climbs.
        own: the place at which PX4 simulates a vehicle of its own (SIH); None for ours.

    Raises:
        BadInput: the start-up files are not where PX4's build puts them.
    """
    etc = binary.parent.parent / "etc"
    if not (etc / "init.d-posix" / "rcS").is_file():
        raise BadInput(
            f"--binary: there is no {etc / 'init.d-posix' / 'rcS'}; PX4 needs its build's etc beside bin (see {GUIDE})"
        )
    asked = {**PARAMETERS, **(OWN if own else {}), "MIS_TAKEOFF_ALT": height_m, **(parameters or {})}
    home, model, airframe = own or ORIGIN, "sihsim_quadx" if own else "none_iris", "10040" if own else "10016"
    environment = {
        "PX4_SIM_MODEL": model,
        "PX4_SYS_AUTOSTART": airframe,
        "PX4_SIM_HOSTNAME": "127.0.0.1",
        "PX4_HOME_LAT": f"{math.degrees(home.latitude_rad):.7f}",
        "PX4_HOME_LON": f"{math.degrees(home.longitude_rad):.7f}",
        "PX4_HOME_ALT": "0",
        **{f"PX4_PARAM_{name}": f"{value:g}" for name, value in asked.items()},
    }
    return [str(binary), "-d", "-i", "0", str(etc)], environment
