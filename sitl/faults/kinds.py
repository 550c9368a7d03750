"""The faults of a simulated flight as data: every kind that a scenario file may list under `[[faults]]`."""

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal, get_args

import numpy as np

from companion.base.orders import StickPositions
from estimator.contracts.geometry import F64, GeoPoint, moved
from estimator.contracts.keys import choice, number, text
from sitl.faults.acts import OnFrame, OnSight, OnVehicle, Passage, Stream, Vehicles
from sitl.faults.corrupted import Corrupted
from sitl.faults.fault import Fault
from sitl.faults.readings import (
    Accelerometer,
    AttitudeReading,
    Barometer,
    Gyro,
    HeadingReading,
    Magnetometer,
    NavdataMisstamped,
    Ultrasound,
    VelocityReading,
)

_FORWARD, _RIGHT = "place along the pad's arrow from its centre", "place to starboard of the pad's arrow"


_FEET_M = 0.12
"""Reach of a vehicle's feet from its body's origin, m."""


class PictureFault(Fault, frozen=True):
    """Something that changes the picture."""

    def on_frame(self, frame: OnFrame) -> None:
        frame.drawn.append(self)

    @property
    def rendered_only(self) -> bool:
        """True if only a rendered image shows it: no detection is drawn from what it does."""
        return type(self).on_sight is Fault.on_sight


class PadCovered(PictureFault, frozen=True, tag="pad_covered"):
    """A tarpaulin hides part of the pad."""

    fraction: Annotated[float, number("hidden fraction of the pad's diameter, from its edge", "1", 0.05, 1.0)] = 0.5
    from_deg: Annotated[float, number("side from which it is hidden, clockwise from the arrow", "deg", -360.0, 360.0)] = 90.0

    def on_sight(self, sight: OnSight) -> None:
        sight.shown *= 1.0 - self.fraction


class ObjectOnPad(PictureFault, frozen=True, tag="object_on_pad"):
    """Something lies on the pad or beside it."""

    thing: Annotated[
        Literal["vest", "towel", "lifebuoy", "crate", "rope", "wet patch"],
        choice("what lies there; a wet patch darkens the paint, and nothing stands on it"),
    ] = "vest"
    forward_m: Annotated[float, number(_FORWARD, "m", -20.0, 20.0)] = 0.0
    right_m: Annotated[float, number(_RIGHT, "m", -20.0, 20.0)] = 0.0
    size_m: Annotated[float, number("its length", "m", 0.05, 5.0)] = 0.5
    turned_deg: Annotated[float, number("its direction, clockwise from the arrow", "deg", -360.0, 360.0)] = 30.0
    brightness: Annotated[
        float, number("luminance of a crate or a rope, which then is grey, white is 1; 0 for the usual colour", "1", 0.0, 1.0)
    ] = 0.0

    def touched(self, x_m: float, y_m: float, surface: str) -> str:
        """Return the words for a contact of a vehicle with it, at a place in `pad`; empty for none."""
        off_m = math.hypot(x_m - self.forward_m, y_m - self.right_m)
        touches = self.thing != "wet patch" and off_m < 0.5 * self.size_m + _FEET_M
        return f"touched a {self.thing} on the {surface}, {off_m:.2f} m from its middle" if touches else ""


