"""The controller `follow_deck`: keep over the pad and follow the deck's heave, down to contact (docs/guidance.md).

Horizontally a disturbance observer (`disturbance`) and a regulator over tilt and commands under way (`tilt_law`), one axis at a
time; vertically a predictor with the deck's forecast. Everything horizontal is kept in axes that do not turn with the nose. The
native core steps it, estimator/core/law/law.c; here are the gains and when to go over from one set to another.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct, field, structs
from msgspec.structs import replace

from companion.base.observer import ResponseInUse, ResponseState
from companion.guidance.controller import FieldOfView, Knowledge, Target
from companion.guidance.law.gains import (
    SIGMAS_P_M,
    ObserverNoise,
    TiltGains,
    TiltWeights,
    chosen,
    law_course,
    law_cycle,
    law_gains,
    law_in_use,
    law_params,
    observer_gains,
    tilt_gains,
    tilt_model,
)
from companion.guidance.law.pid import Pid, PidController
from companion.guidance.law.response_watch import DELAY_MAX_S, shaped
from companion.settings.guidance import Response, TiltResponse
from estimator.contracts.commands import Command, Hover, Lean
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, fixed_pair, fixed_vector
from estimator.contracts.motion import BodyMotion
from estimator.contracts.time import MonoNs, seconds_between
from estimator.core.library import CORE

# The gains of the tilt for each response that may be flown by: the file's, softer until it is known, or with another delay.
#
# Softer gains let the place weigh a third and take the vehicle to answer 50 ms later than its file says: with the shipped
# AR.Drone they stand 196 ms of further delay instead of 92, and err by 2.8 cm a side instead of 1.8
# (`companion.guidance.law.margins`). A longer delay that is known takes gains of its own, with the place weighing less the longer
# it is, so that the margin of 60 ms is kept. So do another frequency and damping, with what `retuning` lets the place weigh.

_STIFF_M = 0.01
"""Standard deviation of the place up to which the regulator is as stiff as its weights say, m."""
_SOFTER = 0.02 / 0.006
"""Factor on the weight of the position while the response is only assumed."""
SOFTER_LONGER_S = 0.05
"""Further delay that is then assumed, s."""
_SOFTER_PER_S = 5.0
"""Loss of the position's weight for each second of further delay."""
_LONGEST_S = 0.6
"""Longest delay that a response may have, s."""
_STEP_S = 0.01
"""Delays are distinguished in steps of this, s."""
_GAP_MAX_S = 0.5
"""A silence longer than this restarts the observer at the measurement; it keeps its estimate of the wind."""
_CYCLE_S = 2.0  # time over which the length of a cycle is measured (docs/guidance.md)
_CYCLE_MAX_S = 0.18  # mean length of a cycle beyond which the vehicle hovers by itself (docs/guidance.md)
_LATE_S = 0.04  # time by which a cycle may be longer without a loss of the position's weight
_SOFTER_PER_LATE_S = 60.0  # that loss for each second more
_ROUGH_M_S2 = 0.8
"""Noise of a rough accelerometer, which has an observer of its own. Vibration of 0.5 m/s^2 stays below; PX4's simulated
quadcopter (SIH) has 0.5 to 1.7, by axis, as its source gives it (docs/guidance.md)."""
_ROUGH_S = 1.0  # time over which that noise is measured
_JOLT_M_S2 = 4.0
"""Largest change of a cycle that counts: a contact with the deck is no noise."""


class TuningChoice(NamedTuple):
    """Choice of gains."""

    longer_s: float = 0.0
    """Delay beyond the one of the response file."""
    soft: bool = False
    frequency: float = 1.0
    damping: float = 1.0
    """Factors on those of the response file."""
    softer: float = 1.0
    """Factor by which the place weighs less."""
    periods: int = 1
    """Guidance periods that a cycle takes: gains of a quick one swing the vehicle wider and wider in slow ones."""


AS_GIVEN = TuningChoice()
"""The response file as it is."""


