"""Records that the deck-following law exchanges with the native core (estimator/core/law/law.c).

The core has the mathematics of a cycle, and the law's memory. Here are the law as it is flown, made once, and the numbers of each
cycle.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from companion.guidance.controller import FieldOfView, Knowledge, Target
from companion.guidance.law.gains import ObserverGains, TiltGains
from companion.settings.guidance import ClimbResponse, TiltResponse
from estimator.contracts.motion import BodyMotion
from estimator.core.abi import DL_UNDER_WAY_MAX
from estimator.core.library import CORE
from estimator.ekf import Forecast

LawParams = Mapping[str, Any]
"""The core's `dl_law_params`, by name."""


def law_params(
    tilt: TiltResponse,
    climb: ClimbResponse,
    period_s: float,
    remembered: int,
    view: FieldOfView | None = None,
    *,
    looks_ahead: bool,
    over_ground: bool,
) -> LawParams:
    """Return what the core's law is made for.

    Args:
        remembered: number of commands under way that are kept.
        view: None for no limit by it.
        looks_ahead: whether the deck's motion is known.

    Raises:
        ValueError: more commands are under way than the core keeps.
    """
    if remembered > DL_UNDER_WAY_MAX:
        raise ValueError(f"{remembered} commands of {period_s} s are under way, and the law keeps {DL_UNDER_WAY_MAX}")
    seen = view or FieldOfView(0.0, 0.0, 0.0, 0.0)
    return {
        "remembered": remembered, "over_ground": over_ground, "keeps_in_view": view is not None, "looks_ahead": looks_ahead,
        "period_s": period_s, "frequency_rad_s": tilt.frequency_rad_s, "damping": tilt.damping, "lag_s": tilt.lag_s,
        "tilt_max_m_s2": tilt.max_m_s2, "climb_lag_s": climb.lag_s, "climb_max_m_s": climb.max_m_s,
        "view_forward_m": seen.forward_m, "view_right_m": seen.right_m,
        "half_forward_rad": seen.half_forward_rad, "half_right_rad": seen.half_right_rad,
    }  # fmt: skip


def law_gains(gains: TiltGains, tilt_delay: int, climb_delay: int, slowness_s: float) -> Mapping[str, Any]:
    """Return the core's `dl_law_gains`, by name.

    Args:
        tilt_delay, climb_delay: after how many periods a command acts.
        slowness_s: how late a slowly changing tilt is behind its command.
    """
    given = {"n": len(gains.under_way), "tilt_delay": tilt_delay, "climb_delay": climb_delay, "slowness_s": slowness_s}
    return given | gains._asdict()


def law_in_use(
    params: LawParams, gains: Mapping[str, Any], observer: ObserverGains, gains_before: Mapping[str, Any] | None = None
) -> Any:
    """Return the core's `dl_law_in_use`; without `gains_before` no earlier gains are left."""
    values = {"params": params, "gains": gains, "gains_before": gains_before or gains, "observer": {"gains": observer.rows}}
    return CORE.ffi.new("dl_law_in_use *", values)


def law_cycle(knowledge: Knowledge, body: BodyMotion, target: Target | None, dt: float, share: float, *, goes_on: bool) -> Any:
    """Return the core's `dl_law_cycle`; the knowledge has an estimate.

    Args:
        target: None while somebody else commands.
        dt: time since the cycle before, s.
        share: of the gains that are flown by, 0 to 1.
        goes_on: whether that cycle was not too long ago.
    """
    relative, deck, forecast = knowledge.relative, knowledge.deck, knowledge.forecast
    assert relative is not None
    cycle = CORE.ffi.new("dl_law_cycle *")
    cycle.goes_on, cycle.dt, cycle.share, cycle.heading_rad = goes_on, dt, share, body.heading_rad
    cycle.d, cycle.v = relative.d_body_pad_level.tolist(), relative.v_pad_level.tolist()
    cycle.a_body, cycle.w_body, cycle.lean = body.a_level.tolist(), body.w_body.tolist(), body.lean_m_s2
    if relative.yaw_rad is not None:
        cycle.has_yaw, cycle.yaw_rad = 1, relative.yaw_rad
    if forecast is not None:
        cycle.forecast_age_s = (knowledge.at - forecast.at) / 1e9
    if deck is not None:
        cycle.has_deck, cycle.v_deck, cycle.a_deck = 1, deck.v_level.tolist(), deck.a_level.tolist()
    if target is not None:
        _steer(cycle, target)
    return cycle


def _steer(cycle: Any, target: Target) -> None:
    cycle.steers, cycle.wanted = 1, target.d_body_pad_level.tolist()
    cycle.rate_max_m_s, cycle.speed_max_m_s = target.vertical_rate_max_m_s, target.speed_max_m_s
    if target.descent_rate_m_s is not None:
        cycle.has_rate, cycle.rate_m_s = 1, target.descent_rate_m_s
    if target.yaw_rad is not None:
        cycle.has_wanted_yaw, cycle.wanted_yaw_rad = 1, target.yaw_rad
    if target.lean_max_rad is not None:
        cycle.has_lean_max, cycle.lean_max_rad = 1, target.lean_max_rad


@lru_cache(maxsize=4)
def law_course(forecast: Forecast | None) -> Any:
    """Return the core's `dl_law_course` of a forecast, which serves some ten cycles."""
    if forecast is None:
        return CORE.ffi.new("dl_law_course *")
    horizons_s, rates_m_s = forecast.horizons_s.tolist(), forecast.v_pad_level.tolist()
    return CORE.ffi.new("dl_law_course *", {"n": len(horizons_s), "horizons_s": horizons_s, "rates_m_s": rates_m_s})
