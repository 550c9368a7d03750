"""The thesis' position controller (`pid`): it computes a velocity from the pad's estimated and wanted positions.

Source: Sundvoll 2020, sec. 4.5 (one PID for each of x, y, z and heading; table 4.2), with the derivative per second and on the
measurement (the thesis' code took it per step and on the error), heading errors wrapped, and a hover instead of further flight
while the estimator is silent.

Two more faults of the thesis' way are mended. Its velocity was over the ground, so the deck rose into a drone that held its
height; here the deck's own vertical speed is added. And it hovered while it did not know what to do, which forgot the tilt
against the wind; here the integral outlives a hover, and the driver keeps the trim.
"""

import math

import numpy as np
from msgspec import Struct, field, structs

from companion.guidance.controller import Knowledge, Target
from companion.settings.guidance import PidOptions
from estimator.contracts.commands import Command, Hover, Velocity
from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.time import MonoNs, seconds_between

_DT_MAX_S = 0.2
"""Longest time that one step integrates over, seconds, even if the controller was not called for longer."""


class Pid(Struct, frozen=True, eq=False):
    """The controller's memory."""

    integral: F64 = field(default_factory=lambda: np.zeros(4))
    """(4,) m s, m s, m s, rad s: the integrals of the errors forward, right, down and in heading."""
    last: MonoNs | None = None
    """Time at which the controller last steered; None before."""


def _limited(u: F64, gains: PidOptions) -> F64:
    """Return the nearest command within the limits, (4,) m/s and rad/s; the horizontal direction is kept."""
    turn_max_rad_s = math.radians(gains.turn_max_deg_s)
    shrink = gains.speed_max_m_s / max(gains.speed_max_m_s, math.hypot(u[0], u[1]))
    return np.array(
        [
            shrink * u[0],
            shrink * u[1],
            min(gains.descent_rate_max_m_s, max(-gains.climb_max_m_s, u[2])),
            min(turn_max_rad_s, max(-turn_max_rad_s, u[3])),
        ]
    )


class PidController:
    """The controller.

    Args:
        options: gains and limits.
        heaves: whether the deck's vertical speed is added here; False for a vehicle whose driver adds it.
    """

    name = "pid"
    climb_max_m_s: None = None
    """The deck's own speed is added after its limits; the vehicle alone limits the sum."""

    def __init__(self, options: PidOptions, *, heaves: bool = True) -> None:
        self._options, self._heaves = options, heaves

    def start(self) -> Pid:
        """Return the memory before the first cycle."""
        return Pid()

    def ahead(self, memory: Pid, knowledge: Knowledge, seconds: float) -> None:
        """Return None: it does not model the commands under way."""

    def step(self, memory: Pid, now: MonoNs, knowledge: Knowledge, target: Target | None) -> tuple[Pid, Command]:
        """Run one guidance cycle; `Hover` without a target or an estimate, with frozen integrals.

        Errors are in level axes, so flying needs no heading; without one (`yaw_rad` None) it does not turn. The mission decides
        whether the estimate is good enough. Anti-windup: an axis integrates only while its command is free or the error leads
        out of the limit.
        """
        estimate = knowledge.relative
        if target is None or estimate is None:
            return memory, Hover()
        wanted, along = np.array(target.d_body_pad_level), np.array(target.v_body_level)
        if target.descent_rate_m_s is not None:
            wanted[2], along[2] = estimate.height_m, target.descent_rate_m_s
        gains, silence_s = _within(self._options, target), 0.0 if memory.last is None else seconds_between(memory.last, now)
        dt = min(max(0.0, silence_s), _DT_MAX_S)
        integral = np.zeros(4) if silence_s > gains.forget_after_s else memory.integral
        yaw_error = 0.0
        if estimate.yaw_rad is not None and target.yaw_rad is not None:
            yaw_error = wrap_pi(target.yaw_rad - estimate.yaw_rad)
        error = np.append(estimate.d_body_pad_level - wanted, yaw_error)
        # The rate is that of the measurement, not of the error, so a jump of the target causes no kick.
        rate = estimate.v_pad_level + along

        level, down, turn = gains.horizontal, gains.vertical, gains.heading
        soft = max(gains.soft_above_m / max(float(wanted[2]), gains.soft_above_m), gains.soft_least)
        kp = np.array([soft * level.kp, soft * level.kp, down.kp, turn.kp])
        ki = np.array([soft * level.ki, soft * level.ki, down.ki, turn.ki])
        kd = np.array([soft * level.kd, soft * level.kd, down.kd])

        u = kp * error + ki * integral + np.append(along + kd * rate, 0.0)
        allowed = _limited(u, gains)
        saturated = np.sign(u - allowed) == np.sign(error)
        integral = np.where(saturated, integral, integral + error * dt)
        most = np.divide(gains.integral_max_m_s, ki, out=np.zeros(4), where=ki > 0.0)
        v = np.array(allowed[:3])
        if self._heaves and knowledge.deck is not None:
            v[2] += knowledge.deck.v_level[2]
        return Pid(np.clip(integral, -most, most), now), Velocity(v, float(allowed[3]))


def _within(options: PidOptions, target: Target) -> PidOptions:
    """Return the options with the target's limits: the integrals must know what is truly flown."""
    speed = min(options.speed_max_m_s, target.speed_max_m_s)
    if target.descent_rate_m_s is not None:
        return structs.replace(options, speed_max_m_s=speed)
    rate = target.vertical_rate_max_m_s
    return structs.replace(
        options,
        speed_max_m_s=speed,
        climb_max_m_s=min(options.climb_max_m_s, rate),
        descent_rate_max_m_s=min(options.descent_rate_max_m_s, rate),
    )
