"""Navdata options 0 to 10: attitude, raw and physical measurements, references, motors, altitude.

Source: Parrot SDK 2.0.1 `navdata_common.h`, checked against a datagram of firmware 2.4.8. Angles of the drone: theta nose up,
phi right side down, psi clockwise from above.
"""

from typing import Annotated

from msgspec import Struct

from drivers.ardrone.navdata_layout import F32, I16, I32, U16, U32, Floats, Ints, option

_ZERO3 = (0.0, 0.0, 0.0)
_ZERO9 = (0.0,) * 9


@option(0)
class Demo(Struct, frozen=True):
    """The short summary, which is also sent in demo mode."""

    ctrl_state: U32
    """The `ControlState` in the high half and its detail in the low half."""
    battery_percent: U32
    theta_mdeg: F32
    phi_mdeg: F32
    psi_mdeg: F32
    altitude_mm: I32
    vx_mm_s: F32
    """The forward velocity in the level frame, mm/s."""
    vy_mm_s: F32
    """The velocity to the right in the level frame, mm/s."""
    vz_mm_s: F32
    """The vertical velocity, which was 0 in every flight seen and is not usable."""
    num_frames: U32 = 0
    detection_camera_rot: Annotated[Floats, "9f"] = _ZERO9
    detection_camera_trans: Annotated[Floats, "3f"] = _ZERO3
    detection_tag_index: U32 = 0
    detection_camera_type: U32 = 0
    drone_camera_rot: Annotated[Floats, "9f"] = _ZERO9
    drone_camera_trans: Annotated[Floats, "3f"] = _ZERO3


@option(1)
class NavdataTime(Struct, frozen=True):
    """The drone's clock: seconds in the high 11 bits, microseconds in the low 21; wraps every 2048 s."""

    time: U32

    @staticmethod
    def of_us(time_us: int) -> "NavdataTime":
        """Return the option for a time of the drone's clock, microseconds, wrapped as the drone wraps it."""
        seconds, micros = divmod(time_us, 1_000_000)
        return NavdataTime((seconds % 2048) << 21 | micros)

    @property
    def time_us(self) -> int:
        """The time of the drone's clock, microseconds, from 0 to 2048 s."""
        return (self.time >> 21) * 1_000_000 + (self.time & 0x1FFFFF)


@option(2)
class RawMeasures(Struct, frozen=True):
    """Converter counts, battery, and the ultrasound's last echo."""

    raw_accs: Annotated[Ints, "3H"] = (0, 0, 0)
    raw_gyros: Annotated[Ints, "3h"] = (0, 0, 0)
    raw_gyros_110: Annotated[Ints, "2h"] = (0, 0)
    vbat_raw_mv: U32 = 0
    us_debut_echo: U16 = 0
    us_fin_echo: U16 = 0
    us_association_echo: U16 = 0
    us_distance_echo: U16 = 0
    us_courbe_temps: U16 = 0
    us_courbe_valeur: U16 = 0
    us_courbe_ref: U16 = 0
    flag_echo_ini: U16 = 0
    nb_echo: U16 = 0
    sum_echo: U32 = 0
    alt_temp_raw_mm: I32 = 0
    gradient: I16 = 0


@option(3)
class PhysMeasures(Struct, frozen=True):
    """Calibrated accelerometer (at rest and level about (0, 0, -1000) mg) and rate gyro, in forward-right-down axes."""

    accs_temp_c: F32
    gyro_temp: U16
    phys_accs_mg: Annotated[Floats, "3f"]
    phys_gyros_deg_s: Annotated[Floats, "3f"]
    alim3v3: U32 = 0
    vref_epson: U32 = 0
    vref_idg: U32 = 0


@option(4)
class GyrosOffsets(Struct, frozen=True):
    """Offsets of the rate gyros as estimated by the drone."""

    offset_g: Annotated[Floats, "3f"] = _ZERO3


@option(5)
class EulerAngles(Struct, frozen=True):
    """The tilt that the accelerometer alone gives, millidegrees."""

    theta_a_mdeg: F32 = 0.0
    phi_a_mdeg: F32 = 0.0


@option(6)
class References(Struct, frozen=True):
    """The setpoints of the inner loops."""

    ref_theta: I32 = 0
    ref_phi: I32 = 0
    ref_theta_i: I32 = 0
    ref_phi_i: I32 = 0
    ref_pitch: I32 = 0
    ref_roll: I32 = 0
    ref_yaw: I32 = 0
    ref_psi: I32 = 0
    vx_ref: F32 = 0.0
    vy_ref: F32 = 0.0
    theta_mod: F32 = 0.0
    phi_mod: F32 = 0.0
    k_v_x: F32 = 0.0
    k_v_y: F32 = 0.0
    k_mode: U32 = 0
    ui_time: F32 = 0.0
    ui_theta: F32 = 0.0
    ui_phi: F32 = 0.0
    ui_psi: F32 = 0.0
    ui_psi_accuracy: F32 = 0.0
    ui_seq: I32 = 0


@option(7)
class Trims(Struct, frozen=True):
    """Flat-trim results, millidegrees."""

    angular_rates_trim_r: F32 = 0.0
    euler_angles_trim_theta: F32 = 0.0
    euler_angles_trim_phi: F32 = 0.0


@option(8)
class RcReferences(Struct, frozen=True):
    """Pilot commands as received."""

    rc_ref_pitch: I32 = 0
    rc_ref_roll: I32 = 0
    rc_ref_yaw: I32 = 0
    rc_ref_gaz: I32 = 0
    rc_ref_ag: I32 = 0


@option(9)
class Pwm(Struct, frozen=True):
    """The motor commands and the terms that they are made of."""

    motor: Annotated[Ints, "4B"] = (0, 0, 0, 0)
    """The commands of the front left, front right, rear right and rear left motor, 0..255."""
    sat_motor: Annotated[Ints, "4B"] = (255, 255, 255, 255)
    gaz_feed_forward: F32 = 0.0
    gaz_altitude: F32 = 0.0
    altitude_integral: F32 = 0.0
    vz_ref: F32 = 0.0
    u_pitch: I32 = 0
    u_roll: I32 = 0
    u_yaw: I32 = 0
    yaw_u_i: F32 = 0.0
    u_pitch_planif: I32 = 0
    u_roll_planif: I32 = 0
    u_yaw_planif: I32 = 0
    u_gaz_planif: F32 = 0.0
    current_motor: Annotated[Ints, "4H"] = (0, 0, 0, 0)
    altitude_prop: F32 = 0.0
    altitude_der: F32 = 0.0


@option(10)
class Altitude(Struct, frozen=True):
    """The altitude loop; `altitude_raw_mm` is the ultrasound's own reading along the body's down axis."""

    altitude_vision_mm: I32 = 0
    altitude_vz: F32 = 0.0
    altitude_ref_mm: I32 = 0
    altitude_raw_mm: I32 = 0
    obs_acc_z: F32 = 0.0
    obs_alt: F32 = 0.0
    obs_x: Annotated[Floats, "3f"] = _ZERO3
    obs_state: U32 = 0
    est_vb: Annotated[Floats, "2f"] = (0.0, 0.0)
    est_state: U32 = 0
