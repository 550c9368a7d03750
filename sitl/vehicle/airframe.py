"""The vehicle: body, rotors, inner loops, own estimator, feet and limits, from a file and a scenario's table `[vehicle]`.

vehicle = load(path)               # of a shipped one: configs/vehicles/ardrone2.toml
"""

import math
from functools import cache
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import msgspec
import numpy as np
from msgspec import Meta, Struct, field, structs

from companion.settings.load import read_toml
from companion.settings.schema import explain
from decklander.place import SHIPPED
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.contracts.keys import choice, number, text
from estimator.contracts.motion import G_M_S2
from sitl.vehicle.disturbances import EffectSettings

_Three = tuple[float, float, float]


class Loops(Struct, frozen=True):
    """Gains of the inner loops: P and D as in the thesis' simulator (hector_quadrotor's controller), the rest as documented."""

    tilt_p: float = 10.0
    """1/s^2: angular acceleration per rad of roll or pitch error."""
    tilt_d: float = 5.0
    """1/s."""
    tilt_gain: float = 1.0
    """Roll and pitch that the loops fly, over what the stick requests."""
    tilt_max_rad: float = 0.5
    """Largest roll or pitch that any loop may request."""
    yaw_rate_p: float = 2.0
    """1/s."""
    disturbance_s: float = 0.1
    """Time in which the loops take up a torque that they did not request (`physics/vehicle.c`; assumed). The thesis' loops
    have no such part and overturn with one motor at 80 %; autopilots have an integral (ATC_RAT_RLL_I, MC_ROLLRATE_I)."""
    velocity_p: float = 5.0
    """1/s: acceleration per m/s of horizontal velocity error while hovering."""
    velocity_d: float = 1.0
    """Term per m/s^2 of acceleration."""
    velocity_i: float = 1.0
    """1/s^2. The thesis' loop has none and drifts downwind for ever; the real drone holds its place (Bristeau, Callou,
    Vissiere & Petit, The navigation and control technology inside the AR.Drone micro UAV, IFAC 2011, section 5)."""
    velocity_i_max_m_s2: float = 3.0
    climb_p: float = 5.0
    """1/s."""
    climb_d: float = 1.0
    climb_i: float = 2.5
    """1/s^2. Without it the ground effect over the deck can hold the vehicle up for ever at a gentle landing speed."""
    climb_i_max_m_s2: float = 4.0
    height_p: float = 1.0
    """1/s: climb rate commanded per metre away from the height held."""


class Avionics(Struct, frozen=True):
    """The errors of the drone's own estimates, which feed its control loops as well as its telemetry."""

    tilt_bias_sigma_rad: float = 0.009
    """Sigma of the constant part of the roll and pitch error, which is drawn once a flight."""
    tilt_drift_sigma_rad: float = 0.007
    tilt_drift_time_s: float = 1.0
    """Correlation time of the drifting part."""
    flow_scale: float = 0.83
    """Measured velocity over true velocity."""
    flow_noise_sigma_m_s: float = 0.015
    flow_noise_time_s: float = 0.2
    flow_lag_s: float = 0.03
    flow_sees_deck: bool = True
    """True if the optical flow measures against the deck while over it. If False, it always measures against the still water."""


class Feet(Struct, frozen=True, forbid_unknown_fields=True):
    """Four elastic feet, and the friction under them."""

    DAMPING_RATIO: ClassVar[float] = 0.7
    """Damping over critical damping: there is nearly no rebound."""
    half_base_m: Annotated[float, number("distance of each foot ahead or astern of the middle, and to its side", "m", 0.02, 2.0)]
    below_m: Annotated[float, number("distance of the feet below the body's origin", "m", 0.01, 1.0)]
    top_m: Annotated[float, number("height of the hull's top over the body's origin", "m", 0.01, 1.0)]
    stiffness_n_m: Annotated[float, number("stiffness of all four feet together", "N/m", 100.0, 200000.0)]
    friction: Annotated[float, number("Coulomb's coefficient of friction", "1", 0.05, 2.0)] = 0.6

    @property
    def corners_m(self) -> F64:
        """(4, 3) places of the feet in body axes."""
        a, z = self.half_base_m, self.below_m
        return np.array([[a, a, z], [a, -a, z], [-a, -a, z], [-a, a, z]])


