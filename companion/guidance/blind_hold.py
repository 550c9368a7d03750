"""Stay still against the deck without sight of the pad: by the carried-on estimate while it will do, then by the vessel's way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from companion.guidance.controller import Knowledge
from companion.guidance.limits import sigma_m
from companion.guidance.mission_options import TryOptions
from companion.guidance.situation import GuidanceCycle
from estimator.contracts.commands import Command, Hover, Lean, Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64
from estimator.contracts.time import seconds_between


def usable(s: GuidanceCycle, options: TryOptions, stale_after_s: float) -> RelativeState | None:
    """Return the estimate if it may be flown by without sight, else None."""
    estimate = s.estimate
    if estimate is None or not estimate.consistent or abs(seconds_between(estimate.at, s.at)) > stale_after_s:
        return None
    return estimate if sigma_m(estimate) <= options.blind_sigma_m else None


def vessel_velocity(knowledge: Knowledge) -> F64 | None:
    """Return the deck's horizontal velocity over the ground, (2,) m/s forward and right; None if nothing estimates it."""
    return None if knowledge.deck is None else knowledge.deck.v_level[:2]


def without_estimate(knowledge: Knowledge, climb_m_s: float, *, over_ground: bool) -> Command:
    """Return the command that stays with the deck, or climbs from it, where no estimate of the pad will do.

    Args:
        climb_m_s: rate upward; 0 to stay.
        over_ground: whether the vehicle's velocity is over the ground. A vehicle that measures it by optical flow over whatever
            is below it stays with the deck by its own hover while the deck is below it.
    """
    v = np.zeros(3)
    if over_ground and (vessel := vessel_velocity(knowledge)) is not None:
        v[:2] = vessel
    v[2] = -climb_m_s
    return Velocity(v, 0.0) if np.any(v != 0.0) else Hover()


def added(command: Command, v_level: F64) -> Velocity:
    """Return the velocity `v_level`, (3,) m/s, on top of a command that stays with the deck."""
    return Velocity(v_level + (command.v_level if isinstance(command, Velocity) else np.zeros(3)), 0.0)


def never_lower(command: Command, knowledge: Knowledge, *, fit: bool) -> Command:
    """Return the command without any descent beyond that of the deck itself, and without any if the estimate is not fit."""
    if not isinstance(command, Velocity | Lean):
        return command
    deck_m_s = 0.0 if knowledge.deck is None or not fit else max(0.0, float(knowledge.deck.v_level[2]))
    v = np.array(command.v_level)
    if v[2] <= deck_m_s:
        return command
    v[2] = deck_m_s
    return replace(command, v_level=v)
