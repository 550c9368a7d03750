"""The controller `policy`: a trained network leans the vehicle, and the law does the rest.

The mission orders each descent, so heights, climbs and heading stay the law's, and so does all where the estimator path knows no
motion of body or deck. The network's lean is cut as the law's is: by the view, by the vehicle's tilt, and by the target.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from companion.guidance.controller import Knowledge, Target
from companion.guidance.follow_deck import FollowDeck, FollowDeckMemory
from companion.guidance.policy import ACTIONS, F32, STEP_S, Policy, kept_share
from companion.guidance.view import FieldOfView
from estimator.contracts.commands import Command, Lean
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64
from estimator.contracts.motion import G_M_S2, BodyMotion, DeckMotion
from estimator.contracts.time import MonoNs, seconds_between

_OTHER = 0.3
"""A vehicle whose delay or frequency differs by this share from those of the training is another one."""
_AGE_MAX_S = 5.0
_VIEW_FROM_M, _LEAN_LEAST_M_S2, _OUT_RAD, _ANGLE_MOST_RAD = 0.6, 0.6, 0.1, 1.2
"""Limits as in the law (`keep_in_view` in estimator/core/law/law.c)."""


class PolicyMemory(Struct, frozen=True, eq=False):
    """The controller's memory."""

    law: FollowDeckMemory
    trim: tuple[float, float] = (0.0, 0.0)
    """The trim, m/s^2 forward and right."""
    action: tuple[float, ...] = (0.0,) * ACTIONS
    at: MonoNs | None = None


class PolicyController:
    """The controller.

    Args:
        policy: the network.
        law: keeps heights and heading.
        view: the camera's field of view; None for no limit by it.
        over_ground: whether the vehicle takes velocities over the ground.

    Raises:
        ValueError: the vehicle takes velocities and no tilt, it answers otherwise than the one of the training, or the guidance
            period is not the one of the training.
    """

    name = "policy"

    def __init__(self, policy: Policy, law: FollowDeck, view: FieldOfView | None = None, *, over_ground: bool = False) -> None:
        if over_ground:
            raise ValueError("a policy commands tilt, and this vehicle takes velocities")
        if abs(law.period_s - STEP_S) > 1e-3:
            raise ValueError(f"a policy needs guidance.rate_hz = {1.0 / STEP_S:g}")
        tilt, trained = law.response.tilt, policy.record.get("response", {})
        for key, flown in (("delay_s", tilt.delay_s), ("frequency_rad_s", tilt.frequency_rad_s)):
            if abs(flown - float(trained.get(key, flown))) > _OTHER * flown + 0.01:
                raise ValueError(f"the policy was trained for another vehicle: {key} = {trained[key]:g}, and here {flown:g}")
        self._policy, self._law, self._view = policy, law, view
        self._full_m_s2, self._place_m = policy.record["acceleration_m_s2"], policy.record["place_m"]

    @property
    def climb_max_m_s(self) -> float:
        """The fastest climb that it asks for, m/s."""
        return self._law.climb_max_m_s

    def start(self) -> PolicyMemory:
        """Return the memory before the first cycle."""
        return PolicyMemory(self._law.start())

    def ahead(self, memory: PolicyMemory, knowledge: Knowledge, seconds: float) -> None:
        """Return None: a network does not say where it leads."""

    def step(
        self, memory: PolicyMemory, now: MonoNs, knowledge: Knowledge, target: Target | None
    ) -> tuple[PolicyMemory, Command]:
        """Run one guidance cycle; `Hover` without a target or an estimate."""
        relative, body, deck = knowledge.relative, knowledge.body, knowledge.deck
        law, kept = self._law.step(memory.law, now, knowledge, target)
        memory = replace(memory, law=law)
        if body is not None:
            keep = 0.0 if memory.at is None else kept_share(seconds_between(memory.at, now))
            beyond = (lean - a for lean, a in zip(body.lean_m_s2, body.a_level.tolist(), strict=False))
            trim = [keep * old + (1.0 - keep) * new for old, new in zip(memory.trim, beyond, strict=True)]
            memory = replace(memory, trim=(trim[0], trim[1]), at=now)
        if target is None or relative is None or body is None or deck is None or not isinstance(kept, Lean):
            return memory, kept
        place = relative.d_body_pad_level - np.array([*target.d_body_pad_level[:2], 0.0])
        # It flies from farther away than it was trained for as from the edge of what it knows.
        place[:2] *= min(1.0, self._place_m / max(1e-9, math.hypot(*place[:2])))
        action = self._policy.act(observation(memory, place, relative, body, deck, now)[None])[0].astype(float)
        trim_level = np.array(memory.trim)
        lean = self._in_view(relative.d_body_pad_level, trim_level, self._full_m_s2 * action[:2] + trim_level)
        tilt_max_rad = math.radians(self._law.tilt_max_deg(knowledge))
        if target.lean_max_rad is not None:
            tilt_max_rad = min(tilt_max_rad, target.lean_max_rad)
        lean = _shortened(lean, trim_level, G_M_S2 * math.tan(tilt_max_rad))
        memory = replace(memory, action=tuple(action.tolist()))
        return memory, Lean(lean - trim_level, trim_level, kept.v_level, kept.yaw_rate_rad_s)

    def _in_view(self, d: F64, trim: F64, lean: F64) -> F64:
        """Return the lean with which the pad's centre stays in the picture."""
        if self._view is None or d[2] < _VIEW_FROM_M:
            return lean
        out = lean.copy()
        for i, (offset_m, half_rad) in enumerate(
            ((self._view.forward_m, self._view.half_forward_rad), (self._view.right_m, self._view.half_right_rad))
        ):
            bearing = math.atan2(float(d[i]) - offset_m, float(d[2]))
            if abs(bearing) > half_rad + _OUT_RAD:
                continue
            most = G_M_S2 * math.tan(max(0.0, min(_ANGLE_MOST_RAD, half_rad - bearing)))
            least = -G_M_S2 * math.tan(max(0.0, min(_ANGLE_MOST_RAD, half_rad + bearing)))
            out[i] = min(max(most, trim[i] + _LEAN_LEAST_M_S2), max(min(least, trim[i] - _LEAN_LEAST_M_S2), lean[i]))
        return out


