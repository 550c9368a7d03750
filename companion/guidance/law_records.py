"""What the law that follows the deck gives to the native core and reads from it (estimator/core/law/law.c).

The core has the mathematics of a cycle, and the law's memory in its own layout. Here are the parameters and gains, made once, and
the numbers of each cycle.
"""

from __future__ import annotations

import struct
from functools import lru_cache

import numpy as np
from estimator.core.abi import UNDER_WAY_MAX

from companion.guidance.controller import Knowledge, Target
from companion.guidance.disturbance import ObserverGains
from companion.guidance.tilt_law import TiltGains
from companion.guidance.view import FieldOfView
from companion.settings.response import ClimbResponse, TiltResponse
from estimator.contracts.geometry import F64
from estimator.contracts.motion import BodyMotion
from estimator.core.interface import size_of
from estimator.core.library import address
from estimator.core.records import record
from estimator.ekf import Forecast

MEMORY_SIZE, COMMAND_SIZE = size_of("law_memory"), size_of("law_command")
_CYCLE = struct.Struct("8q33d")
_NOWHERE = (0.0, 0.0, 0.0)


class LawRecord:
    """Words that stay as they are, at an address for the core."""

    __slots__ = ("address", "words")

    def __init__(self, words: F64) -> None:
        self.words, self.address = words, address(words)


def packed_params(
    tilt: TiltResponse,
    climb: ClimbResponse,
    period_s: float,
    remembered: int,
    view: FieldOfView | None = None,
    *,
    looks_ahead: bool,
    over_ground: bool,
) -> LawRecord:
    """Return the core's `law_params`.

    Args:
        remembered: number of commands under way that are kept.
        view: None for no limit by it.
        looks_ahead: whether the deck's motion is known.

    Raises:
        ValueError: more commands are under way than the core keeps.
    """
    if remembered > UNDER_WAY_MAX:
        raise ValueError(f"{remembered} commands of {period_s} s are under way, and the law keeps {UNDER_WAY_MAX}")
    seen = view or FieldOfView(0.0, 0.0, 0.0, 0.0)
    values = {
        "remembered": remembered, "over_ground": over_ground, "keeps_in_view": view is not None, "looks_ahead": looks_ahead,
        "period_s": period_s, "frequency_rad_s": tilt.frequency_rad_s, "damping": tilt.damping, "lag_s": tilt.lag_s,
        "tilt_max_m_s2": tilt.max_m_s2, "climb_lag_s": climb.lag_s, "climb_max_m_s": climb.max_m_s,
        "view_forward_m": seen.forward_m, "view_right_m": seen.right_m,
        "half_forward_rad": seen.half_forward_rad, "half_right_rad": seen.half_right_rad,
    }  # fmt: skip
    return LawRecord(record("law_params", values))


def packed_gains(gains: TiltGains, tilt_delay: int, climb_delay: int, slowness_s: float) -> LawRecord:
    """Return the core's `law_gains`.

    Args:
        tilt_delay, climb_delay: after how many periods a command acts.
        slowness_s: how late a slowly changing tilt is behind its command.
    """
    values = {
        "n": len(gains.under_way), "tilt_delay": tilt_delay, "climb_delay": climb_delay, "slowness_s": slowness_s,
        "p": gains.p, "w": gains.w, "a": gains.a, "rate": gains.rate, "lag": gains.lag, "under_way": gains.under_way,
    }  # fmt: skip
    return LawRecord(record("law_gains", values))


def packed_observer(gains: ObserverGains) -> LawRecord:
    """Return the observer's gains as the core reads them, row by row."""
    return LawRecord(np.array(gains.rows))


def packed_cycle(
    knowledge: Knowledge, body: BodyMotion, target: Target | None, dt: float, share: float, *, goes_on: bool
) -> bytes:
    """Return the core's `law_cycle`; the knowledge has an estimate.

    Args:
        target: None while somebody else commands.
        dt: time since the cycle before, s.
        share: of the gains that are flown by, 0 to 1.
        goes_on: whether that cycle was not too long ago.
    """
    relative, deck, forecast = knowledge.relative, knowledge.deck, knowledge.forecast
    assert relative is not None
    yaw, horizons, age_s = relative.yaw_rad, 0, 0.0
    if forecast is not None:
        horizons, age_s = forecast.horizons_s.size, (knowledge.at - forecast.at) / 1e9
    v_deck, a_deck = (_NOWHERE, _NOWHERE) if deck is None else (deck.v_level.tolist(), deck.a_level.tolist())
    wanted, rate, rate_max, speed_max, wanted_yaw, lean_max = (
        (_NOWHERE, None, 0.0, 0.0, None, None)
        if target is None
        else (
            target.d_body_pad_level.tolist(), target.descent_rate_m_s, target.vertical_rate_max_m_s, target.speed_max_m_s,
            target.yaw_rad, target.lean_max_rad,
        )
    )  # fmt: skip
    return _CYCLE.pack(
        goes_on, target is not None, deck is not None, horizons, yaw is not None, rate is not None, wanted_yaw is not None,
        lean_max is not None,
        dt, share, age_s, body.heading_rad, *relative.d_body_pad_level.tolist(), *relative.v_pad_level.tolist(), yaw or 0.0,
        *body.a_level.tolist(), *body.w_body.tolist(), *body.lean_m_s2, *v_deck, *a_deck,
        *wanted, rate or 0.0, rate_max, speed_max, wanted_yaw or 0.0, lean_max or 0.0,
    )  # fmt: skip


@lru_cache(maxsize=4)
def packed_course(forecast: Forecast | None) -> tuple[bytes, bytes]:
    """Return a forecast's horizons and the rates there as the core reads them; a forecast serves some ten cycles."""
    return (b"", b"") if forecast is None else (forecast.horizons_s.tobytes(), forecast.v_pad_level.tobytes())
