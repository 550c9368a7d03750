"""The faults of a simulated flight as data: every kind that a scenario file may list under `[[faults]]`."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from estimator.contracts.keys import choice, number
from sitl.faults.fault import Fault
from sitl.faults.operator import OperatorActs
from sitl.faults.picture import FocalLength, Glint, LightFalls, ObjectOnPad, OtherPad, PadCovered, WetLens
from sitl.faults.reports import VesselReports
from sitl.faults.sensors import (
    Accelerometer,
    AttitudeReading,
    Barometer,
    Gyro,
    HeadingReading,
    Magnetometer,
    Ultrasound,
    VelocityReading,
)
from sitl.faults.ship import DeckRoll, FerryWake, ShipSpeed, ShipTurn
from sitl.faults.streams import CommandStream, FrameStream, NavdataStream


class LensCovered(Fault, frozen=True, tag="lens_covered"):
    """The camera's frames are black."""


class FramesFrozen(Fault, frozen=True, tag="frames_frozen"):
    """Every frame holds the image of the last one before, with a stamp of its own."""


class FramesShifted(Fault, frozen=True, tag="frames_shifted"):
    """Frames show everything, the pad included, beside its true place."""

    forward_m: Annotated[float, number("shift along the pad's arrow", "m", -20.0, 20.0)] = 0.0
    right_m: Annotated[float, number("shift to starboard of the pad's arrow", "m", -20.0, 20.0)] = 0.0
    fraction: Annotated[float, number("fraction of the frames that are shifted, drawn by the seed", "1", 0.01, 1.0)] = 1.0

    def check(self) -> None:
        if self.forward_m == 0.0 and self.right_m == 0.0:
            raise ValueError("forward_m or right_m must say how far the frames are shifted")


class FramesMisstamped(Fault, frozen=True, tag="frames_misstamped"):
    """Frames carry a wrong stamp: with a negative error they claim to be older than they are."""

    by_s: Annotated[float, number("stamp minus the true instant of exposure", "s", -3600.0, 3600.0)]


class NavdataMisstamped(Fault, frozen=True, tag="navdata_misstamped"):
    """Samples carry a wrong stamp: with a negative error they claim to be older than they are."""

    by_s: Annotated[float, number("stamp minus the true instant of the sample", "s", -3600.0, 3600.0)]


class FlowBlind(Fault, frozen=True, tag="flow_blind"):
    """The vehicle's own optical flow finds nothing: it believes that it stands still."""


class LowBattery(Fault, frozen=True, tag="low_battery"):
    """The battery's charge falls at once to a fraction."""

    fraction: Annotated[float, number("remaining fraction of a full battery", "1", 0.0, 1.0)] = 0.1


class Gust(Fault, frozen=True, tag="gust"):
    """A single gust: the wind rises and falls as one minus a cosine over `for_s`."""

    speed_m_s: Annotated[float, number("speed of the added wind at its height, half way through", "m/s", 0.0, 25.0)] = 5.0
    from_deg: Annotated[float, number("direction from which it blows, clockwise from north", "deg", -360.0, 360.0)] = 0.0

    def check(self) -> None:
        if self.for_s is None:
            raise ValueError("for_s must say how long the gust takes to pass")


class WeakRotor(Fault, frozen=True, tag="weak_rotor"):
    """A rotor gives a fraction of its thrust."""

    rotor: Annotated[
        Literal["front_left", "front_right", "right", "rear_right", "rear_left", "left"],
        choice("which rotor; right and left are a hexacopter's"),
    ] = "front_left"
    thrust_fraction: Annotated[float, number("fraction of its thrust that it still gives", "1", 0.0, 1.0)] = 0.8


class TiltLimited(Fault, frozen=True, tag="tilt_limited"):
    """The vehicle leans no further than this, whatever it is told or configured."""

    to_deg: Annotated[float, number("largest roll or pitch", "deg", 0.5, 45.0)] = 3.0


class LinkLost(Fault, frozen=True, tag="link_lost"):
    """Nothing passes between the vehicle and the service: no samples, no frames, no commands."""


class ServiceKilled(Fault, frozen=True, tag="service_killed"):
    """The service's process is gone; after `for_s` a new one runs that remembers nothing. In virtual time only."""


AnyFault = (
    LensCovered
    | FramesFrozen
    | FramesShifted
    | FramesMisstamped
    | PadCovered
    | ObjectOnPad
    | OtherPad
    | Glint
    | LightFalls
    | WetLens
    | FocalLength
    | FrameStream
    | NavdataStream
    | CommandStream
    | Accelerometer
    | Gyro
    | AttitudeReading
    | HeadingReading
    | VelocityReading
    | Ultrasound
    | Barometer
    | Magnetometer
    | NavdataMisstamped
    | FlowBlind
    | LowBattery
    | Gust
    | WeakRotor
    | TiltLimited
    | ShipSpeed
    | ShipTurn
    | DeckRoll
    | FerryWake
    | VesselReports
    | LinkLost
    | ServiceKilled
    | OperatorActs
)
KINDS: dict[str, type[Fault]] = {str(kind.__struct_config__.tag): kind for kind in get_args(AnyFault)}
"""Every kind of fault by its word."""
