"""One step of the observer of what pushes the vehicle sideways, one axis at a time (`companion.guidance.disturbance`)."""

from __future__ import annotations

from msgspec import Struct

from companion.guidance.disturbance import ObserverGains


class Observed(Struct, frozen=True):
    """The state of one axis."""

    p: float
    w: float
    d: float
    b: float


def observed(
    x: Observed, gains: ObserverGains, dt: float, a_deck: float, a_lean: float, p: float, w: float, a_body: float | None
) -> Observed:
    """Return the state of one axis after `dt` s.

    Args:
        a_deck: acceleration of the deck, m/s^2.
        a_lean: reported tilt as an acceleration, mean over the step.
        p, w: place and speed of the pad against the body by the filter, m and m/s.
        a_body: levelled acceleration of the body; None if it is not known now.
    """
    push = a_deck - a_lean - x.d
    p1, w1 = x.p + dt * x.w + 0.5 * dt * dt * push, x.w + dt * push
    ep, ew = p - p1, w - w1
    ea = 0.0 if a_body is None else a_body - a_lean - x.d - x.b
    (pp, pw, pa), (wp, ww, wa), (dp, dw, da), (bp, bw, ba) = gains.rows
    return Observed(
        p1 + pp * ep + pw * ew + pa * ea,
        w1 + wp * ep + ww * ew + wa * ea,
        x.d + dp * ep + dw * ew + da * ea,
        x.b + bp * ep + bw * ew + ba * ea,
    )