def chosen_tuning(in_use: ResponseInUse | None) -> TuningChoice:
    """Return the gains for the response in use; None flies by the file as it is."""
    if in_use is None:
        return AS_GIVEN
    longer_s, soft = _STEP_S * round(in_use.longer_s / _STEP_S), in_use.state is ResponseState.ASSUMED
    return TuningChoice(longer_s, soft, in_use.shape.slow, in_use.shape.damping, in_use.shape.softer)


def tuned(given: TiltResponse, weights: TiltWeights, choice: TuningChoice) -> tuple[TiltResponse, TiltWeights]:
    """Return the response that the gains are made for, and their weights."""
    longer = choice.longer_s + (SOFTER_LONGER_S if choice.soft else 0.0)
    delay_s = min(_LONGEST_S, max(0.0, given.delay_s + longer))
    softer = (_SOFTER if choice.soft else choice.softer) * (1.0 + _SOFTER_PER_S * max(0.0, choice.longer_s))
    return structs.replace(shaped(given, choice.frequency, choice.damping), delay_s=delay_s), weights._replace(
        p_m=weights.p_m * softer
    )


class TiltTuning:
    """One response with its gains, each solved when it is first requested.

    Args:
        response, weights: of `tuned`.
        period_s: the guidance period.
        periods: how many of them a cycle takes.
    """

    def __init__(self, response: TiltResponse, weights: TiltWeights, period_s: float, periods: int) -> None:
        self.response, self.periods = response, periods
        self.under_way = max(1, math.ceil(response.delay_s / period_s - 1e-9))
        self._weights, self._period_s = weights, periods * period_s
        self._solved: dict[float, TiltGains] = {}
        self._after: dict[tuple[float, int], F64] = {}

    def gains(self, sigma_p_m: float) -> TiltGains:
        """Return the gains for a standard deviation of the place: the worse it is known, the softer."""
        # Higher up the place is known to decimetres, and a stiff loop would only fly after its errors.
        sigma = chosen(SIGMAS_P_M, sigma_p_m)
        if sigma not in self._solved:
            weights = self._weights._replace(p_m=self._weights.p_m * max(1.0, sigma / _STIFF_M))
            self._solved[sigma] = tilt_gains(self.response, weights, self._period_s)
        return self._solved[sigma]

    def after(self, sigma_p_m: float, seconds: float) -> F64:
        """Return what leads from the state of the closed loop to place and speed so many seconds later, (2, n)."""
        key = chosen(SIGMAS_P_M, sigma_p_m), (cycles := max(0, round(seconds / self._period_s)))
        if key not in self._after:
            model = tilt_model(self.response, self._period_s)
            gains = self.gains(key[0])
            lag = (gains.lag,) if model.states == 5 else ()
            K = np.array([gains.p, gains.w, gains.a, gains.rate, *lag, *gains.under_way])
            self._after[key] = np.linalg.matrix_power(model.A - np.outer(model.B, K), cycles)[:2]
        return self._after[key]

    def state(self, axis: Any, aim_m: float, a_deck: float) -> F64:
        """Return the state of the closed loop: an axis of the core's memory less the aim and what holds it over the deck."""
        reference = a_deck - axis.d
        lag = (axis.lag - reference,) if self.response.lag_s else ()
        under_way = [axis.under_way[k] - reference for k in range(0, self.under_way, self.periods)]
        return np.array([axis.p - aim_m, axis.w, axis.lean - reference, axis.rate, *lag, *under_way])

    def solve(self) -> TiltTuning:
        """Solve all gains beforehand.

        Raises:
            ValueError: there are no gains that stabilise such a vehicle.
        """
        for sigma in SIGMAS_P_M:
            self.gains(sigma)
        return self


_PERIODS = (1, 2, 3, 4, 6, 8, 12, 16, 24)
"""Lengths of a cycle for which there are gains, in guidance periods."""


