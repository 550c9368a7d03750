"""The AR.Drone without its sockets: it takes AT datagrams and the passing of time, returns navdata, and drives one `World`.

Its flight recorder is a GPS receiver on the drone's USB port, whose readings it sends as navdata option 27.
"""

import math
from collections import Counter
from collections.abc import Callable, Mapping
from functools import cache
from typing import assert_never

import numpy as np
from msgspec import Struct, structs

from drivers.ardrone import control
from drivers.ardrone.navdata import LAYOUTS, Navdata, clock_of_us, encode
from estimator.contracts.motion import G_M_S2
from estimator.contracts.time import MonoNs, after
from sitl.ardrone.config import Configuration, tilting
from sitl.ardrone.state import HOVER, SECOND, DroneState, Generation, RefAction
from sitl.sensors.sensors import GnssErrors
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.world import Stick, World


class DroneClock(Struct, frozen=True):
    """Maps this host's clock to the drone's."""

    boot: MonoNs
    """Instant at which the drone's clock was zero."""
    drift_ppm: float = 0.0
    """Rate by which the drone's clock is fast, microseconds per second."""

    def microseconds(self, at: MonoNs) -> int:
        """Return the time since the drone booted, us."""
        elapsed = at - self.boot
        return (elapsed + round(elapsed * self.drift_ppm * 1e-6)) // 1000

    def milliseconds(self, at: MonoNs) -> int:
        """Return the time as PaVE headers and the vision option carry it: whole milliseconds in 32 bits, which wrap."""
        return self.microseconds(at) // 1000 % 2**32


