"""The options of MAVLink links and of an autopilot as the vehicle: the table [vehicle] of the settings file with kind "mavlink".

With them stand those of the gimbal that carries the camera: the table [camera.gimbal].
This module imports nothing of the dialect, so that settings can be read without loading it.
"""

import math
import os
from types import MappingProxyType
from typing import Annotated, ClassVar, Literal

from msgspec import structs

from drivers.endpoint import Endpoint, parse_endpoint
from drivers.mavlink.access import Named, parse_operators
from drivers.vehicle import Barred, Claim, VehicleOptions, host_and_port
from estimator.contracts.errors import BadInput
from estimator.contracts.keys import CheckedOptions, choice, number, text, tuning

LINKS = "MAVLink links, with commas between: udpin://ADDRESS:PORT, udpout://HOST:PORT, tcp://HOST:PORT, serial:///dev/NAME:BAUD"
VELOCITY_MODES = ("guided", "offboard")
"""The modes in which ArduPilot and PX4 follow setpoints."""
PX4_HOLD = "auto.loiter"
"""The mode in which PX4 holds by itself."""
SIMULATED_LINK = "udpin://127.0.0.1:14540"
"""The link to an autopilot in settings of a simulation in virtual time, and in its recording; nothing is bound there."""
TARGET_MODES = ("land", "auto.precland")
"""The modes in which ArduPilot and PX4 land on LANDING_TARGETs by themselves."""