class Bystander(PictureFault, frozen=True, tag="bystander"):
    """Something stands, walks or flies on or about the pad."""

    thing: Annotated[Literal["box", "person", "bird", "drone"], choice("what it is")] = "person"
    forward_m: Annotated[float, number(_FORWARD, "m", -20.0, 20.0)] = 0.0
    right_m: Annotated[float, number(_RIGHT, "m", -20.0, 20.0)] = 0.8
    width_m: Annotated[float, number("its width", "m", 0.05, 3.0)] = 0.5
    height_m: Annotated[float, number("height of its top over the deck", "m", 0.05, 10.0)] = 1.7
    to_forward_m: Annotated[float, number("where it turns, along the arrow", "m", -20.0, 20.0)] = 0.0
    to_right_m: Annotated[float, number("where it turns, to starboard of the arrow", "m", -20.0, 20.0)] = 0.0
    speed_m_s: Annotated[float, number("its speed on the way there and back; 0 stands", "m/s", 0.0, 20.0)] = 0.0

    def place_m(self, t_s: float) -> F64:
        """Return its place on the deck, (2,) m in `pad`, at a time of the flight."""
        start = np.array((self.forward_m, self.right_m))
        if self.speed_m_s <= 0.0:
            return start
        way = np.array((self.to_forward_m, self.to_right_m)) - start
        length = max(1e-6, float(np.hypot(*way)))
        gone = math.fmod(self.speed_m_s * t_s, 2.0 * length)
        return np.asarray(start + way / length * min(gone, 2.0 * length - gone))

    def met(self, p_pad: Sequence[float], t_s: float) -> str:
        """Return the words for a vehicle at (3,) m in `pad` that is in it at a time of the flight; empty for one that is not."""
        x, y, up = p_pad[0], p_pad[1], -p_pad[2]
        at = self.place_m(t_s)
        off_m = math.hypot(x - float(at[0]), y - float(at[1]))
        stands = self.thing in ("box", "person")
        high = up < self.height_m + _FEET_M and (stands or up > self.height_m - _FEET_M)
        inside = high and off_m < 0.5 * self.width_m + _FEET_M
        return f"flew into a {self.thing}, {off_m:.2f} m from its middle" if inside else ""


class OtherPad(PictureFault, frozen=True, tag="other_pad"):
    """Another pad on the deck, beside the right one or in its place."""

    file: Annotated[str, text("a shipped pad (configs/pads), or a path from the working directory", 4096)] = "thesis"
    size: Annotated[float, number("its size over that in the file", "1", 0.1, 5.0)] = 1.0
    forward_m: Annotated[float, number(_FORWARD, "m", -20.0, 20.0)] = 0.0
    right_m: Annotated[float, number(_RIGHT, "m", -20.0, 20.0)] = 0.0
    turned_deg: Annotated[float, number("direction of its arrow, clockwise from that of the pad", "deg", -360.0, 360.0)] = 0.0
    instead: Annotated[bool, choice("whether the right pad is painted over")] = False

    def check(self) -> None:
        if not self.instead and self.forward_m == 0.0 and self.right_m == 0.0:
            raise ValueError("forward_m or right_m must say where the other pad is, or instead must be true")

    def on_frame(self, frame: OnFrame) -> None:
        super().on_frame(frame)
        frame.pad_hidden |= self.instead


class Glint(PictureFault, frozen=True, tag="glint"):
    """The sun is mirrored by wet paint on the pad."""

    brightness: Annotated[float, number("light at the middle of the spot, in units of white paint", "1", 0.05, 20.0)] = 3.0
    radius_m: Annotated[float, number("radius at which it has fallen to a half", "m", 0.01, 5.0)] = 0.25
    forward_m: Annotated[float, number(_FORWARD, "m", -20.0, 20.0)] = 0.1
    right_m: Annotated[float, number(_RIGHT, "m", -20.0, 20.0)] = 0.1


class LightFalls(PictureFault, frozen=True, tag="light_falls"):
    """A lamp goes out, or a cloud comes: the light falls to a fraction."""

    fraction: Annotated[float, number("remaining fraction of the light", "1", 0.0001, 1.0)] = 0.1

    def on_sight(self, sight: OnSight) -> None:
        sight.light_stops += math.log2(self.fraction)


class WetLens(PictureFault, frozen=True, tag="wet_lens"):
    """Drops stand on the lens and blur the scene behind them."""

    drops: Annotated[int, number("number of drops, at places drawn by the seed", "1", 1, 200)] = 12
    radius: Annotated[float, number("mean radius over the height of the image", "1", 0.01, 1.0)] = 0.08
    blur_px: Annotated[float, number("standard deviation of the blur behind a drop", "px", 0.5, 60.0)] = 9.0


