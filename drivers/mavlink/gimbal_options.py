"""The options of the gimbal that carries the camera: the table [camera.gimbal] of the settings file.

This module imports nothing of the dialect, so that settings can be read without loading it.
"""

import math
from typing import Annotated, Literal

from msgspec import Struct

from estimator.contracts.keys import check_ranges, choice, number

GimbalReport = Literal["auto", "mount_status"]


class GimbalOptions(Struct, frozen=True, forbid_unknown_fields=True):
    """A gimbal that an autopilot's link reports (docs/cameras.md); the camera file's rotation is then that on its last axis.

    Raises:
        ValueError: a number is outside its range, or keys need a gimbal and there is none.
    """

    device_id: Annotated[
        int,
        number(
            "the gimbal: its component id, 154 or 171 to 175, or 1 to 6 for one that the autopilot itself drives; 0 for a camera "
            "that is fixed on the vehicle",
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
            "MOUNT_STATUS, whose angles are relative to the vehicle (servo gimbals of ArduPilot before 4.3)"
        ),
    ] = "auto"
    rate_hz: Annotated[float, number("reports to ask it for", "Hz", 5.0, 200.0)] = 50.0
    latency_s: Annotated[
        float,
        number("from the instant at which the attitude was true to its stamp, or its arrival if it has none", "s", 0, 0.2),
    ] = 0.0
    latency_sigma_s: Annotated[float, number("one standard deviation of it", "s", 0.0, 0.1)] = 0.01
    sigma_rad: Annotated[
        float, number("standard deviation of the reported attitude about each axis", "rad", 1e-4, 0.2, "assumed")
    ] = math.radians(0.5)
    point_down: Annotated[
        bool,
        choice(
            "whether to take control of the gimbal and point it down, at the start and whenever it has left; otherwise that is "
            "somebody else's task",
            public=True,
        ),
    ] = False

    def __post_init__(self) -> None:
        check_ranges(self)
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
