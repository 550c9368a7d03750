"""The table `[gimbal]` of a scenario: the gimbal that carries the camera of a vehicle with an autopilot."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Struct

from estimator.contracts.keys import check_ranges, choice, number


class GimbalSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """A gimbal; only the stand-in for an autopilot program has one (`simulate --autopilot ... --binary stand-in`).

    Raises:
        ValueError: a number is outside its range.
    """

    device_id: Annotated[
        int,
        number("its component id, or 1 to 6 for one that the autopilot itself drives; 0 for a fixed camera", "id", 0, 255),
    ] = 0
    start_pitch_deg: Annotated[float, number("its pitch at the start, against the horizon", "deg", -120.0, 45.0)] = 0.0
    lag_s: Annotated[float, number("time constant with which it follows what it is told", "s", 0.01, 5.0)] = 0.3
    wander_deg: Annotated[
        float, number("how far it swings about what it is told, in pitch, and half as far in roll", "deg", 0.0, 30.0)
    ] = 0.0
    wander_hz: Annotated[float, number("how often it does so", "Hz", 0.01, 5.0)] = 0.3
    leak: Annotated[
        float, number("fraction of the vehicle's roll and pitch that it does not take out", "1", 0.0, 1.0, "assumed")
    ] = 0.03
    yaw: Annotated[Literal["vehicle", "earth"], choice("whether it reports its yaw from the vehicle's heading or from north")] = (
        "vehicle"
    )
    report_delay_s: Annotated[float, number("delay of its reports, whose stamps are right", "s", 0.0, 0.5)] = 0.01
    leaves_at_s: Annotated[float, number("time at which somebody else points it ahead; 0 for never", "s", 0.0, 3600.0)] = 0.0
    silent_at_s: Annotated[float, number("time at which its reports end; 0 for never", "s", 0.0, 3600.0)] = 0.0

    def __post_init__(self) -> None:
        check_ranges(self)

    @property
    def given(self) -> bool:
        """Whether there is a gimbal."""
        return self.device_id != 0
