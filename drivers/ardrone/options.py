"""Everything about an AR.Drone link that a person may choose."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields

from drivers.ardrone.at import CTRL_ACK, AtCommand, Config, ConfigIds, Ctrl
from drivers.ardrone.samples import SampleOptions
from drivers.ardrone.velocity_loop import LoopOptions


@dataclass(frozen=True, slots=True)
class ArDroneOptions:
    """Where the drone is, what it is asked to be, and how patient the link is.

    Raises:
        ValueError: a number out of range.
    """

    host: str = "192.168.1.1"
    navdata_port: int = 5554
    video_port: int = 5555
    at_port: int = 5556
    control_port: int = 5559

    loop: LoopOptions = field(default_factory=LoopOptions)
    """The velocity loop; its limits are also sent to the drone as its configuration."""
    samples: SampleOptions = field(default_factory=SampleOptions)

    ids: tuple[str, str, str] | None = ("dec1a4de", "dec1a4d1", "dec1a4d0")
    """Session, user and application of the drone's multiple configurations, eight hexadecimal digits each; None to use none."""
    altitude_max_m: float = 20.0
    com_watchdog_s: int = 2
    """How long the drone flies on with the last command it heard before it hovers, and then hovers before it lands by itself."""
    hold_s: float = 60.0
    """How long the sender holds a flying drone in hover after the service died, for a new service to take over."""
    hold_com_watchdog_s: int = 60
    """The drone's `com_watchdog_s` while it is held so: its last command is hover, and the longer it waits the better."""
    settings: Mapping[str, str] = field(default_factory=dict)
    """Further configuration keys, sent last."""

    command_period_s: float = 0.03
    command_timeout_s: float = 0.12
    """A velocity command older than this is flown as hover, by the sender too when the service says nothing more."""
    landing_timeout_s: float = 0.5
    """A landing that guidance has not repeated for this long is called off, if it is not about to end."""
    velocity_timeout_s: float = 0.25
    """A velocity command is flown as hover without a measured velocity younger than this."""
    take_off_timeout_s: float = 8.0
    """A take-off that has not happened after this is given up, lest the drone starts at some later time."""

    navdata_silence_s: float = 1.0
    """Without navdata for this long the stream is asked for again."""
    reopen_after_s: float = 3.0
    """Without navdata for this long its socket and the command socket are opened anew."""
    video_silence_s: float = 2.0
    connect_timeout_s: float = 2.0
    config_timeout_s: float = 2.0
    """For one configuration key to be acknowledged."""
    restart_first_s: float = 0.1
    restart_most_s: float = 5.0
    """Back-off of a channel that failed: doubled from the first to the most."""

    navdata_delay_s: float = 0.002
    navdata_delay_sigma_s: float = 0.001
    """Least time from the drone's measurement to hearing of it."""
    video_delay_s: float = 0.04
    video_delay_sigma_s: float = 0.01
    """Least time from mid-exposure to the first byte of its frame: half the exposure, read-out, encoder, radio."""
    arrival_sigma_s: float = 0.02
    """Of stamps in demo mode, which has no clock."""
    exposure_s: float = 0.0
    """How long the shutter is open, handed on with each frame; 0 for not known."""
    video_settle_s: float = 0.3
    """Frames heard up to this long after the bottom camera was selected may still be of the other camera."""
    sample_line: int = 4096
    """Samples kept for a slow reader before the oldest are dropped; two seconds and more."""

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if f.name.endswith("_port") and not 1 <= value <= 65535:
                raise ValueError(f"{f.name} must lie in 1..65535, got {value!r}")
            if f.name.endswith("_s"):
                zero_ok = "delay" in f.name or f.name in ("exposure_s", "video_settle_s", "hold_s")
                if not math.isfinite(value) or value < 0 or (value == 0 and not zero_ok):
                    raise ValueError(f"{f.name} must be positive seconds, got {value!r}")
        if not 0 < self.altitude_max_m <= 100 or self.sample_line < 1:
            raise ValueError(f"altitude_max_m must lie in (0, 100] and sample_line be positive, got {self!r}")
        if self.ids is not None and any(len(i) != 8 or not set(i) <= set("0123456789abcdef") for i in self.ids):
            raise ValueError(f"ids must be three times eight lower-case hexadecimal digits, got {self.ids!r}")

    def configuration(self) -> dict[str, str]:
        """Every key the drone is asked for, in the order of sending; full navdata first, since it ends the drone's bootstrap."""
        wanted = {"general:navdata_demo": "FALSE"}
        if self.ids is not None:
            session, user, application = self.ids
            wanted["custom:session_id"] = session
            wanted["custom:profile_id"] = user
            wanted["custom:application_id"] = application
        wanted["video:video_codec"] = "129"
        wanted["video:video_channel"] = "1"
        wanted["general:com_watchdog"] = str(self.com_watchdog_s)
        wanted["control:altitude_max"] = str(round(self.altitude_max_m * 1000))
        wanted["control:euler_angle_max"] = f"{self.loop.euler_angle_max_rad:.6f}"
        wanted["control:control_vz_max"] = str(round(self.loop.vz_max_m_s * 1000))
        wanted["control:control_yaw"] = f"{self.loop.yaw_rate_max_rad_s:.6f}"
        wanted.update(self.settings)
        return wanted

    def timeouts(self, seconds: int) -> list[AtCommand]:
        """Commands that set `com_watchdog_s` alone, without waiting for the acknowledge bit: nobody may be there to wait."""
        ids: list[AtCommand] = [] if self.ids is None else [ConfigIds(*self.ids)]
        return [Ctrl(CTRL_ACK), *ids, Config("general:com_watchdog", str(seconds)), Ctrl(CTRL_ACK)]
