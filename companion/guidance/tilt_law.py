"""Tilt law that brings the vehicle over the pad: a linear-quadratic regulator that knows the commands still under way.

The state of one axis is [p, w, a, a', f, u1 .. un]: place and speed of the pad against the body, tilt and its rate less the tilt
that holds the body over the deck (the reference), the rotors' lag, and the commands that have not reached the vehicle. With the
commands under way in the state the regulator is a Smith predictor: it acts on where the vehicle will be when its command arrives.
Sources: Anderson & Moore, Optimal Control: Linear Quadratic Methods, 1990, sec. 2.4; Smith, A controller to overcome dead time,
ISA J. 6(2), 1959; Mirkin & Raskin, Every stabilizing dead-time controller has an observer-predictor-based structure, Automatica
39(10), 2003.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from msgspec import structs

from companion.guidance.riccati import regulator
from companion.guidance.tilt_model import tilt_model
from companion.settings.response import TiltResponse


class TiltWeights(NamedTuple):
    """The regulator's weights: amounts of each quantity that cost the same."""

    p_m: float = 0.006
    w_m_s: float = 4.1
    u_m_s2: float = 0.3
    lean_m: float = 0.01
    """Place that a lean of 1 m/s^2 beyond the one that holds counts as, m.

    A vehicle that leans touches with the lower feet, and levels over them away from where it leaned: by 0.01 m where they are
    0.1 m below it. It damps as well.
    """


class TiltGains(NamedTuple):
    """u = reference - (p x p + w x w + a x (a - reference) + ...)."""

    p: float
    w: float
    a: float
    rate: float
    lag: float
    under_way: tuple[float, ...]
    """Gains of the commands under way, newest first."""


@lru_cache(maxsize=256)
def tilt_gains(response: TiltResponse, weights: TiltWeights, period_s: float, *, delay_line: bool = True) -> TiltGains:
    """Return the gains for a vehicle, solved once in a process: a campaign flies the same vehicle again and again.

    Args:
        delay_line: whether commands under way are in the state; False takes the vehicle to answer at once.

    Raises:
        ValueError: there are no gains that stabilise such a vehicle.
    """
    model = tilt_model(response if delay_line else structs.replace(response, delay_s=0.0), period_s)
    n, m = model.A.shape[0], model.states
    stands, Q = np.zeros(n), np.zeros((n, n))
    stands[0], stands[2] = 1.0, weights.lean_m
    Q[1, 1] = weights.w_m_s**-2
    Q += np.outer(stands, stands) * weights.p_m**-2
    K = regulator(model.A, model.B[:, None], Q, np.array([[weights.u_m_s2**-2]]))[0].tolist()
    lag = K[4] if m == 5 else 0.0
    return TiltGains(K[0], K[1], K[2], K[3], lag, tuple(K[m:]))
