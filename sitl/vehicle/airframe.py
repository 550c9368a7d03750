"""The figures of the simulated vehicle: body, rotors, inner loops, own estimator, feet."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True, slots=True)
class Loops:
    """Gains of the inner loops: P and D as in the thesis' simulator (hector_quadrotor's controller), the rest as said."""

    tilt_p: float = 10.0
    """1/s^2: angular acceleration per rad of roll or pitch error."""
    tilt_d: float = 5.0
    """1/s."""
    tilt_max_rad: float = 0.5
    """Largest roll or pitch that any loop may ask for."""
    yaw_rate_p: float = 2.0
    """1/s."""
    disturbance_s: float = 0.1
    """Time in which the loops take up a torque that they did not ask for (`physics/vehicle.c`; assumed). The thesis' loops
    have no such part and overturn with one motor at 80 %; autopilots have an integral (ATC_RAT_RLL_I, MC_ROLLRATE_I)."""
    velocity_p: float = 5.0
    """1/s: acceleration per m/s of horizontal velocity error while hovering."""
    velocity_d: float = 1.0
    """Per m/s^2 of acceleration."""
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
    """1/s: climb rate asked per metre away from the height held."""


@dataclass(frozen=True, slots=True)
class Avionics:
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
    """Whether the optical flow measures against the deck while over it. If False, it always measures against the still water."""


@dataclass(frozen=True, slots=True)
class Feet:
    """Four elastic feet, and the friction under them."""

    half_base_m: float = 0.13
    """Distance of each foot ahead or astern of the body's origin, and to the side of it."""
    below_m: float = 0.045
    """Distance of the feet below the body's origin: its height over the deck when landed, as in the thesis' ground truth."""
    top_m: float = 0.06
    """Height of the hull's top over the body's origin: the vehicle lies on it after it came down upside down."""
    stiffness_n_m: float = 6000.0
    """Stiffness of all four feet together: they give 2.4 mm when landed."""
    damping_ratio: float = 0.7
    """Damping over critical damping: there is nearly no rebound."""
    friction: float = 0.6
    """Coulomb's coefficient, foam or rubber on painted steel (assumed)."""


@dataclass(frozen=True, slots=True)
class Airframe:
    """The figures that do not change in flight. Mass, inertia and largest force are those of the thesis' simulator."""

    mass_kg: float = 1.477
    inertia_kg_m2: tuple[float, float, float] = (0.01152, 0.01152, 0.0218)
    """Principal moments about x, y, z."""
    thrust_max_n: float = 30.0
    torque_max_n_m: tuple[float, float, float] = (1.0, 1.0, 0.3)
    motor_lag_s: float = 0.05
    """First-order lag of thrust and torque behind their commands."""
    command_delay_s: float = 0.04
    """Delay from the arrival of a stick command to its effect on the loops."""
    layout: Literal["quad_x", "hexa_x"] = "quad_x"
    """Four rotors in an X, or six of which two stand at the sides (`sitl.vehicle.rotors`)."""
    arm_m: float = 0.127
    """Distance of each rotor's axis ahead or astern and to the side: diagonal rotors are 0.36 m apart. Of six rotors: distance
    from the middle."""
    rotor_radius_m: float = 0.10
    ground_effect: Literal["body", "rotors"] = "body"
    """Whether the ground effect is that of what lies under the body's middle, or each rotor's own over the deck's edge."""
    rotors_above_m: float = 0.03
    """Height of the rotor plane above the body's origin."""
    yaw_torque_per_thrust_m: float = 0.02
    """Drag torque of a rotor over its thrust (assumed)."""
    drag_per_s: tuple[float, float, float] = (0.35, 0.35, 0.2)
    """Acceleration against the air per m/s of airspeed, along the body's axes: linear rotor drag (Martin & Salaun, The true
    role of accelerometer feedback in quadrotor control, ICRA 2010, eq. 9)."""
    landing_speed_m_s: float = 0.4
    take_off_speed_m_s: float = 0.5
    take_off_height_m: float = 1.0
    motors_off_after_s: float = 0.2
    """Time of contact after which an automatic landing stops the motors."""
    tilt_cut_off_rad: float = 1.2
    """Motors stop beyond this tilt, as the real drone's do."""
    loops: Loops = field(default_factory=Loops)
    avionics: Avionics = field(default_factory=Avionics)
    feet: Feet = field(default_factory=Feet)


@dataclass(slots=True)
class StickLimits:
    """The values that a full stick asks for. They can be set in flight."""

    euler_angle_max_rad: float = 0.21
    vz_max_m_s: float = 0.7
    yaw_rate_max_rad_s: float = 1.745
    """The AR.Drone's defaults: 12 degrees, 700 mm/s, 100 degrees/s."""
