"""The controller `follow_deck`: keep over the pad and follow the deck's heave, down to contact (docs/guidance.md).

Horizontally a disturbance observer (`disturbance`) and a regulator over tilt and commands under way (`tilt_law`), one axis at a
time; vertically a predictor with the deck's forecast. Everything horizontal is kept in axes that do not turn with the nose. The
native core steps it, estimator/core/law/law.c; here are the gains and when to go over from one set to another.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from companion.guidance.controller import Knowledge, Target
from companion.guidance.disturbance import SIGMAS_P_M, ObserverNoise, chosen, observer_gains
from companion.guidance.law_records import (
    COMMAND_SIZE,
    MEMORY_SIZE,
    LawRecord,
    packed_course,
    packed_cycle,
    packed_gains,
    packed_observer,
    packed_params,
)
from companion.guidance.pid import Pid
from companion.guidance.pid_controller import PidController
from companion.guidance.response_watch import DELAY_MAX_S
from companion.guidance.tilt_law import TiltWeights
from companion.guidance.tuning import AS_GIVEN, SOFTER_LONGER_S, TiltTuning, TuningChoice, chosen_tuning, tuned
from companion.guidance.view import FieldOfView
from companion.settings.response import Response
from estimator.contracts.commands import Command, Hover, Lean
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, fixed_pair, fixed_vector
from estimator.contracts.time import MonoNs, seconds_between
from estimator.core.library import CORE, start_of

_GAP_MAX_S = 0.5
"""A silence longer than this makes the observer begin again at what is measured; what it has learned of the wind it keeps."""
_BLEND_S = 1.0
"""Time in which the command goes over from one set of gains to another, s."""
_SOFT_BEYOND_M, _SOFT_UNTIL_M = 0.1, 0.05
"""Distance beside the wanted place beyond which a vehicle with a velocity loop of its own is flown by soft gains, and up to which
again. Such a vehicle limits the jerk of what it is asked for, ArduCopter to 5 m/s^3: from a quarter of a metre the full gains
asked for four times as much, and the loop swung wider and wider.
"""
_STEP = CORE.function("law_step")


class FollowDeckMemory(Struct, frozen=True, eq=False):
    """The controller's memory."""

    words: F64
    """The core's `law_memory`, whose axes are north and east by the filter's heading; the last command may follow it."""
    address: int
    """Of its first word."""
    at: MonoNs | None = None
    """When it was last stepped; None before the first cycle."""
    tuning: TuningChoice = AS_GIVEN
    """The gains that are flown by."""
    tuning_before: TuningChoice = AS_GIVEN
    """Those before them, from which the command goes over."""
    share: float = 1.0
    """Share of the former, 0 to 1."""
    plain: Pid = field(default_factory=Pid.start)
    """The memory of the fallback."""