class FocalLength(PictureFault, frozen=True, tag="focal_length"):
    """The lens has another focal length than the camera's file says."""

    scale: Annotated[float, number("true focal length over that of the file", "1", 0.7, 1.4)] = 1.02

    def check(self) -> None:
        if self.scale == 1.0:
            raise ValueError("scale is 1: nothing would change")

    def on_sight(self, sight: OnSight) -> None:
        sight.focal *= self.scale


class StreamFault(Fault, frozen=True):
    """A fault of one stream."""

    delay_s: Annotated[float, number("delay in addition to the usual one; stamps stay true", "s", 0.0, 10.0)] = 0.0
    dropped_fraction: Annotated[float, number("fraction of the packets that are lost, drawn by the seed", "1", 0.0, 1.0)] = 0.0
    duplicated_fraction: Annotated[
        float, number("fraction of the packets that arrive twice, drawn by the seed", "1", 0.0, 1.0)
    ] = 0.0
    reordered_fraction: Annotated[
        float, number("fraction of the packets that the next one overtakes, drawn by the seed", "1", 0.0, 1.0)
    ] = 0.0

    def check(self) -> None:
        """Refuse a fault without an effect, or with effects that exclude each other; raises ValueError."""
        if not any((self.delay_s, self.dropped_fraction, self.duplicated_fraction, self.reordered_fraction)):
            raise ValueError(
                "nothing says what is wrong with the stream: give delay_s, dropped_fraction, duplicated_fraction or "
                "reordered_fraction"
            )
        if self.dropped_fraction == 1.0 and (self.delay_s or self.duplicated_fraction or self.reordered_fraction):
            raise ValueError("dropped_fraction is 1: no packet is left for another effect; give only dropped_fraction")

    def on_stream(self, stream: Stream) -> Passage | None:
        passage = Passage(self.delay_s, self.dropped_fraction, self.duplicated_fraction, self.reordered_fraction)
        return passage if stream == self.kind else None


class FrameStream(StreamFault, frozen=True, tag="frames"):
    """The camera's frames on their way to the service."""


class NavdataStream(StreamFault, frozen=True, tag="navdata"):
    """The vehicle's samples on their way to the service."""


class CommandStream(StreamFault, frozen=True, tag="commands"):
    """The service's commands on their way to the vehicle."""


_OVER = "time until it is steady, and again to go back where `for_s` ends it"


class ShipFault(Fault, frozen=True):
    """Something that the vessel does on top of her motion in the waves, which stays that of her course before."""

    def on_begin(self, world: Any) -> None:
        world.manoeuvre(self)


class ShipSpeed(ShipFault, frozen=True, tag="ship_speed"):
    """The vessel changes her speed; 0 stops her."""

    to_m_s: Annotated[float, number("speed along the heading, through the water", "m/s", 0.0, 15.0)]
    over_s: Annotated[float, number(_OVER, "s", 0.5, 300.0)] = 10.0


class ShipTurn(ShipFault, frozen=True, tag="ship_turn"):
    """The vessel turns, heels outward and loses speed, as in `sitl.vessel.seakeeping`."""

    rate_deg_s: Annotated[float, number("rate of turn, clockwise from above", "deg/s", -120.0, 120.0)]
    over_s: Annotated[float, number(_OVER, "s", 0.5, 300.0)] = 10.0

    def check(self) -> None:
        if self.rate_deg_s == 0.0:
            raise ValueError("rate_deg_s must not be 0: a vessel that keeps her course does not turn")