class LinkLimits(CheckedOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The limits of each link.

    Raises:
        ValueError: a number is outside its range, or the back-offs contradict one another.
    """

    peers_max: Annotated[
        int, number("most peers of a listening socket; the one that was silent for longest is dropped first", "1", 1, 1000)
    ] = 16
    peer_timeout_s: ClassVar[float] = 30.0
    """Time of silence after which nothing more is sent to a peer of a listening socket."""
    restart_first_s: Annotated[float, number("first back-off before a broken link is opened again", "s", 0.01, 60.0)] = 0.2
    restart_most_s: Annotated[float, number("longest back-off; each is twice the one before", "s", 0.01, 600.0)] = 5.0

    ORDER = ("restart_first_s <= restart_most_s",)


class MavlinkOptions(LinkLimits, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Links, the systems that may command over them, and signing.

    Raises:
        ValueError: links or operators cannot be parsed; and as for `LinkLimits`.
    """

    links: Annotated[str, text(f"{LINKS}; empty for none", 4096, shortest=0, public=True)] = ""
    operators: Annotated[
        str,
        text(
            "systems that may command without signing, beside those on the autopilot's own link: SYSTEM or SYSTEM/COMPONENT, "
            "with commas between",
            256,
            shortest=0,
            public=True,
        ),
    ] = ""
    signing_key_file: Annotated[
        str, text('key that messages are signed with: a path or "credential:NAME"; empty for none', 4096, shortest=0, public=True)
    ] = ""
    signing_time_file: Annotated[
        str,
        text(
            "file that keeps the times of signed messages over restarts; empty for $STATE_DIRECTORY/mavlink-signing-time, or "
            "memory alone without that",
            4096,
            shortest=0,
            public=True,
        ),
    ] = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            self.endpoints()
        except BadInput as why:
            raise ValueError(f"links: {why}") from why
        try:
            self.named_operators()
        except BadInput as why:
            raise ValueError(f"operators: {why}") from why

    def endpoints(self) -> tuple[Endpoint, ...]:
        """Return the addresses of the links, in the order given."""
        return tuple(parse_endpoint(url) for url in self.links.split(",")) if self.links.strip() else ()

    def named_operators(self) -> tuple[Named, ...]:
        """Return the systems that may command without signing."""
        return parse_operators(self.operators)

    @property
    def unsigned(self) -> str | None:
        """A warning about links that are not signed, with the fix; None if all are signed or there are none."""
        if self.signing_key_file or not self.links.strip():
            return None
        return "not signed: decklander keys make FILE; decklander keys install --link URL FILE; then signing_key_file = FILE"


_SYSTEMS = range(1, 256)


class AutopilotOptions(MavlinkOptions, VehicleOptions, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="mavlink"):
    """A vehicle with an ArduPilot or PX4 autopilot (docs/mavlink.md), and a camera on the computer beside it.

    Raises:
        ValueError: there is no link, or the ship's id is the autopilot's; and as for `MavlinkOptions`.
    """

    links: Annotated[str, text(LINKS, 4096, public=True)]
    system_id: Annotated[int, number("system id of the autopilot; 0 takes the first that flies", "id", 0, 255, public=True)] = 0
    component_id: Annotated[
        int, number("our own component id; our system id is the autopilot's", "id", 1, 255, "MAVLink", public=True)
    ] = 191
    vessel_id: Annotated[
        int, number("system id under which the ship reports its own position; 0 for none", "id", 0, 255, public=True)
    ] = 0
    silence_s: Annotated[
        float,
        number(
            "time without messages after which the autopilot is lost; all streams are requested when it is back", "s", 0.2, 60.0
        ),
    ] = 3.0
    command_period_s: Annotated[
        float, number("interval between velocity setpoints", "s", 0.01, 0.2, "PX4 wants more than 2 Hz")
    ] = 0.04
    command_timeout_s: ClassVar[float] = 0.25
    """Age above which a commanded velocity is replaced by a hold (twelve commands of guidance)."""
    attitude_timeout_s: ClassVar[float] = 0.5
    """Age of the newest heading above which the vehicle only holds or climbs."""
    prestream_s: ClassVar[float] = 2.0
    """Time for which setpoints stream before OFFBOARD is requested from PX4 (PX4 refuses before 1.5 s)."""
    request_period_s: ClassVar[float] = 1.0
    """Time after which a mode, arming or take-off that did not happen is requested again."""
    request_tries: ClassVar[int] = 5  # Number of requests after which it is given up
    landing: Annotated[
        Literal["by stack", "mode", "velocity"],
        choice(
            "the descent of `fly land` and the mission thesis: by the autopilot's own mode, by velocities, or by stack: mode for "
            "ArduPilot, velocity for PX4, whose own modes lose a moving deck",
            public=True,
        ),
    ] = "by stack"
    descent_rate_m_s: Annotated[float, tuning("descent rate of a landing by velocity", "m/s", 0.05, 2.0, public=True)] = 0.4
    landing_timeout_s: ClassVar[float] = 0.5
    """Time without renewal by guidance after which a landing is called off."""
    landing_most_s: ClassVar[float] = 15.0
    """Longest time of a landing by velocity; the autopilot continues one that a person ordered."""
    landing_depth_m: ClassVar[float] = 3.0
    """Largest descent of a landing by velocity, after which there is no deck; one that a person ordered has no bound."""
    disarm_on_contact: Annotated[
        bool,
        choice(
            "whether the motors are stopped by force once guidance has felt the deck, or only when the autopilot's own land "
            "detector agrees",
            public=True,
        ),
    ] = True
    mode_is_order: Annotated[
        bool,
        choice(
            "whether the velocity mode (GUIDED, OFFBOARD), chosen by a person or a station that took the vehicle, is an order to "
            "go on; otherwise only begin is"
        ),
    ] = False
    deck_hold_s: ClassVar[float] = 3.0
    """Time after the last velocity for which a hold moves with the deck; later it holds over the ground."""
    hold_mode_after_s: ClassVar[float] = 6.0
    """Time without guidance after which the autopilot is put into its own hold mode."""
    stands_after_s: ClassVar[float] = 1.0
    """Time without guidance after which the motors of an autopilot are stopped that says it stands: a tenth of DISARM_DELAY."""
    take_off_height_m: Annotated[float, tuning("height of a take-off on command", "m", 0.5, 50.0, public=True)] = 3.0
    take_off_timeout_s: ClassVar[float] = 15.0
    """Time after which a take-off that has not happened is given up."""

    over_ground = True
    returns = True
    takes_targets = True
    orders_recordings = True
    response = "autopilot"
    # A ship expects the nose on the arrow, and an autopilot's readings err otherwise than an AR.Drone's: its bias walks, and a
    # velocity by GNSS has no scale (docs/decisions/filter-tilt.md).
    defaults = MappingProxyType(
        {
            ("guidance", "tries"): {"heading": "align"},
            ("estimator", "ekf"): {
                "sigma_attitude_bias_rad": math.radians(0.5),
                "asd_accel_bias_m_s3": 0.02,
                "sigma_velocity_scale": 0.02,
            },
        }
    )
    barred = (
        Barred(
            "guidance.start",
            lambda start: start == "automatic",
            'must be "signal": an autopilot that was lifted off by hand is left to its pilot',
        ),
    )
    ship_keys = ("vessel_id",)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.endpoints():
            raise ValueError("links: there must be one")
        if self.vessel_id and self.vessel_id == self.system_id:
            raise ValueError(f"vessel_id must not be the autopilot's own system_id, found {self.vessel_id}")

    @property
    def name(self) -> str:
        return f"autopilot on {self.links}"

    @property
    def in_words(self) -> str:
        who = f", and from system {self.operators}" if self.operators else ""
        whom = f"system {self.system_id}" if self.system_id else "the first autopilot found"
        return (
            f"autopilot over {self.links} ({self.unsigned or 'signed'}), {whom}; "
            f"we are component {self.component_id}; we take commands from the autopilot's own link{who}"
        )

    @property
    def address(self) -> str:
        return f"mavlink-{self.component_id}-{self.system_id}"

    @property
    def left_alone(self) -> str:
        return "the autopilot has the vehicle"

    def simulated(self, generation: str, tilt_max_deg: float) -> "AutopilotOptions":
        return structs.replace(self, links=SIMULATED_LINK, system_id=0, vessel_id=0, signing_key_file="")

    def modes_left(self, mode: str) -> tuple[str, ...]:
        """Return the mode, and PX4's hold beside OFFBOARD, which it leaves where setpoints end."""
        return (mode, PX4_HOLD) if mode == VELOCITY_MODES[1] else (mode,)

    def claims(self) -> list[Claim]:
        found, fix = list[Claim](), "give this one another vehicle.links or vehicle.system_id"
        for link in self.endpoints():
            what = f"the autopilot on {link}"
            if link.scheme == "serial":
                found.append(Claim(os.path.realpath(link.host), what, fix))
            elif link.scheme == "udpin" and link.port:
                found.append(Claim(f"udpin {host_and_port(link.host, link.port)}", what, fix))
            elif link.scheme != "udpin":  # behind it there may be several vehicles; 0 takes the first
                key = f"{link.scheme} {host_and_port(link.host, link.port)}"
                every = tuple(f"{key} {other}" for other in ((0,) if self.system_id else _SYSTEMS))
                found.append(Claim(f"{key} {self.system_id}", what, fix, every))
        return found


def autopilot_of(vehicle: VehicleOptions) -> AutopilotOptions | None:
    """Return the options of an autopilot; None if the vehicle is none, and has no MAVLink of its own."""
    return vehicle if isinstance(vehicle, AutopilotOptions) else None


GimbalReport = Literal["auto", "mount_status"]


class GimbalOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """A gimbal that an autopilot's link reports (docs/cameras.md); the camera file's rotation is then that on its last axis.

    Raises:
        ValueError: a number is outside its range, or keys need a gimbal and there is none.
    """

    device_id: Annotated[
        int,
        number(
            "component id of the gimbal, 154 or 171 to 175, or 1 to 6 for one that the autopilot drives; 0 for a fixed camera",
            "id",
            0,
            255,
            "MAVLink",
            public=True,
        ),
    ] = 0
    report: Annotated[
        GimbalReport,
        choice(
            "its attitude: auto is GIMBAL_DEVICE_ATTITUDE_STATUS, or MOUNT_ORIENTATION while that does not come; mount_status is "
            "MOUNT_STATUS, whose angles are relative to the vehicle (servo gimbals of ArduPilot before 4.3)",
            page=True,
        ),
    ] = "auto"
    rate_hz: Annotated[float, tuning("reports to ask it for", "Hz", 5.0, 200.0)] = 50.0
    latency_s: Annotated[
        float, tuning("from the instant at which the attitude was true to its stamp, or its arrival if it has none", "s", 0, 0.2)
    ] = 0.0
    latency_sigma_s: Annotated[float, tuning("one standard deviation of it", "s", 0.0, 0.1)] = 0.01
    sigma_rad: Annotated[
        float, tuning("standard deviation of the reported attitude about each axis", "rad", 1e-4, 0.2, "assumed")
    ] = math.radians(0.5)
    point_down: Annotated[
        bool,
        choice(
            "whether to point the gimbal down, at the start and whenever it has left; otherwise somebody else does", public=True
        ),
    ] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.device_id == 0 and (self.point_down or self.report != "auto"):
            raise ValueError("device_id must name the gimbal, found 0")

    @property
    def given(self) -> bool:
        """True if there is a gimbal."""
        return self.device_id != 0

    @property
    def of_autopilot(self) -> bool:
        """True if the autopilot itself drives the gimbal and reports for it."""
        return 1 <= self.device_id <= 6