class Build(Struct, frozen=True, kw_only=True):
    """The figures of a vehicle's file that the physics takes as they are."""

    mass_kg: Annotated[float, number("mass ready to fly", "kg", 0.1, 30.0)]
    inertia_kg_m2: Annotated[_Three, Meta(description="principal moments about x, y, z")]
    layout: Annotated[Literal["quad_x", "hexa_x"], choice("four rotors in an X, or six with two of them at the sides")]
    arm_m: Annotated[
        float, number("position of a rotor: for a quad ahead and aside, for a hexa its distance from the middle", "m", 0.03, 2.0)
    ]
    rotor_radius_m: Annotated[float, number("radius of one rotor", "m", 0.02, 0.6)]
    rotors_above_m: Annotated[float, number("height of the rotor plane over the body's origin", "m", 0.0, 0.5)]
    yaw_torque_per_thrust_m: Annotated[float, number("drag torque of a rotor over its thrust", "m", 0.001, 0.2)]
    thrust_max_n: Annotated[float, number("largest thrust of all rotors together", "N", 1.0, 1000.0)]
    torque_max_n_m: Annotated[_Three, Meta(description="that the loops may ask for, about x, y, z")]
    motor_lag_s: Annotated[float, number("first-order lag of thrust and torque", "s", 0.0, 0.5)]
    command_delay_s: Annotated[float, number("delay from the arrival of a stick command to its effect", "s", 0.0, 0.5)]
    drag_per_s: Annotated[_Three, Meta(description="1/s, deceleration per m/s of airspeed along the body's axes")]
    feet: Feet
    ground_effect: Annotated[
        Literal["body", "rotors"],
        choice("ground effect by the surface under the body's middle, or by that under each rotor, as at the deck's edge"),
    ] = "rotors"
    landing_speed_m_s: Annotated[float, number("descent rate of the vehicle's own landing", "m/s", 0.1, 1.5)] = 0.4


class Airframe(Build, frozen=True, kw_only=True):
    """The figures that do not change in flight."""

    take_off_speed_m_s: float = 0.5
    take_off_height_m: float = 1.0
    motors_off_after_s: float = 0.2
    """Time of contact after which an automatic landing stops the motors."""
    tilt_cut_off_rad: float = 1.2
    """Motors stop beyond this tilt, as the real drone's do."""
    effects: EffectSettings = field(default_factory=EffectSettings)
    lift_share: float = 1.0
    """Thrust that the rotors give over that which the loops count on."""
    downwash_share: float = 1.0
    """Turbulence of the downwash over that of the effects."""
    loops: Loops = field(default_factory=Loops)
    avionics: Avionics = field(default_factory=Avionics)

    @property
    def falls_deg(self) -> float:
        """Least tilt of a vehicle that stands at which it falls over its feet, or a rotor touches the deck."""
        return self.contact_tilt_deg(0.0)

    def contact_tilt_deg(self, into_deck_m_s: float) -> float:
        """Return the least tilt against the deck at which, in a contact, a rotor touches it or the vehicle falls over its feet.

        The centre of gravity is at the body's origin. One foot takes the whole mass, and gives until it is stopped: the first
        maximum of a damped spring that is struck at a speed.

        Args:
            into_deck_m_s: speed of the foot that strikes.
        """
        feet, rest = self.feet, math.sqrt(1.0 - self.feet.DAMPING_RATIO**2)
        ahead = math.exp(-feet.DAMPING_RATIO / rest * math.acos(feet.DAMPING_RATIO))
        gives_m = into_deck_m_s * math.sqrt(4.0 * self.mass_kg / feet.stiffness_n_m) * ahead
        feet_m = self.feet.corners_m[:, :2]
        axes_m = np.array([(self.arm_m * r.forward, self.arm_m * r.right) for r in rotors(self)])
        over_m, least = self.feet.below_m + self.rotors_above_m - gives_m, math.inf
        for way in np.linspace(0.0, math.tau, 72, endpoint=False):
            u = np.array([math.cos(way), math.sin(way)])
            edge_m = float((feet_m @ u).max())
            beyond_m = float((axes_m @ u).max()) + self.rotor_radius_m - edge_m
            falls = math.atan2(edge_m, self.feet.below_m)
            least = min(least, falls, math.atan2(over_m, beyond_m) if beyond_m > 0.0 else falls)
        return math.degrees(least)


class StickLimits(Struct):
    """The values that a full stick requests. They can be set in flight."""

    euler_angle_max_rad: float = 0.21
    vz_max_m_s: float = 0.7
    yaw_rate_max_rad_s: float = 1.745
    """The AR.Drone's defaults: 12 degrees, 700 mm/s, 100 degrees/s."""
    euler_angle_most_rad: float = 0.52
    """The largest tilt that the configuration takes: by the AR.Drone's firmware 0.52 rad."""


class LoopSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The inner loops that differ between vehicles; the rest are `sitl.vehicle.airframe.Loops`."""

    tilt_p: Annotated[float, number("square of the tilt response's natural frequency", "1/s^2", 1.0, 1000.0)]
    tilt_d: Annotated[float, number("twice the damping ratio times that frequency", "1/s", 0.5, 100.0)]
    tilt_max_deg: Annotated[float, number("largest tilt that any loop commands", "deg", 5.0, 60.0)]
    yaw_rate_p: Annotated[float, number("gain of the yaw rate", "1/s", 0.1, 20.0)] = 2.0


class ContactSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Loads that the vehicle bears at a contact with the deck.

    The defaults: a foot strikes at twice the rate of ArduPilot's own landing (LAND_SPEED 0.5 m/s), which is a drop from 5 cm;
    along the deck at under a third of the speed at which the slimmest shipped vehicle tips over a foot that catches (1.7 m/s, by
    the energy of its turn about the foot); tilted as far as the file's geometry lets it while a foot that strikes at that speed
    gives (`Airframe.contact_tilt_deg`): 32.0 degrees for the AR.Drone, 34.6 and 33.6 for
    the two others.
    """

    into_deck_max_m_s: Annotated[float, number("speed of a foot into the deck", "m/s", 0.1, 5.0)] = 1.0
    along_deck_max_m_s: Annotated[float, number("speed along the deck", "m/s", 0.1, 5.0)] = 0.5
    tilt_max_deg: (
        Annotated[float, number("tilt against the deck; by feet, springs and rotors without it", "deg", 1.0, 60.0)] | None
    ) = None


class LimitSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Values of a full stick until the configuration changes them."""

    euler_angle_max_deg: Annotated[float, number("largest tilt", "deg", 1.0, 45.0)]
    vz_max_m_s: Annotated[float, number("largest climb and descent rate", "m/s", 0.1, 5.0)]
    yaw_rate_max_deg_s: Annotated[float, number("largest rate of turn", "deg/s", 5.0, 400.0)]


class VehicleFile(Build, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A vehicle."""

    title: Annotated[str, text("one line for people", 120)]
    source: Annotated[str, text("where the figures come from, and which are assumed", 2000)]
    loops: LoopSettings
    limits: LimitSettings
    contact: ContactSettings = ContactSettings()
    response: Annotated[
        str,
        text("shipped response that a flight without a settings file is flown by; auto takes that of the kind of vehicle", 60),
    ] = "auto"

    def __post_init__(self) -> None:
        if min(self.inertia_kg_m2) <= 0 or min(self.torque_max_n_m) <= 0 or min(self.drag_per_s) < 0:
            raise ValueError("inertia_kg_m2 and torque_max_n_m must be positive, drag_per_s 0 or more")
        if self.thrust_max_n < 1.2 * G_M_S2 * self.mass_kg:
            raise ValueError(
                f"thrust_max_n is {self.thrust_max_n:g} N: it must be 1.2 times the weight or more, or it cannot climb"
            )
        x, y, z = self.inertia_kg_m2
        if x + y < z or y + z < x or z + x < y:
            raise ValueError("inertia_kg_m2: no body has one moment larger than the sum of the two others")

    def airframe(self) -> Airframe:
        """Return the figures as the physics takes them."""
        loops = Loops(
            tilt_p=self.loops.tilt_p,
            tilt_d=self.loops.tilt_d,
            tilt_max_rad=math.radians(self.loops.tilt_max_deg),
            yaw_rate_p=self.loops.yaw_rate_p,
        )
        return Airframe(**{name: getattr(self, name) for name in Build.__struct_fields__}, loops=loops)

    def stick_limits(self) -> StickLimits:
        """Return what a full stick requests."""
        v = self.limits
        limits = StickLimits(math.radians(v.euler_angle_max_deg), v.vz_max_m_s, math.radians(v.yaw_rate_max_deg_s))
        # A client writes six decimals.
        most_rad = math.ceil(1e6 * math.radians(self.loops.tilt_max_deg)) / 1e6
        limits.euler_angle_most_rad = max(limits.euler_angle_most_rad, most_rad)
        return limits


def load(path: Path) -> VehicleFile:
    """Return the vehicle in a file.

    Raises:
        BadInput: the file cannot be read, or a key is unknown, missing, wrong or contradicts another: one line with file and key.
    """
    data = read_toml(path)
    try:
        return msgspec.convert(data, VehicleFile, strict=True)
    except msgspec.ValidationError as why:
        raise BadInput(f"{path}: {explain(VehicleFile, data, str(why))}") from why


@cache
def ardrone2() -> Airframe:
    """Return the figures of the AR.Drone 2.0."""
    return load(SHIPPED / "vehicles" / "ardrone2.toml").airframe()


_UNLESS = "; the vehicle's own by default"


class VehicleSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The vehicle, and what may be changed about it."""

    file: Annotated[str, text("a shipped vehicle (configs/vehicles), or a path relative to the scenario file", 200)] = "ardrone2"
    generation: Annotated[
        Literal["1.0", "2.0"],
        choice("generation of the AR.Drone whose protocol it speaks; a 1.0 films 176x144 px, with the camera ardrone1_bottom"),
    ] = "2.0"
    mass_kg: Annotated[float, number("mass; the inertia is in proportion" + _UNLESS, "kg", 0.2, 30.0)] | None = None
    command_delay_s: (
        Annotated[float, number("delay from the arrival of a stick command to its effect" + _UNLESS, "s", 0.0, 0.5)] | None
    ) = None
    motor_lag_s: Annotated[float, number("time constant of rotor thrust" + _UNLESS, "s", 0.0, 0.5)] | None = None
    landing_speed_m_s: Annotated[float, number("descent rate of its own landing" + _UNLESS, "m/s", 0.1, 1.5)] | None = None
    gnss_hz: Annotated[
        float, number("places a second of a GNSS receiver on it, the AR.Drone's flight recorder; 0 without one", "Hz", 0.0, 20.0)
    ] = 0.0
    ground_effect: (
        Annotated[
            Literal["body", "rotors"],
            choice(
                "ground effect by the surface under the body's middle, or by that under each rotor, as at the deck's edge"
                + _UNLESS
            ),
        ]
        | None
    ) = None
    euler_angle_max_deg: (
        Annotated[float, number("limit at full stick, until the configuration changes it" + _UNLESS, "deg", 1.0, 28.0)] | None
    ) = None
    vz_max_m_s: (
        Annotated[float, number("limit at full stick, until the configuration changes it" + _UNLESS, "m/s", 0.1, 2.0)] | None
    ) = None
    yaw_rate_max_deg_s: (
        Annotated[float, number("limit at full stick, until the configuration changes it" + _UNLESS, "deg/s", 10.0, 350.0)] | None
    ) = None

    def airframe(self, vehicle: VehicleFile) -> Airframe:
        """Return a vehicle's figures with these changes."""
        base = vehicle.airframe()
        mass = base.mass_kg if self.mass_kg is None else self.mass_kg
        k = mass / base.mass_kg
        ix, iy, iz = base.inertia_kg_m2
        names = ("command_delay_s", "motor_lag_s", "landing_speed_m_s", "ground_effect")
        changed = {name: value for name in names if (value := getattr(self, name)) is not None}
        return structs.replace(base, mass_kg=mass, inertia_kg_m2=(k * ix, k * iy, k * iz), **changed)

    def stick_limits(self, vehicle: VehicleFile) -> StickLimits:
        """Return what a full stick of a vehicle requests at first, with these changes."""
        limits = vehicle.stick_limits()
        if self.euler_angle_max_deg is not None:
            limits.euler_angle_max_rad = math.radians(self.euler_angle_max_deg)
        if self.vz_max_m_s is not None:
            limits.vz_max_m_s = self.vz_max_m_s
        if self.yaw_rate_max_deg_s is not None:
            limits.yaw_rate_max_rad_s = math.radians(self.yaw_rate_max_deg_s)
        return limits


class Rotor(Struct, frozen=True):
    """One rotor: its axis, in arms of the airframe, and the torque that its drag puts on the body."""

    name: str
    forward: float
    right: float
    spin: float
    """1 pushes the nose clockwise seen from above, -1 the other way."""


def _on_circle(name: str, angle_deg: float, spin: float) -> Rotor:
    return Rotor(name, math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg)), spin)


_LAYOUTS: dict[str, tuple[Rotor, ...]] = {
    "quad_x": (
        Rotor("front_left", 1.0, -1.0, 1.0),
        Rotor("front_right", 1.0, 1.0, -1.0),
        Rotor("rear_right", -1.0, 1.0, 1.0),
        Rotor("rear_left", -1.0, -1.0, -1.0),
    ),
    "hexa_x": (
        _on_circle("front_left", -30.0, 1.0),
        _on_circle("front_right", 30.0, -1.0),
        _on_circle("right", 90.0, 1.0),
        _on_circle("rear_right", 150.0, -1.0),
        _on_circle("rear_left", 210.0, 1.0),
        _on_circle("left", 270.0, -1.0),
    ),
}
"""Clockwise from the front left. The arm of a quad X is measured ahead and aside, that of a hexacopter from the middle."""


def rotors(airframe: Airframe) -> tuple[Rotor, ...]:
    """Return the rotors of an airframe."""
    return _LAYOUTS[airframe.layout]