class DeckRoll(ShipFault, frozen=True, tag="deck_roll"):
    """The deck rolls to one side and to the other, besides what the waves do; it grows over one period and dies in one."""

    roll_deg: Annotated[float, number("amplitude", "deg", 0.1, 30.0)] = 8.0
    period_s: Annotated[float, number("period of the roll", "s", 1.0, 40.0)] = 8.0

    def check(self) -> None:
        if self.for_s is not None and self.for_s < 2.0 * self.period_s:
            raise ValueError(f"for_s must be two periods or more, {2.0 * self.period_s:g} s, for the roll to grow and die in")


class FerryWake(ShipFault, frozen=True, tag="ferry_wake"):
    """The wake of another ship passes: a train of waves that the vessel rides as she rides the sea."""

    height_m: Annotated[float, number("height of the highest wave, trough to crest", "m", 0.05, 3.0)] = 0.5
    period_s: Annotated[float, number("period of the waves", "s", 1.0, 15.0)] = 4.0
    waves: Annotated[float, number("number of waves in the train", "1", 2.0, 30.0)] = 8.0
    from_deg: Annotated[float, number("direction it comes from, clockwise from the bow", "deg", -360.0, 360.0)] = 90.0

    def check(self) -> None:
        if self.for_s is not None:
            raise ValueError("for_s does not go with a wake: it lasts waves x period_s")


class VesselReports(Fault, frozen=True, tag="vessel_reports"):
    """The ship's reports are wrong: a position that jumps shows as a velocity while it does."""

    north_m_s: Annotated[float, number("added to the reported velocity to the north", "m/s", -50.0, 50.0)] = 0.0
    east_m_s: Annotated[float, number("added to the reported velocity to the east", "m/s", -50.0, 50.0)] = 0.0
    heading_deg: Annotated[float, number("added to the reported heading, clockwise", "deg", -180.0, 180.0)] = 0.0
    place_north_m: Annotated[float, number("added to the reported place, to the north", "m", -10_000.0, 10_000.0)] = 0.0
    place_east_m: Annotated[float, number("added to the reported place, to the east", "m", -10_000.0, 10_000.0)] = 0.0
    late_s: Annotated[float, number("how much later than before every report arrives", "s", 0.0, 60.0)] = 0.0
    frozen: Annotated[bool, choice("whether the report at the beginning is repeated")] = False
    silent: Annotated[bool, choice("whether no report arrives")] = False

    def check(self) -> None:
        wrong = (self.north_m_s, self.east_m_s, self.heading_deg, self.place_north_m, self.place_east_m, self.late_s)
        if not any((*wrong, self.frozen, self.silent)):
            raise ValueError(
                "nothing says what is wrong with the reports: give north_m_s, heading_deg, place_north_m, late_s, frozen "
                "or silent"
            )

    def on_report(self, v_ned: F64, heading_rad: float, place: GeoPoint) -> tuple[F64, float, GeoPoint]:
        """Return velocity, (3,) m/s, heading and place as the ship's receiver and compass report them."""
        there = moved(place, np.array([self.place_north_m, self.place_east_m, 0.0]))
        return v_ned + np.array([self.north_m_s, self.east_m_s, 0.0]), heading_rad + math.radians(self.heading_deg), there


class RtkSolution(Fault, frozen=True, tag="rtk_solution"):
    """The receivers' solution is not what it should be."""

    solution: Annotated[
        Literal["silent", "float", "wrong"],
        choice("no solution; estimated ambiguities; or a wrong whole number of wavelengths, claimed as a right one"),
    ] = "silent"


