"""The thesis' position controller as one of the controllers (`pid`): the same gains, flown against the deck.

Two faults of the thesis' way are mended. Its velocity was over the ground, so the deck rose into a drone that held its height;
here the deck's own vertical speed is added. And it hovered while it did not know what to do, which forgot the tilt against the
wind; here the integral outlives a hover, and the driver keeps the trim.
"""

import numpy as np
from msgspec import structs

from companion.guidance.controller import Knowledge, Target
from companion.guidance.pid import Pid, SetPoint, pid_step
from companion.settings.guidance import PidOptions
from estimator.contracts.commands import Command, Hover, Velocity
from estimator.contracts.time import MonoNs


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
        return Pid.start()

    def ahead(self, memory: Pid, knowledge: Knowledge, seconds: float) -> None:
        """Return None: it does not model the commands under way."""

    def step(self, memory: Pid, now: MonoNs, knowledge: Knowledge, target: Target | None) -> tuple[Pid, Command]:
        """Run one guidance cycle; `Hover` without a target or an estimate."""
        estimate = knowledge.relative
        if target is None or estimate is None:
            return memory, Hover()
        wanted, along = np.array(target.d_body_pad_level), np.array(target.v_body_level)
        if target.descent_rate_m_s is not None:
            wanted[2], along[2] = estimate.height_m, target.descent_rate_m_s
        # The mission decides whether the estimate is good enough; the controller flies its target.
        given = structs.replace(estimate, sighted=now, at=now, consistent=True)
        limited = _within(self._options, target)
        memory, command = pid_step(memory, limited, now, given, SetPoint(wanted, target.yaw_rad, along), 1.0)
        if not isinstance(command, Velocity):
            return memory, command
        v = np.array(command.v_level)
        if self._heaves and knowledge.deck is not None:
            v[2] += knowledge.deck.v_level[2]
        return memory, Velocity(v, command.yaw_rate_rad_s)


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