class FollowDeck:
    """The controller. Gains are solved once for each response that is flown by: those of the file here, others when they are.

    Args:
        response: how the vehicle answers.
        period_s: the guidance period.
        view: the camera's field of view; None for no limit by it.
        noise: of the observer.
        forecast: whether the deck's motion is known ahead; without it the deck is followed from behind.
        delay_line: whether commands under way are known; without it the vehicle is taken to answer at once.
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
        noise: ObserverNoise | None = None,
        forecast: bool = True,
        delay_line: bool = True,
        fallback: PidController | None = None,
        over_ground: bool = False,
    ) -> None:
        self._fallback, self._over_ground = fallback, over_ground
        self.response, self.period_s = response, period_s
        self._delay_line = delay_line
        self._tunings: dict[TuningChoice, TiltTuning] = {}
        for soft in (False, True):
            self._tuning(TuningChoice(0.0, soft)).solve()
        longest_s = max(DELAY_MAX_S, response.tilt.delay_s, response.climb.delay_s)
        self._remembered = math.ceil((longest_s + SOFTER_LONGER_S) / period_s) + 1
        self._params = packed_params(
            response.tilt, response.climb, period_s, self._remembered, view, looks_ahead=forecast, over_ground=over_ground
        )
        self._observers = tuple(packed_observer(gains) for gains in observer_gains(noise or ObserverNoise(), period_s))
        self._packed: dict[tuple[TuningChoice, float], LawRecord] = {}

    @property
    def climb_max_m_s(self) -> float:
        """The fastest climb that it asks for, m/s."""
        return self.response.climb.max_m_s

    def start(self) -> FollowDeckMemory:
        """Return the memory before the first cycle."""
        words = np.zeros(MEMORY_SIZE)
        return FollowDeckMemory(words, start_of(words))

    def _tuning(self, choice: TuningChoice) -> TiltTuning:
        """Return the gains of a choice, kept once they are made."""
        if choice not in self._tunings:
            response, weights = tuned(self.response.tilt, TiltWeights(), choice)
            self._tunings[choice] = TiltTuning(response, weights, self.period_s, delay_line=self._delay_line)
        return self._tunings[choice]

    def _gains(self, choice: TuningChoice, sigma_p_m: float) -> LawRecord:
        """Return the gains of a choice for a standard deviation of the place as the core reads them.

        Raises:
            ValueError: commands are not remembered for as long as they are under way.
        """
        key = choice, chosen(SIGMAS_P_M, sigma_p_m)
        if key not in self._packed:
            tuning = self._tuning(choice)
            if tuning.under_way > self._remembered:
                raise ValueError(f"a command that acts after {tuning.under_way} periods is forgotten after {self._remembered}")
            # What delays the tilt longer than its file says delays the climb as well.
            climb_delay = round((self.response.climb.delay_s + choice.longer_s) / self.period_s)
            self._packed[key] = packed_gains(
                tuning.gains(sigma_p_m),
                tuning.under_way,
                max(1, min(self._remembered, climb_delay)),
                tuning.response.slowness_s,
            )
        return self._packed[key]

    def _wanted(self, memory: FollowDeckMemory, knowledge: Knowledge, target: Target | None) -> TuningChoice:
        """Return the gains to fly by."""
        wanted, relative = chosen_tuning(knowledge.response), knowledge.relative
        if not self._over_ground or target is None or relative is None:
            return wanted
        beside_m = math.dist(relative.d_body_pad_level.tolist()[:2], target.d_body_pad_level.tolist()[:2])
        far = beside_m > (_SOFT_UNTIL_M if memory.tuning.soft else _SOFT_BEYOND_M)
        return wanted._replace(soft=wanted.soft or far)

    def _retuned(self, memory: FollowDeckMemory, now: MonoNs, wanted: TuningChoice) -> FollowDeckMemory:
        """Return the memory with the gains that are wanted: at once before the first cycle, otherwise little by little."""
        if memory.at is None:
            return replace(memory, tuning=wanted, tuning_before=wanted, share=1.0)
        share = min(1.0, memory.share + max(0.0, seconds_between(memory.at, now)) / _BLEND_S)
        if share == 1.0 and wanted != memory.tuning:
            return replace(memory, tuning=wanted, tuning_before=memory.tuning, share=0.0)
        return memory if share == memory.share else replace(memory, share=share)

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
        memory = self._retuned(memory, now, self._wanted(memory, knowledge, target))
        sigma_m, share = _sigma_m(relative), memory.share
        gains = self._gains(memory.tuning, sigma_m)
        before = gains if share == 1.0 else self._gains(memory.tuning_before, sigma_m)
        dt = 0.0 if memory.at is None else seconds_between(memory.at, now)
        cycle = packed_cycle(knowledge, body, target, dt, share, goes_on=0.0 < dt <= _GAP_MAX_S)
        words = np.empty(MEMORY_SIZE + COMMAND_SIZE)
        start = start_of(words)
        _STEP(
            self._params.address, gains.address, before.address, chosen(self._observers, sigma_m).address, cycle,
            *packed_course(knowledge.forecast), memory.address, start, start + 8 * MEMORY_SIZE,
        )  # fmt: skip
        after = FollowDeckMemory(words, start, now, memory.tuning, memory.tuning_before, share, memory.plain)
        if target is None:
            return after, Hover()
        ahead, aside, trim_ahead, trim_aside, *v, turn = words[MEMORY_SIZE:].tolist()
        return after, Lean(fixed_pair(ahead, aside), fixed_pair(trim_ahead, trim_aside), fixed_vector(*v), turn)


def _sigma_m(relative: RelativeState) -> float:
    return math.sqrt(max(relative.cov.item(0, 0), relative.cov.item(1, 1), 0.0))