class FlightRecorder:
    """The receiver of one flight; without one (`vehicle.gnss_hz` is 0) its option is all zero."""

    def __init__(self, world: World) -> None:
        rate_hz = world.scenario.vehicle.gnss_hz
        self._period_s = 1.0 / rate_hz if rate_hz > 0.0 else None
        self._receiver = GnssErrors([world.seed, 0x6E57])
        self._due = world.now
        self.newest: Mapping[str, float] = {"gps_plugged": 0}
        """The fields of its newest reading."""

    def tick(self, world: World) -> None:
        """Read the receiver when its next reading is due."""
        if self._period_s is None or world.now < self._due:
            return
        self._due = after(self._due, self._period_s)
        x, y, z = world.truth().p_body_ned.tolist()
        place = self._receiver.place(np.array(world.corruptions.of("gnss", (x, y, z), world.now)), world.now)
        self.newest = {
            "lat_deg": math.degrees(place.latitude_rad),
            "lon_deg": math.degrees(place.longitude_rad),
            "elevation_m": 0.0 if place.height_m is None else place.height_m,
            "hdop": 0.6,
            "data_available": 1,
            "nb_satellites": 9,
            "gps_plugged": 1,
            "last_frame_timestamp": int(world.now // 1_000_000) & 0xFFFFFFFF,
        }


TESLA_PER_MILLIGAUSS = 1e-7
MILLIGAUSS_PER_COUNT = 3.4
"""Scale of the magnetometer, as a captured datagram relates its counts to its field."""


class SentFrame(Struct, frozen=True):
    """The last frame that was sent, as navdata reports it."""

    number: int = 0
    time_ms: int = 0
    """Time of the drone's clock at mid-exposure."""
    rpy_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    altitude_m: float = 0.0
    bytes_sent: int = 0
    bitrate_kbps: int = 0


TICK_S = 0.005
"""Period of the physics and of full navdata (200 Hz), s."""
_degrees = math.degrees
BATTERY_LOW = 0.2
"""Charge of the battery below which the drone reports it low, 0..1."""
_STEERABLE = (VehiclePhase.TAKING_OFF, VehiclePhase.HOVERING, VehiclePhase.FLYING)


class Drone:
    """One drone in one world.

    Args:
        world: the world in which the drone flies.
        network: the ports that the drone reports in its configuration, by key.
        generation: of the drone.
    """

    def __init__(
        self, world: World, clock: DroneClock, network: dict[str, int] | None = None, generation: Generation = SECOND
    ) -> None:
        self.world = world
        self.generation = generation
        self.counters: Counter[str] = Counter()
        self.state = DroneState(self._configuration(network or {}))
        self.answers: dict[RefAction, Callable[[], bytes]] = {}
        """Answers to send on the control channel, each built when it is sent. Requesting one twice before that sends it once."""
        self.shot = SentFrame()
        """The newest frame taken, whether it was sent or not."""
        self._clock = clock
        self._stick = self._flown = HOVER
        self._readings = world.readings()
        self._altitude_m = 0.0
        self._echo_m: float | None = None
        self._echoes = 0
        self._ticks = 0
        self._sequence = 0
        self._recorder = FlightRecorder(world)

    @property
    def rpy_rad(self) -> tuple[float, float, float]:
        """The drone's own estimate of its attitude, rad."""
        return self._readings.rpy_rad

    @property
    def measured_at(self) -> MonoNs:
        """Return the time that the drone states for its newest readings."""
        return self._readings.at

    @property
    def altitude_m(self) -> float:
        """Height by the last ultrasound echo received, corrected for the tilt, m."""
        return self._altitude_m

    @property
    def in_demo_mode(self) -> bool:
        """True if navdata goes out at the slow rate: before the bootstrap ends, and if configured so."""
        return self.state.bootstrap or self.state.config.flag("general:navdata_demo")

    def enter(self, world: World) -> None:
        """Continue in another world with the same configuration."""
        self.world = world
        self._stick = self._flown = HOVER
        self._readings = world.readings()
        self._altitude_m, self._echo_m = 0.0, None
        self._recorder = FlightRecorder(world)
        self._do(RefAction.APPLY_LIMITS)

    def take(self, data: bytes, now: MonoNs) -> None:
        """Process one datagram of the AT port."""
        for handler in self.state.take(data, now, self.world.phase):
            self._do(handler)

    def tick(self, at: MonoNs) -> None:
        """Advance to the instant `at`, about `TICK_S` after the last tick."""
        for handler in self.state.tick(at, self.world.phase):
            self._do(handler)
        stick = self._within_altitude(self._stick)
        if stick != self._flown and self.world.phase in _STEERABLE:
            self._flown = stick
            self.world.stick(stick)
        self.world.advance(at)
        self._readings = self.world.readings()
        echo_m = self._readings.ultrasound_m
        if echo_m is not None and echo_m != self._echo_m:
            self._echoes += 1
            self._altitude_m = echo_m * math.cos(self.rpy_rad[0]) * math.cos(self.rpy_rad[1])
        self._echo_m = echo_m
        self._ticks += 1
        self._recorder.tick(self.world)

    def navdata(self) -> Navdata:
        """Return the next navdata datagram for the current mode; the bootstrap's is the bare state word."""
        mask = 0 if self.state.bootstrap else self.generation.options
        if self.in_demo_mode:
            mask &= int(self.state.config.number("general:navdata_options"))
        self._sequence += 1
        phase, readings = self.world.phase, self._readings
        values: dict[str, float] = {}
        echo = readings.ultrasound_m
        state = self.state.word(phase, readings.battery_fraction < BATTERY_LOW, echo is None)
        if mask & 1 << 0:
            roll, pitch, yaw = readings.rpy_rad
            vx, vy = readings.v_level_m_s
            values = {
                "ctrl_state": self.state.control_state(phase),
                "battery_percent": round(100 * readings.battery_fraction),
                "theta_mdeg": _degrees(pitch) * 1e3,
                "phi_mdeg": _degrees(roll) * 1e3,
                "psi_mdeg": _degrees(yaw) * 1e3,
                "altitude_mm": 0 if phase is VehiclePhase.LANDED else round(1e3 * self._altitude_m),
                "vx_mm_s": 1e3 * vx,
                "vy_mm_s": 1e3 * vy,
            }
        if mask & 1 << 1:
            values["clock"] = clock_of_us(max(0, self._clock.microseconds(readings.at)))
        if mask & 1 << 2:
            values["nb_echo"], values["sum_echo"] = 0 if echo is None else 1, self._echoes % 2**32
        if mask & 1 << 3:
            x, y, z = readings.f_body
            p, q, r = readings.w_body
            values["ax_mg"], values["ay_mg"], values["az_mg"] = 1e3 * x / G_M_S2, 1e3 * y / G_M_S2, 1e3 * z / G_M_S2
            values["wx_deg_s"], values["wy_deg_s"], values["wz_deg_s"] = _degrees(p), _degrees(q), _degrees(r)
        if mask & 1 << 10:
            values["altitude_raw_mm"] = 0 if echo is None else round(1e3 * echo)
        if mask & 1 << 21:
            values["up"] = values["ut"] = 0
            values["temperature_dc"], values["pressure_pa"] = round(10 * readings.temperature_c), round(readings.pressure_pa)
        if mask & 1 << 27:
            values |= self._recorder.newest
        return Navdata(state, self._sequence, _tags(mask), **values)  # type: ignore[arg-type]

    def datagram(self) -> bytes:
        """Return the next navdata datagram as it is sent."""
        return encode(self.navdata(), self.further_fields())

    def further_fields(self) -> Mapping[str, float]:
        """Return the fields that the service does not read, for `encode`; what nothing here measures stays zero."""
        readings, stick, shot, limits = self._readings, self._flown, self.shot, self.world.limits
        echo = readings.ultrasound_m
        x, y, z = readings.f_body
        roll, pitch, yaw = shot.rpy_rad
        vx, vy = (1e3 * v for v in readings.v_level_m_s)
        tilt = limits.euler_angle_max_rad if stick.progressive else 0.0
        values: dict[str, float] = {
            "vbat_raw_mv": round(10_772 + 1_828 * readings.battery_fraction),
            "flag_echo_ini": 1,
            "alt_temp_raw_mm": 0 if echo is None else round(1e3 * echo),
            "accs_temp_c": readings.temperature_c,
            "theta_a_mdeg": _mdeg(math.atan2(x, math.hypot(y, z))),
            "phi_a_mdeg": _mdeg(math.atan2(-y, -z)),
            "ref_theta": round(_mdeg(stick.pitch * tilt)),
            "ref_phi": round(_mdeg(stick.roll * tilt)),
            "ref_yaw": round(_mdeg(stick.yaw * limits.yaw_rate_max_rad_s)) if stick.progressive else 0,
            "altitude_vision_mm": round(1e3 * self._altitude_m),
            "obs_alt": self._altitude_m,
            "est_vx": vx,
            "est_vy": vy,
            "vision_state": 2,
            "theta_capture_rad": pitch,
            "phi_capture_rad": roll,
            "psi_capture_rad": yaw,
            "altitude_capture_mm": round(1e3 * shot.altitude_m),
            "time_capture_ms": shot.time_ms,
            "body_vx": vx,
            "body_vy": vy,
            "watchdog": self._ticks % 2**31,
            "frame_size": shot.bytes_sent,
            "frame_number": shot.number,
            "out_bitrate": shot.bitrate_kbps,
            "desired_bitrate": shot.bitrate_kbps,
            "offset_pressure_pa": float(readings.pressure_pa),
            "est_z": 1e3 * self._altitude_m,
            "recorder_frame_number": shot.number,
            "gps_state": self._recorder.newest["gps_plugged"],
        }
        for axis, f_m_s2 in zip("xyz", (x, -y, -z), strict=True):
            values[f"raw_a{axis}"] = _clip(2048 + 0.512 * (1e3 * f_m_s2 / G_M_S2), 0, 4095)
        for axis, w_rad_s in zip("xyz", readings.w_body, strict=True):
            values[f"raw_w{axis}"] = _clip(math.degrees(w_rad_s) * 16.4, -(2**15), 2**15 - 1)
        for n, pwm in enumerate(readings.motors_pwm, 1):
            values[f"motor_{n}"], values[f"sat_motor_{n}"] = _clip(pwm, 0, 255), 255
        if readings.magnetometer is not None:
            field_mg = [v / TESLA_PER_MILLIGAUSS for v in readings.magnetometer]
            for axis, mg in zip("xyz", field_mg, strict=True):
                values[f"m{axis}"] = _clip(mg / MILLIGAUSS_PER_COUNT, -(2**15), 2**15 - 1)
                values[f"magneto_raw_{axis}"] = values[f"magneto_rectified_{axis}"] = mg
            for name in ("heading_unwrapped_deg", "heading_gyro_unwrapped_deg", "heading_fusion_unwrapped_deg"):
                values[name] = math.degrees(readings.rpy_rad[2])
            values.update(calibration_ok=1, magneto_state=2, radius=math.hypot(*field_mg))
        return values

    def _do(self, handler: RefAction | Stick) -> None:
        if isinstance(handler, Stick):
            self._stick = handler
            return
        self.counters[handler.value] += 1
        if handler in (RefAction.TAKE_OFF, RefAction.LAND, RefAction.STAY_UP):
            self._stick = self._flown = HOVER
            self.world.stick(HOVER)
        match handler:
            case RefAction.TAKE_OFF:
                self.world.vehicle.take_off()
            case RefAction.LAND:
                self.world.vehicle.land()
            case RefAction.STAY_UP:
                self.world.vehicle.stay_up()
            case RefAction.CUT_MOTORS:
                self.world.vehicle.cut_motors()
            case RefAction.LEAVE_EMERGENCY:
                self.world.vehicle.leave_emergency()
            case RefAction.FLAT_TRIM:
                # The simulated attitude estimate has no trim to set; the counter shows that a trim was requested.
                pass
            case RefAction.APPLY_LIMITS:
                number, limits = self.state.config.number, self.world.limits
                limits.euler_angle_max_rad = number("control:euler_angle_max")
                limits.vz_max_m_s = 1e-3 * number("control:control_vz_max")
                limits.yaw_rate_max_rad_s = number("control:control_yaw")
            case RefAction.SEND_CONFIGURATION:
                self.answers[handler] = lambda: control.render(self.state.config.dump())
            case RefAction.SEND_CUSTOM_IDS:
                self.answers[handler] = self.state.config.custom_ids
            case _:
                assert_never(handler)

    def _configuration(self, network: dict[str, int]) -> Configuration:
        """Return the configuration that this drone has at its start: its own ports and the limits of its world."""
        limits = self.world.limits
        config = Configuration(network, tilting(self.generation.keys, limits.euler_angle_most_rad))
        config.set("control:euler_angle_max", f"{limits.euler_angle_max_rad:.7g}")
        config.set("control:control_vz_max", f"{1e3 * limits.vz_max_m_s:.7g}")
        config.set("control:control_yaw", f"{limits.yaw_rate_max_rad_s:.7g}")
        return config

    def _within_altitude(self, stick: Stick) -> Stick:
        """Limit the stick by control:altitude_max, above which the drone does not climb."""
        if stick.gaz > 0.0 and self._altitude_m >= 1e-3 * self.state.config.number("control:altitude_max"):
            return structs.replace(stick, gaz=0.0)
        return stick


@cache
def _tags(mask: int) -> tuple[int, ...]:
    return tuple(tag for tag in LAYOUTS if mask >> tag & 1)


def _mdeg(angle_rad: float) -> float:
    return math.degrees(angle_rad) * 1e3


def _clip(value: float, low: int, high: int) -> int:
    return min(high, max(low, round(value)))
