"""Tune a stack's loops for a vehicle, as its owner does by the stack's autotune: none is faster than the motors' lag allows.

A stack's defaults are made for small propellers. A loop whose crossover times the motors' lag is too large swings, and so does
each one around it; the default stays where it has margin enough.
"""

import numpy as np
from msgspec import Struct, structs
from numpy.typing import NDArray

from sitl.emulators.autopilots.stand_in.cascade import VELOCITY_S, LoopGains
from sitl.vehicle.airframe import Airframe

STABILITY_MARGIN = 0.65
"""Least distance of a loop's frequency response from -1: a phase margin of 2 asin(0.325), 38 degrees, and a gain margin of
1 / 0.35, 2.9, at the least. Source: Åström & Murray, Feedback Systems, section 10.3: 0.5 to 0.8 is reasonable."""
_SOFTER = 0.98
"""Factor between two gains that are tried, fine beside the margin's own reach."""
_W_RAD_S = np.geomspace(0.1, 300.0, 1000)
"""Frequencies that are looked at: from below the slowest loop to above the lag of the fastest motor."""
_STEPS = 1.5
"""Delay of a loop in its own steps: what it commands is held for one, and acts in the next."""

Response = NDArray[np.complex128]


class OpenLoops(Struct, frozen=True):
    """Frequency responses (N,) of the open loops at `_W_RAD_S`, each with the loops inside it closed."""

    rate: Response
    angle: Response
    velocity: Response

    def margins(self) -> tuple[float, float, float]:
        """Return the stability margin of each."""
        rate, angle, velocity = (float(np.abs(1.0 + one).min()) for one in (self.rate, self.angle, self.velocity))
        return rate, angle, velocity


def open_loops(g: LoopGains, airframe: Airframe, step_s: float) -> OpenLoops:
    """Return the loops of roll on a body whose thrust follows the motors' lag, in small motion about hovering without drag."""
    s = 1j * _W_RAD_S
    behind = np.exp(-_STEPS * step_s * s) / (airframe.motor_lag_s * s + 1.0)
    turns = g.unit * airframe.arm_m * airframe.thrust_max_n * behind / (airframe.inertia_kg_m2[0] * s)
    rate = (g.rate_p + g.rate_i / s + g.rate_d * s) * turns / (g.gyro_s * s + 1.0)
    turned = (rate if g.of_errors else (g.rate_p + g.rate_i / s) * turns) / (1.0 + rate)
    angle = g.angle_p * turned / s
    fed = turned if g.angle_lag_s > 0.0 else 0.0
    leans = (angle + fed) / (1.0 + angle) / (g.angle_lag_s * s + 1.0)
    filtered = 1.0 / (VELOCITY_S * s + 1.0)
    wanted = (g.velocity_p + g.velocity_i / s) * (filtered if g.of_errors else 1.0) + g.velocity_d * s * filtered
    return OpenLoops(rate, angle, wanted * leans / s)


def tuned(gains: LoopGains, airframe: Airframe, step_s: float) -> LoopGains:
    """Return the gains with which each loop has its margin; those of a vehicle that has it stay.

    First the derivative of the turn rate is raised, which opposes the lag, as far as that helps rate and tilt; then each loop is
    softened, from the innermost outwards.

    Args:
        step_s: step of the loops.
    """

    def tilt_margin(g: LoopGains) -> float:
        return min(open_loops(g, airframe, step_s).margins()[:2])

    more = scaled(gains, ("rate_d",), 1.0 / _SOFTER)
    while tilt_margin(gains) < min(STABILITY_MARGIN, tilt_margin(more)):
        gains, more = more, scaled(more, ("rate_d",), 1.0 / _SOFTER)
    for loop, names in enumerate((("rate_p", "rate_i"), ("angle_p",), ("velocity_p", "velocity_i", "velocity_d"))):
        while open_loops(gains, airframe, step_s).margins()[loop] < STABILITY_MARGIN:
            gains = scaled(gains, names, _SOFTER)
    return gains


def scaled(gains: LoopGains, names: tuple[str, ...], factor: float) -> LoopGains:
    """Return the gains with some of them multiplied by a factor."""
    return structs.replace(gains, **{name: factor * getattr(gains, name) for name in names})