def _shortened(lean: F64, trim: F64, most: float) -> F64:
    """Return the lean within the largest one; the trim against the wind comes first."""
    if math.hypot(*lean) <= most:
        return lean
    held = math.hypot(*trim)
    base = trim * (most / held if held > most else 1.0)
    more = lean - base
    a, b, c = float(more @ more), float(base @ more), max(0.0, most * most - float(base @ base))
    share = min(1.0, max(0.0, (math.sqrt(b * b + a * c) - b) / a)) if a > 0.0 else 0.0
    return np.asarray(base + share * more)


def observation(
    memory: PolicyMemory, place: F64, relative: RelativeState, body: BodyMotion, deck: DeckMotion, now: MonoNs
) -> F32:
    """Return the observation (21,), in the order of `view_number` in sitl/core/decklander_sim.h.

    Args:
        place: the pad, or another wanted place, from the body, (3,) m in `level`.
    """
    yaw = relative.yaw_rad or 0.0
    s, c = math.sin(yaw), math.cos(yaw)
    # The deck's normal along and across the body's heading, from its tilt along and across the arrow.
    along, across = math.sin(deck.pitch_rad), -math.sin(deck.roll_rad)
    tilt = (s * along - c * across, c * along + s * across)
    numbers = (
        *place, *relative.v_pad_level, *body.lean_m_s2, *memory.trim, deck.v_level[2], deck.a_level[2], *tilt, s, c,
        *memory.action, min(_AGE_MAX_S, relative.age_s(now)),
    )  # fmt: skip
    return np.array(numbers, np.float32)