class OperatorActs(Fault, frozen=True, tag="operator"):
    """A person takes over; after `for_s`, or by order begin, he gives the vehicle back and lets guidance begin again."""

    order: Annotated[
        Literal["hold", "manual", "abort", "land", "emergency", "begin", "stay", "clear", "mode", "disarm"],
        choice(
            "hold in place, fly by hand with the sticks below, end the landing and hover, land where the vehicle is, cut the "
            "motors; give it back and let guidance begin, or stay over the pad; say that the pad is clear; or, beside an "
            "autopilot, switch it by remote control to its mode that holds, or disarm it"
        ),
    ] = "hold"
    forward: Annotated[float, number("stick forward, with manual", "1", -1.0, 1.0)] = 0.0
    right: Annotated[float, number("stick to the right, with manual", "1", -1.0, 1.0)] = 0.0
    climb: Annotated[float, number("stick up, with manual", "1", -1.0, 1.0)] = 0.0
    turn: Annotated[float, number("stick clockwise, with manual", "1", -1.0, 1.0)] = 0.0
    late_s: Annotated[float, number("how long before it arrives the order was given", "s", 0.0, 60.0)] = 0.0

    def check(self) -> None:
        if self.order != "manual" and any((self.forward, self.right, self.climb, self.turn)):
            raise ValueError(f"forward, right, climb and turn are sticks: they go with order manual, not with {self.order}")
        if self.order in ("abort", "land", "emergency", "disarm") and self.for_s is not None:
            raise ValueError(f"for_s does not go with {self.order}, which ends the flight")
        if self.order in ("begin", "stay", "clear") and self.for_s is not None:
            raise ValueError(f"for_s does not go with {self.order}, after which guidance flies on")

    def carried_by(self, vehicle: Vehicles) -> bool:
        return vehicle != "ardrone" or self.order not in ("mode", "disarm")

    @property
    def sticks(self) -> StickPositions:
        """The sticks, with manual."""
        return StickPositions(self.forward, self.right, self.climb, self.turn)

    @property
    def words(self) -> str:
        """The fault in words."""
        return f"a person orders {self.order}" + (f", {self.late_s:g} s late" if self.late_s else "")


class Failsafe(Fault, frozen=True, tag="failsafe"):
    """An autopilot's own failsafe acts: it takes a mode, reports that its state is critical, and says why."""

    CARRIED = frozenset({"stand-in"})

    takes: Annotated[Literal["land", "hold"], choice("the mode that it takes: it lands here, or holds")] = "land"

    def check(self) -> None:
        if self.for_s is not None:
            raise ValueError("for_s does not go with a failsafe: the mode stays until somebody takes another")

    def on_begin(self, world: Any) -> None:
        world.on_failsafe(self.takes)


class LensCovered(Fault, frozen=True, tag="lens_covered"):
    """The camera's frames are black."""

    def on_frame(self, frame: OnFrame) -> None:
        frame.covered = True


class FramesFrozen(Fault, frozen=True, tag="frames_frozen"):
    """Every frame holds the image of the last one before, with a stamp of its own."""

    def on_frame(self, frame: OnFrame) -> None:
        frame.frozen = True


class FramesShifted(Fault, frozen=True, tag="frames_shifted"):
    """Frames show everything, the pad included, beside its true place."""

    forward_m: Annotated[float, number("shift along the pad's arrow", "m", -20.0, 20.0)] = 0.0
    right_m: Annotated[float, number("shift to starboard of the pad's arrow", "m", -20.0, 20.0)] = 0.0
    fraction: Annotated[float, number("fraction of the frames that are shifted, drawn by the seed", "1", 0.01, 1.0)] = 1.0

    def check(self) -> None:
        if self.forward_m == 0.0 and self.right_m == 0.0:
            raise ValueError("forward_m or right_m must say how far the frames are shifted")

    def on_frame(self, frame: OnFrame) -> None:
        if self.fraction >= 1.0 or frame.chance() < self.fraction:
            frame.forward_m += self.forward_m
            frame.right_m += self.right_m


class FramesMisstamped(Fault, frozen=True, tag="frames_misstamped"):
    """Frames carry a wrong stamp: with a negative error they claim to be older than they are."""

    by_s: Annotated[float, number("stamp minus the true instant of exposure", "s", -3600.0, 3600.0)]

    def on_frame(self, frame: OnFrame) -> None:
        frame.stamp_s += self.by_s