class FollowDeckMemory(Struct, frozen=True, eq=False):
    """The controller's memory."""

    core: Any
    """The core's `dl_law_memory`, whose axes are north and east by the filter's heading."""
    at: MonoNs | None = None
    """Time of the last step; None before the first cycle."""
    tuning: TuningChoice = AS_GIVEN
    """The gains that are flown by."""
    tuning_before: TuningChoice = AS_GIVEN
    """The previous gains, from which the command fades over."""
    share: float = 1.0
    """Share of the former, 0 to 1."""
    plain: Pid = field(default_factory=Pid)
    """The memory of the fallback."""
    felt: tuple[float, float] = (0.0, 0.0)
    """The measured acceleration less that of the tilt, forward and right, m/s^2."""
    noise_var: float = 0.0
    """Mean variance of its noise, by what changes from cycle to cycle, (m/s^2)^2."""
    cycle_s: float = 0.0
    """Mean length of a cycle, each weighing as long as it takes, s."""


class FollowDeck:
    """The controller. Gains are solved once for each response that is flown by: those of the file here, others when they are.

    Args:
        response: how the vehicle answers.
        period_s: the guidance period.
        view: the camera's field of view; None for no limit by it.
        fallback: flies where the estimator path knows nothing of the body's motion.
        over_ground: whether the vehicle takes velocities over the ground with an acceleration, and cancels wind by itself.

    Raises:
        ValueError: there are no gains that stabilise such a vehicle, or the period is shorter than 5 ms.
    """

    name = "follow_deck"

    def __init__(
        self,
        response: Response,
        period_s: float,
        view: FieldOfView | None = None,
        *,
        fallback: PidController | None = None,
        over_ground: bool = False,
    ) -> None:
        self._fallback, self._over_ground = fallback, over_ground
        self.response, self.period_s = response, period_s
        self._tunings: dict[TuningChoice, TiltTuning] = {}
        for soft in (False, True):
            self._tuning(TuningChoice(0.0, soft)).solve()
        longest_s = max(DELAY_MAX_S, response.tilt.delay_s, response.climb.delay_s)
        self._remembered = math.ceil((longest_s + SOFTER_LONGER_S) / period_s) + 1
        self._params = law_params(response.tilt, response.climb, period_s, self._remembered, view, over_ground=over_ground)
        self._in_use: dict[tuple[TuningChoice, TuningChoice, float, float, tuple[float, float], bool, bool], Any] = {}

    @property
    def climb_max_m_s(self) -> float:
        """The fastest climb that it requests, m/s."""
        return self.response.climb.max_m_s

    def start(self) -> FollowDeckMemory:
        """Return the memory before the first cycle."""
        return FollowDeckMemory(CORE.ffi.new("dl_law_memory *"))

    def _tuning(self, choice: TuningChoice) -> TiltTuning:
        """Return the gains of a choice, kept once they are made."""
        if choice not in self._tunings:
            response, weights = tuned(self.response.tilt, TiltWeights(), choice)
            late_s = max(0.0, (choice.periods - 1) * self.period_s - _LATE_S)
            weights = weights._replace(p_m=weights.p_m * (1.0 + _SOFTER_PER_LATE_S * late_s))
            self._tunings[choice] = TiltTuning(response, weights, self.period_s, choice.periods)
        return self._tunings[choice]

    def tilt_max_deg(self, knowledge: Knowledge) -> float:
        """Return the largest tilt to ask for: by the vehicle's own word before its file's."""
        return knowledge.tilt_max_deg or self.response.tilt.max_deg

    def _law(self, memory: FollowDeckMemory, sigma_p_m: float, soft_m: float, knowledge: Knowledge) -> Any:
        """Return the law as the core reads it, kept once it is made.

        Args:
            sigma_p_m: standard deviation of the place, by which it is observed.
            soft_m: the one for which gains are as soft as they are to be.
            knowledge: has the vehicle's limits, and whether its accelerometer is lost.

        Raises:
            ValueError: as `_gains`.
        """
        before = memory.tuning if memory.share == 1.0 else memory.tuning_before
        limits, unfelt = (self._jerk_max_m_s3(knowledge), self.tilt_max_deg(knowledge)), knowledge.unfelt
        rough = memory.noise_var > _ROUGH_M_S2**2
        key = memory.tuning, before, chosen(SIGMAS_P_M, sigma_p_m), chosen(SIGMAS_P_M, soft_m), limits, unfelt, rough
        if key not in self._in_use:
            gains, earlier = self._gains(memory.tuning, soft_m), self._gains(before, soft_m)
            felt = {"accelerometer": False} if unfelt else {"sigma_a_m_s2": _ROUGH_M_S2} if rough else {}
            observers = observer_gains(ObserverNoise(**felt), memory.tuning.periods * self.period_s)
            of = self._tuning(memory.tuning).response
            tilt_max_m_s2 = replace(self.response.tilt, max_deg=limits[1]).max_m_s2
            own = {"frequency_rad_s": of.frequency_rad_s, "damping": of.damping}
            params = {**self._params, **own, "jerk_max_m_s3": limits[0], "tilt_max_m_s2": tilt_max_m_s2}
            self._in_use[key] = law_in_use(params, gains, chosen(observers, sigma_p_m), earlier)
        return self._in_use[key]

    def _gains(self, choice: TuningChoice, sigma_p_m: float) -> Mapping[str, Any]:
        """Return the gains of a choice for a standard deviation of the place as the core reads them.

        Raises:
            ValueError: commands are not remembered for as long as they are under way.
        """
        tuning = self._tuning(choice)
        if tuning.under_way > self._remembered:
            raise ValueError(f"a command that acts after {tuning.under_way} periods is forgotten after {self._remembered}")
        # What delays the tilt longer than its file says delays the climb as well.
        climb_delay = round((self.response.climb.delay_s + choice.longer_s) / self.period_s)
        gains = tuning.gains(sigma_p_m)
        between = (0.0,) * (choice.periods - 1)
        gains = gains._replace(under_way=tuple(one for gain in gains.under_way for one in (gain, *between))[: self._remembered])
        return law_gains(gains, tuning.under_way, max(1, min(self._remembered, climb_delay)), tuning.response.slowness_s)

    def _jerk_max_m_s3(self, knowledge: Knowledge) -> float:
        """Return the limit of the jerk, 0 without one: the vehicle's own word before its file's."""
        return knowledge.jerk_max_m_s3 or self.response.tilt.jerk_max_m_s3 or 0.0

    def _soft_m(
        self, memory: FollowDeckMemory, knowledge: Knowledge, relative: RelativeState, over: tuple[float, float]
    ) -> float:
        """Return the standard deviation of the place for which gains ask for no more jerk than the vehicle follows.

        A loop with a limited input and two integrators or more swings wider and wider from a large error if it is stiff (Sussmann
        & Yang, CDC 1991); with gains that fall as the error grows it comes back from any (Megretski, IFAC 1996).

        Args:
            over: wanted place of the pad, forward and right, m.
        """
        sigma, jerk_m_s3 = _sigma_m(relative), self._jerk_max_m_s3(knowledge)
        if jerk_m_s3 == 0.0:
            return sigma
        tuning = self._tuning(memory.tuning)
        beside_m = math.dist(relative.d_body_pad_level.tolist()[:2], over)
        fast_m_s = math.hypot(*relative.v_pad_level.tolist()[:2])
        for soft_m in (one for one in SIGMAS_P_M if one >= sigma):
            stiff = abs(tuning.gains(soft_m).p)
            if stiff * math.hypot(math.sqrt(stiff) * beside_m, fast_m_s) <= jerk_m_s3:
                return soft_m
        return max(sigma, SIGMAS_P_M[-1])

    def _retuned(self, memory: FollowDeckMemory, now: MonoNs, wanted: TuningChoice) -> FollowDeckMemory:
        """Return the memory with the gains that are wanted: at once before the first cycle, otherwise little by little in 1 s."""
        if memory.at is None:
            return replace(memory, tuning=wanted)
        share = min(1.0, memory.share + max(0.0, seconds_between(memory.at, now)))
        if share == 1.0 and wanted != memory.tuning:
            return replace(memory, tuning=wanted, tuning_before=memory.tuning, share=0.0)
        return replace(memory, share=share)

    def ahead(self, memory: FollowDeckMemory, knowledge: Knowledge, seconds: float) -> tuple[float, float] | None:
        """Return where the loop has taken the vehicle after so many seconds: distance from the aim, m, and speed, m/s.

        The push of the air and the deck's acceleration stay as they are.
        """
        relative, body = knowledge.relative, knowledge.body
        if memory.at is None or relative is None or body is None:
            return None
        tuning = self._tuning(memory.tuning)
        a_deck = (0.0, 0.0) if knowledge.deck is None else tuple(knowledge.deck.a_level.tolist()[:2])
        c, s = math.cos(body.heading_rad), math.sin(body.heading_rad)
        a_ned, aim_ned = ((c * x - s * y, s * x + c * y) for x, y in (a_deck, knowledge.aim_level))
        soft_m = self._soft_m(memory, knowledge, relative, knowledge.aim_level)
        after = tuning.after(soft_m, seconds)
        (p_n, w_n), (p_e, w_e) = (
            (after @ tuning.state(memory.core.axes[axis], aim_ned[axis], a_ned[axis])).tolist() for axis in range(2)
        )
        return math.hypot(p_n, p_e), math.hypot(w_n, w_e)

    def step(
        self, memory: FollowDeckMemory, now: MonoNs, knowledge: Knowledge, target: Target | None
    ) -> tuple[FollowDeckMemory, Command]:
        """Run one guidance cycle; `Hover` without a target, or without an estimate."""
        body, relative = knowledge.body, knowledge.relative
        if relative is None or (body is None and self._fallback is None):
            return memory, Hover()
        if body is None:
            assert self._fallback is not None
            plain, given = self._fallback.step(memory.plain, now, knowledge, target)
            return replace(memory, plain=plain), given
        cycles = memory.cycle_s / self.period_s
        wanted = chosen_tuning(knowledge.response)._replace(periods=min(_PERIODS, key=lambda n: abs(n - cycles)))
        memory = _felt(self._retuned(memory, now, wanted), now, body)
        target = target if memory.cycle_s <= _CYCLE_MAX_S else None
        over = (0.0, 0.0) if target is None else (target.d_body_pad_level.item(0), target.d_body_pad_level.item(1))
        soft_m = self._soft_m(memory, knowledge, relative, over)
        law, share = self._law(memory, _sigma_m(relative), soft_m, knowledge), memory.share
        dt = 0.0 if memory.at is None else seconds_between(memory.at, now)
        cycle = law_cycle(knowledge, body, target, dt, share, goes_on=0.0 < dt <= _GAP_MAX_S)
        core, out = CORE.ffi.new("dl_law_memory *"), CORE.ffi.new("dl_law_command *")
        if not CORE.lib.dl_law_step(law, cycle, law_course(knowledge.forecast), memory.core, core, out):
            raise ValueError("the law has no room for its commands")
        after = replace(memory, core=core, at=now, share=share)
        if target is None:
            return after, Hover()
        return after, Lean(fixed_pair(*out.a), fixed_pair(*out.trim), fixed_vector(*out.v), out.yaw_rate_rad_s)


def _felt(memory: FollowDeckMemory, now: MonoNs, body: BodyMotion) -> FollowDeckMemory:
    """Return the memory with a cycle's length and the accelerometer's noise; gusts and tilts hardly change in one cycle."""
    (forward, right, _), (lean_f, lean_r) = body.a_level.tolist(), body.lean_m_s2
    felt, noise_var, cycle_s = (forward - lean_f, right - lean_r), memory.noise_var, memory.cycle_s
    dt = 0.0 if memory.at is None else max(0.0, seconds_between(memory.at, now))
    cycle_s += min(dt, _GAP_MAX_S) / _CYCLE_S * (min(dt, _GAP_MAX_S) - cycle_s)
    if 0.0 < dt <= _GAP_MAX_S:
        change = min(math.dist(felt, memory.felt), _JOLT_M_S2)
        noise_var += min(dt / _ROUGH_S, 1.0) * (0.25 * change * change - noise_var)
    return replace(memory, felt=felt, noise_var=noise_var, cycle_s=cycle_s)


def _sigma_m(relative: RelativeState) -> float:
    return math.sqrt(max(relative.cov.item(0, 0), relative.cov.item(1, 1), 0.0))
