"""Stay still against the deck without sight of the pad: by the carried-on estimate while it will do, then by the deck's way."""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace

from companion.guidance.controller import Knowledge
from companion.guidance.limits import sigma_m
from companion.guidance.situation import GuidanceCycle
from companion.settings.mission import TryOptions
from estimator.contracts.commands import Command, Hover, Lean, Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.time import seconds_between


def usable(s: GuidanceCycle, options: TryOptions, stale_after_s: float) -> RelativeState | None:
    """Return the estimate if it may be flown by without sight, else None."""
    estimate = s.estimate
    if estimate is None or not estimate.consistent or abs(seconds_between(estimate.at, s.at)) > stale_after_s:
        return None
    return estimate if sigma_m(estimate) <= options.blind_sigma_m else None


def without_estimate(climb_m_s: float, *, over_ground: bool) -> Command:
    """Return the command that stays with the deck, or climbs from it, where no estimate of the pad will do.

    Args:
        climb_m_s: rate upward; 0 to stay.
        over_ground: whether the vehicle's own hover holds over the ground. Its driver adds the deck's velocity to a velocity, so
            a velocity of zero stays with the deck. The hover of a vehicle that measures by optical flow stays with it by itself.
    """
    return Velocity(np.array([0.0, 0.0, -climb_m_s]), 0.0) if over_ground or climb_m_s != 0.0 else Hover()


def rising_m_s(knowledge: Knowledge) -> float:
    """Return how fast the deck rises, 0 where it falls or nothing is known of it."""
    return 0.0 if knowledge.deck is None else max(0.0, -float(knowledge.deck.v_level[2]))


def _falling_m_s(knowledge: Knowledge) -> float:
    """Return how fast the deck falls at least, with two standard deviations; 0 where it may rise."""
    deck = knowledge.deck
    return 0.0 if deck is None else max(0.0, deck.v_level.item(2) - 2.0 * math.sqrt(deck.cov_level.item(2, 2)))


def never_lower(command: Command, knowledge: Knowledge, *, fit: bool, over_ground: bool) -> Command:
    """Return the command without any descent beyond the deck's own as far as it is certain, and none if the estimate is unfit.

    Args:
        over_ground: whether the vehicle's driver adds the deck's velocity to a velocity.
    """
    if not isinstance(command, Velocity | Lean):
        return command
    added_later = over_ground and isinstance(command, Velocity)
    deck_m_s = 0.0 if not fit or added_later else _falling_m_s(knowledge)
    v = np.array(command.v_level)
    if v[2] <= deck_m_s:
        return command
    v[2] = deck_m_s
    return replace(command, v_level=v)


def climbing(command: Command, climb_m_s: float) -> Command:
    """Return the command with at least this climb: without sight an estimate that has risen by itself asks for none."""
    if not isinstance(command, Velocity | Lean) or command.v_level[2] <= -climb_m_s:
        return command
    v = np.array(command.v_level)
    v[2] = -climb_m_s
    return replace(command, v_level=v)
