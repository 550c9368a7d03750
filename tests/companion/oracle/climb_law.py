"""From the deck's heave to the vertical speed to command: follow the deck as it will be when the command arrives.

The vehicle's vertical speed is predicted through the commands under way, the deck's by the forecast of its rate. The command is
the one that brings the first to the second plus the wanted rate against the deck, through the vehicle's own lag:
    u = v + lag (a_wanted + k (v_wanted - v) - d)
d is what accelerates the body beside its answer to commands (ground effect, draught, an integral in its own loop), by the
accelerometer.
"""

from __future__ import annotations

import math

from companion.settings.response import ClimbResponse

SPEED_GAIN_1_S = 4.0
HEIGHT_GAIN_1_S = 1.5
DISTURBANCE_S = 0.15
"""Time in which the disturbance is learned, s."""
DISTURBANCE_MAX_M_S2 = 1.5


def pushed(d: float, a_down: float, v: float, arrived: float, period_s: float, response: ClimbResponse) -> float:
    """Return what accelerates the body beside its answer to commands, m/s^2 down, after one more period.

    Args:
        d: the same before.
        a_down: levelled acceleration of the body, m/s^2 down.
        v: its vertical speed, m/s down.
        arrived: the command that acts now, m/s down.
    """
    beside = a_down - (arrived - v) / response.lag_s
    d += (1.0 - math.exp(-period_s / DISTURBANCE_S)) * (beside - d)
    return min(DISTURBANCE_MAX_M_S2, max(-DISTURBANCE_MAX_M_S2, d))


def predicted(v: float, d: float, under_way: tuple[float, ...], period_s: float, response: ClimbResponse) -> tuple[float, float]:
    """Return the vertical speed and the way made when the commands under way have acted.

    Args:
        v: vertical speed now, m/s down.
        d: disturbance, m/s^2 down.
        under_way: commands that have not acted, newest first, m/s down.
    """
    way = 0.0
    for u in reversed(under_way):
        a = (u - v) / response.lag_s + d
        way += period_s * (v + 0.5 * period_s * a)
        v += period_s * a
    return v, way


def climb_command(
    response: ClimbResponse,
    v: float,
    d: float,
    v_deck: float,
    a_deck: float,
    height_error_m: float,
    rate_m_s: float | None,
    rate_max_m_s: float,
) -> float:
    """Return the vertical speed to command, m/s down, not limited yet.

    Args:
        v: the predicted vertical speed, m/s down.
        d: disturbance, m/s^2 down.
        v_deck, a_deck: vertical speed and acceleration of the deck at that time, down.
        height_error_m: height over the deck at that time less the wanted one.
        rate_m_s: wanted rate against the deck, down positive; None to fly to the wanted height.
        rate_max_m_s: largest rate with which it is flown to.
    """
    if rate_m_s is not None:
        wanted, a = v_deck + rate_m_s, a_deck
    else:
        closing = HEIGHT_GAIN_1_S * height_error_m
        limited = min(rate_max_m_s, max(-rate_max_m_s, closing))
        wanted = v_deck + limited
        a = a_deck - (HEIGHT_GAIN_1_S * (v - v_deck) if limited == closing else 0.0)
    return v + response.lag_s * (a + SPEED_GAIN_1_S * (wanted - v) - d)
