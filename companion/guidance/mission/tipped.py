"""A drone that lies on the deck with turning motors: it is noticed by what holds it, and its motors are stopped.

Beyond the attitude that any law commands a drone in the air falls: nothing but the air's drag pushes it across its thrust. One
that lies on its side, or on its back, is held by the deck, with its whole weight. So it has tipped over if for a second its tilt
was beyond the limit, it hardly turned, and the accelerometer feels the weight along the vertical and a part of it that neither
thrust nor drag gives. And a contact was felt shortly before. An upset in the air is none of that, whatever the attitude; nor is
an attitude alone that lies, or an accelerometer alone.

The motors are stopped as after any contact (DOWN): by the vehicle's own landing and, beside an autopilot, by force in our mode
alone. A vehicle that a person or a failsafe flies is left to them. A drone that hangs over an edge below the limit is not judged
here: it may be leaning in flight, and only its person sees it.
"""

import math
from collections.abc import Sequence

import numpy as np

from companion.base.mission import Reason, ReasonCause
from companion.guidance.controller import Impact
from estimator.contracts.motion import G_M_S2
from estimator.contracts.time import MonoNs, seconds_between
from estimator.integrity.parity import Bin

LEAST_RAD = math.radians(40.0)
"""Least tilt beyond what guidance flies, rad: a PX4 lay at 42 to 53 degrees on a rotor and two feet."""
BEYOND = 1.5
"""The same as a multiple of the largest tilt that guidance commands: an attitude loop overshoots by less."""
HELD_M_S2 = 6.0
"""Least force across the thrust, or against it, that is no drag, m/s^2: that is 5.7 where 30 degrees hold against the wind."""
_WEIGHT = 0.8  # least share of the weight along the vertical
_TURNS_RAD_S = 1.5  # largest turn
_BINS = 10  # number of bins of a tenth of a second
_FELT_S = 10.0
"""Time before it lies there within which the contact was felt, s: a rotor that touches turns a vehicle over within two."""


def tipped(bins: Sequence[Bin], felt: Sequence[Impact | None], tilt_max_rad: float) -> Reason | None:
    """Return that the vehicle lies on what it touched; None if it does not, or nothing shows it.

    Args:
        bins: of accelerometer, gyro and attitude, oldest first.
        felt: the newest contacts, doubtful ones too.
        tilt_max_rad: largest tilt that guidance commands.
    """
    newest, limit_rad = bins[-_BINS:], max(LEAST_RAD, BEYOND * tilt_max_rad)
    if len(newest) < _BINS or newest[-1].up[2] > math.cos(limit_rad) or any(math.hypot(*b.w) > _TURNS_RAD_S for b in newest):
        return None
    f, down = (np.mean([getattr(b, name) for b in newest], axis=0) for name in ("f", "up"))
    down /= float(np.linalg.norm(down))
    held = float(np.hypot(np.hypot(f[0], f[1]), max(0.0, f[2])))
    if down[2] > math.cos(limit_rad) or held < HELD_M_S2 or -float(f @ down) < _WEIGHT * G_M_S2:
        return None
    since = MonoNs(newest[0].t)
    if not any(i is not None and seconds_between(i.at, since) <= _FELT_S for i in felt):
        return None
    tilt_rad = math.acos(max(-1.0, float(down[2])))
    return Reason(ReasonCause.TIPPED, math.degrees(tilt_rad), math.degrees(limit_rad))
