"""Everything about an AR.Drone link that a person may choose."""

import math
from typing import Annotated, ClassVar, Literal

from msgspec import structs

from drivers.ardrone.at import CTRL_ACK, AtCommand, Config, ConfigIds, Ctrl
from drivers.vehicle import Barred, Claim, VehicleOptions, host_and_port
from estimator.contracts.errors import BadInput
from estimator.contracts.keys import choice, number, text, tuning

CODECS = {"1.0": "32", "2.0": "129"}
"""The video codec that is requested, by the drone's generation: UVLC, and H.264 of 640x360 px."""


class ArDroneOptions(VehicleOptions, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="ardrone"):
    """The vehicle: a Parrot AR.Drone, or the simulated one, with the same protocol.

    Raises:
        ValueError: a number outside its range, or text that cannot be read.
    """

    host: Annotated[str, text("name or address of the drone", 253, "address of every AR.Drone", public=True)] = "192.168.1.1"
    navdata_port: Annotated[int, number("UDP port of navdata", "port", 1, 65535)] = 5554
    video_port: Annotated[int, number("port of the video: TCP of a 2.0, UDP of a 1.0", "port", 1, 65535)] = 5555
    at_port: Annotated[int, number("UDP port of AT commands", "port", 1, 65535)] = 5556
    control_port: Annotated[int, number("TCP port of the configuration", "port", 1, 65535)] = 5559
    model: Annotated[
        Literal["1.0", "2.0"],
        choice("generation of the drone: a 1.0 sends UVLC pictures of 176x144 px, a 2.0 H.264", public=True, page=True),
    ] = "2.0"
    command_period_s: Annotated[
        float, number("interval between commands; the drone counts 50 ms of silence as a miss", "s", 0.01, 0.05, "customary")
    ] = 0.03
    command_timeout_s: ClassVar[float] = 0.12
    """A velocity command older than this is flown as hover (six commands of guidance)."""
    hold_s: Annotated[
        float,
        number(
            "time for which the sender holds the flying drone in hover for a new service after this one died", "s", 0.0, 600.0
        ),
    ] = 60.0
    com_watchdog_s: ClassVar[int] = 2
    """Time for which the drone flies on with its last command before it hovers, and for which it hovers before it lands (firmware
    default)."""
    hold_com_watchdog_s: ClassVar[int] = 60
    """The same while the sender holds the drone without a service (the longest there is)."""
    navdata_silence_s: Annotated[
        float, number("time without navdata after which the stream is requested again", "s", 0.02, 10.0, "Parrot SDK 2.0.1")
    ] = 1.0
    video_silence_s: Annotated[float, number("time without video after which its connection is opened again", "s", 0.2, 30.0)] = (
        2.0
    )
    video_delay_s: Annotated[
        float,
        tuning("least time from mid-exposure to the first byte of the frame", "s", 0.0, 0.5, "assumed until it is calibrated"),
    ] = 0.04
    exposure_s: Annotated[float, tuning("exposure time; 0 if unknown", "s", 0.0, 0.1)] = 0.0
    altitude_max_m: Annotated[
        float, number("height over the take-off point that the drone never exceeds", "m", 1.0, 100.0, public=True)
    ] = 20.0
    euler_angle_max_deg: Annotated[
        float,
        tuning(
            "largest tilt of the drone, commanded by full stick",
            "deg",
            1.0,
            45.0,
            "the firmware's largest is 0.52 rad; 9 m/s of wind take 18 degrees, its gusts 9 more",
            public=True,
        ),
    ] = 29.5
    vz_max_m_s: Annotated[
        float,
        tuning(
            "largest climb and descent rate",
            "m/s",
            0.2,
            2.0,
            "the firmware's largest; a deck of sea state 6 rises as fast",
            public=True,
        ),
    ] = 2.0
    yaw_rate_max_deg_s: Annotated[float, tuning("largest turn rate", "deg/s", 40.0, 350.0, "firmware default", public=True)] = (
        100.0
    )
    velocity_gain_1_s: ClassVar[float] = 1.4
    """Acceleration commanded for each m/s of velocity error (gain margin of the loop 2.0; 1.3 in drones unlike their file)."""
    velocity_integral_1_s2: ClassVar[float] = 0.4
    """Acceleration for each metre of the integrated velocity error, which compensates wind (tuned in simulation)."""
    velocity_lead: ClassVar[float] = 0.7
    """Factor on the missing tilt that is commanded in addition, because the tilt lags behind (below 1, with room for a tilt that
    overshoots: more swings where commands come late)."""
    velocity_scale: Annotated[
        float,
        tuning(
            "the speed that navdata reports over the true one; readings are divided by it",
            "1",
            0.3,
            2.0,
            "a recorded AR.Drone 2.0 flight under motion capture",
        ),
    ] = 0.83
    velocity_drag_1_s: ClassVar[float] = 0.43
    """Deceleration for each m/s of speed through the air (a recorded AR.Drone 2.0 flight under motion capture)."""
    sigma_velocity_m_s: ClassVar[float] = 0.03
    """Standard deviation of a measured velocity at rest."""
    sigma_velocity_fraction: Annotated[
        float, tuning("the same as a fraction of the speed, in addition: the remaining scale error", "1", 0.001, 10.0)
    ] = 0.2 / 3.0
    sigma_tilt_rad: ClassVar[float] = math.radians(0.5)
    """Standard deviation of measured roll and pitch."""
    sigma_yaw_rad: ClassVar[float] = math.radians(3.0)
    """Standard deviation of the measured heading."""
    sigma_range_m: ClassVar[float] = 0.02
    """Standard deviation of the ultrasound at the ground."""
    sigma_range_fraction: ClassVar[float] = 0.02
    """The same as a fraction of the distance, in addition."""
    sigma_baro_m: ClassVar[float] = 0.7
    """Standard deviation of the barometer."""
    sigma_fix_m: ClassVar[float] = 2.5
    """Standard deviation of the flight recorder's place, at a dilution of precision of 1."""
    landing_timeout_s: ClassVar[float] = 0.5
    """Time without renewal by guidance after which a landing is called off, unless it is about to end."""
    velocity_timeout_s: ClassVar[float] = 0.25
    """Age of the newest measured velocity above which a velocity command is flown as hover."""
    take_off_timeout_s: ClassVar[float] = 8.0
    """Time after which a take-off that has not happened is given up."""
    reopen_after_s: Annotated[
        float, number("time without navdata after which its socket and the command socket are opened again", "s", 0.05, 60.0)
    ] = 3.0
    connect_timeout_s: ClassVar[float] = 2.0
    """Time limit for opening a connection."""
    config_timeout_s: Annotated[
        float, number("time limit for the drone to acknowledge one configuration key", "s", 0.05, 60.0)
    ] = 2.0
    restart_first_s: Annotated[float, number("first back-off of a channel that failed", "s", 0.001, 60.0)] = 0.1
    restart_most_s: Annotated[float, number("longest back-off; each is twice the one before", "s", 0.001, 600.0)] = 5.0
    navdata_delay_s: ClassVar[float] = 0.002
    """Least time from a measurement to the arrival of its navdata."""
    navdata_delay_sigma_s: ClassVar[float] = 0.001
    """One standard deviation of it."""
    video_delay_sigma_s: Annotated[float, tuning("standard deviation of video_delay_s", "s", 0.0, 0.5)] = 0.01
    arrival_sigma_s: Annotated[
        float, tuning("standard deviation of times in demo mode, which has no clock", "s", 0.0001, 1.0)
    ] = 0.02
    video_settle_s: Annotated[
        float,
        tuning(
            "frames up to this long after the bottom camera was selected may be of the other one, and are dropped", "s", 0.0, 10.0
        ),
    ] = 0.3
    frames_delay = "video_delay_s"
    has_default_feet = True
    response = "ardrone2"
    barred = (
        Barred("guidance.held_ends", lambda ends: ends == "return", 'must be "hold" or "land": an AR.Drone has no return'),
        Barred(
            "guidance.mission",
            lambda mission: mission == "targets",
            '"targets" needs an autopilot that lands on LANDING_TARGETs, and an AR.Drone has none',
        ),
        Barred("camera.gimbal.device_id", lambda device: device != 0, "must be 0: only an autopilot's link tells of a gimbal"),
    )
    IDS: ClassVar[tuple[str, str, str]] = ("dec1a4de", "dec1a4d1", "dec1a4d0")
    """Session, user and application of the drone's multiple configurations."""
    further_configuration: Annotated[
        str, text("further configuration of the drone, sent last, as section:name=value with commas between", 4096, shortest=0)
    ] = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.configuration()

    @property
    def name(self) -> str:
        return f"AR.Drone at {self.host}"

    @property
    def in_words(self) -> str:
        return (
            f"ardrone {self.model} at {self.host}, navdata {self.navdata_port}/udp, "
            f"video {self.video_port}/{'udp' if self.model == '1.0' else 'tcp'}, "
            f"commands {self.at_port}/udp, configuration {self.control_port}/tcp"
        )

    @property
    def address(self) -> str:
        return f"{self.host}-{self.at_port}"

    @property
    def left_alone(self) -> str:
        alone_s = 2 * self.com_watchdog_s
        return f"the drone hovers, and lands where it is after {alone_s:g} s if nobody else flies it by then"

    @property
    def decoder_for(self) -> str:
        return "" if self.model == "1.0" else f'vehicle.model = "{self.model}"'

    @property
    def probe(self) -> tuple[str, int]:
        return self.host, self.control_port

    @property
    def tilt_max_deg(self) -> float:
        return self.euler_angle_max_deg

    @property
    def climb_max_m_s(self) -> float:
        return self.vz_max_m_s

    def claims(self) -> list[Claim]:
        where = host_and_port(self.host, self.at_port)
        return [Claim(f"ardrone {where}", f"the AR.Drone at {self.host}", "give this one another vehicle.host")]

    @property
    def euler_angle_max_rad(self) -> float:
        """The largest tilt, rad."""
        return math.radians(self.euler_angle_max_deg)

    @property
    def yaw_rate_max_rad_s(self) -> float:
        """The largest turn rate, rad/s."""
        return math.radians(self.yaw_rate_max_deg_s)

    def configuration(self) -> dict[str, str]:
        """Every key that is set on the drone, in order of sending; full navdata first, since it ends the drone's bootstrap."""
        wanted = {"general:navdata_demo": "FALSE"}
        wanted["custom:session_id"], wanted["custom:profile_id"], wanted["custom:application_id"] = self.IDS
        wanted["video:video_codec"] = CODECS[self.model]
        wanted["video:video_channel"] = "1"
        wanted["general:com_watchdog"] = str(self.com_watchdog_s)
        wanted["control:altitude_max"] = str(round(self.altitude_max_m * 1000))
        wanted["control:euler_angle_max"] = f"{self.euler_angle_max_rad:.6f}"
        wanted["control:control_vz_max"] = str(round(self.vz_max_m_s * 1000))
        wanted["control:control_yaw"] = f"{self.yaw_rate_max_rad_s:.6f}"
        for part in self.further_configuration.split(",") if self.further_configuration.strip() else ():
            name, equals, value = (piece.strip() for piece in part.partition("="))
            if not (name and equals and value):
                raise ValueError(f"further_configuration: {part.strip()!r} is not section:name=value")
            if self.model == "1.0" and name == "video:video_codec" and value != CODECS["1.0"]:
                raise ValueError(
                    f"further_configuration: {name}={value} is not decoded (64 is P264): leave it out, or use 32 (UVLC)"
                )
            wanted[name] = value
        return wanted

    @property
    def generation(self) -> str:
        return self.model

    def simulated(self, generation: str, tilt_max_deg: float) -> "ArDroneOptions":
        tilt_deg = max(ArDroneOptions().euler_angle_max_deg, tilt_max_deg)
        return structs.replace(self, model=generation, euler_angle_max_deg=tilt_deg)

    def timeouts(self, seconds: int) -> list[AtCommand]:
        """Commands that set `com_watchdog_s` alone, without waiting for the acknowledge bit: no service may be there to wait."""
        return [Ctrl(CTRL_ACK), ConfigIds(*self.IDS), Config("general:com_watchdog", str(seconds)), Ctrl(CTRL_ACK)]


def ardrone_options(vehicle: VehicleOptions) -> ArDroneOptions:
    """Return the options of an AR.Drone.

    Raises:
        BadInput: the vehicle is of another kind.
    """
    if not isinstance(vehicle, ArDroneOptions):
        raise BadInput('vehicle.kind must be "ardrone" here')
    return vehicle
