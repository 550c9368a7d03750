"""Convert a commanded velocity or lean to the sticks of PCMD. No I/O and no state.

The drone takes roll and pitch as fractions of a tilt angle, so a velocity needs a loop here: a PI controller on the measured
velocity with the drag of the commanded speed fed forward, solved for the tilt that gives that acceleration, limited as a vector.
The tilt follows its command late; commanding more than the tilt still lacks (`velocity_lead`) compensates part of that delay.
The drone itself closes the loops of climb and turn rate, which are only scaled here.

A lean is flown as it is: its acceleration is the tilt. Its trim becomes the loop's integral, so a velocity that follows begins
with the tilt that holds against the wind, and the integral keeps its direction over the ground while the nose turns.

The default drag, 0.43 1/s, is the regression of acceleration on tilt and speed in a flight under motion capture.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from drivers.ardrone.options import ArDroneOptions
from estimator.contracts.commands import Lean, Velocity
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import G_M_S2


class Sticks(Struct, frozen=True):
    """Stick positions, -1..1 with PCMD's signs: roll + right, pitch + backward (nose up), gaz + up, yaw + clockwise."""

    roll: float = 0.0
    pitch: float = 0.0
    gaz: float = 0.0
    yaw: float = 0.0


class LoopState(Struct, frozen=True):
    """The state of the loop: the integral's acceleration, m/s^2 forward and right."""

    forward_m_s2: float = 0.0
    right_m_s2: float = 0.0
    heading_rad: float | None = None
    """The heading for which it holds; None if it was not known."""

    def at_heading(self, heading_rad: float | None) -> LoopState:
        """Return the state in the axes of another heading: the wind stays where it is while the nose turns."""
        if heading_rad is None or self.heading_rad is None:
            return replace(self, heading_rad=self.heading_rad if heading_rad is None else heading_rad)
        c, s = math.cos(heading_rad - self.heading_rad), math.sin(heading_rad - self.heading_rad)
        x, y = self.forward_m_s2, self.right_m_s2
        return LoopState(c * x + s * y, c * y - s * x, heading_rad)


RESET = LoopState()


def acceleration_of(R_ned_body: Rotation) -> F64:
    """Return the acceleration that hovering thrust gives at this tilt, (2,) m/s^2 forward and right."""
    roll, pitch, _ = R_ned_body.rpy_rad
    return G_M_S2 * np.array([-math.tan(pitch), math.tan(roll) / math.cos(pitch)])


def step(
    state: LoopState, wanted: Velocity, v_level: F64, a_level: F64 | None, dt_s: float, options: ArDroneOptions
) -> tuple[LoopState, Sticks]:
    """Advance the loop by one period.

    Args:
        v_level: (3,) measured velocity, m/s forward, right, down; down is not used.
        a_level: (2,) acceleration of the present tilt (`acceleration_of`), m/s^2 forward and right; None for no lead.
        dt_s: time since the last step, for the integral, seconds; 0 on the first.

    Returns:
        The next state and the sticks. The integral is held while the tilt is at its limit and it would grow further.
    """
    error = np.asarray(wanted.v_level[:2] - v_level[:2])
    integral = np.array([state.forward_m_s2, state.right_m_s2])
    pushed = _within(integral + options.velocity_integral_1_s2 * max(0.0, dt_s) * error, options.velocity_integral_max_m_s2)
    feed_forward = options.velocity_gain_1_s * error + options.velocity_drag_1_s * wanted.v_level[:2]
    most_m_s2 = G_M_S2 * math.tan(options.euler_angle_max_rad)
    if float(np.hypot(*(feed_forward + pushed))) <= most_m_s2 or float(error @ (feed_forward + integral)) <= 0.0:
        integral = pushed
    accelerate = _within(feed_forward + integral, most_m_s2)
    if a_level is not None:
        accelerate = _within(accelerate + options.velocity_lead * (accelerate - a_level), most_m_s2)
    state = LoopState(float(integral[0]), float(integral[1]), state.heading_rad)
    return state, _sticks(accelerate, float(wanted.v_level[2]), wanted.yaw_rate_rad_s, options)


def lean(wanted: Lean, heading_rad: float | None, options: ArDroneOptions) -> tuple[LoopState, Sticks]:
    """Return the sticks of a lean, limited as a vector, and the loop's state from which a velocity would go on.

    Args:
        heading_rad: the present heading; None if it is not known.
    """
    most_m_s2 = G_M_S2 * math.tan(options.euler_angle_max_rad)
    trim = _within(wanted.trim_level, options.velocity_integral_max_m_s2)
    accelerate = _within(wanted.a_level + wanted.trim_level, most_m_s2)
    state = LoopState(float(trim[0]), float(trim[1]), heading_rad)
    return state, _sticks(accelerate, float(wanted.v_level[2]), wanted.yaw_rate_rad_s, options)


def _sticks(accelerate: F64, descend_m_s: float, yaw_rate_rad_s: float, options: ArDroneOptions) -> Sticks:
    """Return the sticks that give an acceleration, (2,) m/s^2 forward and right, a descent rate and a turn rate."""
    size = float(np.hypot(accelerate[0], accelerate[1]))
    tilt = math.atan2(size, G_M_S2) / options.euler_angle_max_rad
    forward, right = accelerate / size * tilt if size > 0 else (0.0, 0.0)
    return Sticks(
        roll=_unit(float(right)),
        pitch=_unit(-float(forward)),
        gaz=_unit(-descend_m_s / options.vz_max_m_s),
        yaw=_unit(yaw_rate_rad_s / options.yaw_rate_max_rad_s),
    )


def _within(v: F64, length: float) -> F64:
    """Return the vector, shortened to at most this length."""
    size = float(np.hypot(v[0], v[1]))
    return v * (length / size) if size > length else v


def _unit(x: float) -> float:
    return min(1.0, max(-1.0, x))