class FlowBlind(Fault, frozen=True, tag="flow_blind"):
    """The vehicle's own optical flow finds nothing: it measures a standstill."""

    CARRIED = frozenset({"ardrone"})

    def on_vehicle(self, vehicle: OnVehicle, since_s: float) -> None:
        vehicle.flow_works = False


class LowBattery(Fault, frozen=True, tag="low_battery"):
    """The battery's charge falls at once to a fraction, and from there on as before."""

    CARRIED = frozenset({"ardrone", "stand-in"})
    fraction: Annotated[float, number("remaining fraction of a full battery", "1", 0.0, 1.0)] = 0.1

    def on_vehicle(self, vehicle: OnVehicle, since_s: float) -> None:
        vehicle.charge_max = min(vehicle.charge_max, self.fraction - since_s / vehicle.battery_life_s)


class Gust(Fault, frozen=True, tag="gust"):
    """A single gust: the wind rises and falls as one minus a cosine over `for_s`."""

    speed_m_s: Annotated[float, number("speed of the added wind at its height, half way through", "m/s", 0.0, 25.0)] = 5.0
    from_deg: Annotated[float, number("direction from which it blows, clockwise from north", "deg", -360.0, 360.0)] = 0.0

    def check(self) -> None:
        if self.for_s is None:
            raise ValueError("for_s must say how long the gust takes to pass")

    def on_vehicle(self, vehicle: OnVehicle, since_s: float) -> None:
        """Blow. Source: the "1 - cosine" discrete gust of MIL-F-8785C, 3.7.1.3, over time."""
        share = 0.5 * (1.0 - math.cos(math.tau * since_s / (self.for_s or math.inf)))
        speed_m_s, a = share * self.speed_m_s, math.radians(self.from_deg)
        north, east, down = vehicle.wind_ned
        vehicle.wind_ned = (north - speed_m_s * math.cos(a), east - speed_m_s * math.sin(a), down)


class WeakRotor(Fault, frozen=True, tag="weak_rotor"):
    """A rotor gives a fraction of its thrust."""

    CARRIED = frozenset({"ardrone", "stand-in", "program"})
    rotor: Annotated[
        Literal["front_left", "front_right", "right", "rear_right", "rear_left", "left"],
        choice("which rotor; right and left are a hexacopter's"),
    ] = "front_left"
    thrust_fraction: Annotated[float, number("fraction of its thrust that it still gives", "1", 0.0, 1.0)] = 0.8

    def on_vehicle(self, vehicle: OnVehicle, since_s: float) -> None:
        vehicle.thrust[self.rotor] *= self.thrust_fraction


class TiltLimited(Fault, frozen=True, tag="tilt_limited"):
    """The vehicle tilts no further than this, whatever its commands or settings are."""

    CARRIED = frozenset({"ardrone", "stand-in"})
    to_deg: Annotated[float, number("largest roll or pitch", "deg", 0.5, 45.0)] = 3.0

    def on_vehicle(self, vehicle: OnVehicle, since_s: float) -> None:
        vehicle.tilt_max_rad = min(vehicle.tilt_max_rad, math.radians(self.to_deg))


class LinkLost(Fault, frozen=True, tag="link_lost"):
    """Lost link between the vehicle and the service: no samples, no frames, no commands."""

    CUTS_LINK = True

    def on_stream(self, stream: Stream) -> Passage | None:
        return Passage(lost=1.0, by_chance=False)


class ServiceKilled(Fault, frozen=True, tag="service_killed"):
    """The service's process is gone; after `for_s` a new one runs with what the file of its flight kept. In virtual time only."""

    KILLS_SERVICE = True


AnyFault = (
    LensCovered
    | FramesFrozen
    | FramesShifted
    | FramesMisstamped
    | PadCovered
    | ObjectOnPad
    | Bystander
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
    | Failsafe
    | RtkSolution
    | Corrupted
)
KINDS: dict[str, type[Fault]] = {str(kind.__struct_config__.tag): kind for kind in get_args(AnyFault)}
"""Every kind of fault by its word."""
