"""The bounds within which a limit still does what it is for. The range of a key is what the code can compute with, and is wider.

A vehicle may have a reason to be beyond one; `config check`, `run --check` and `doctor` say so, and refuse nothing.
"""

import math
import operator
from collections.abc import Callable
from typing import NamedTuple

from companion.settings.load import pad_model
from companion.settings.model import Settings, in_file

_COMMIT_ADDS = 1.5
"""Place at the contact that a commit allows, over the gate's limit: a gust moves the vehicle so far before a climb avoids it."""


def rim_m(settings: Settings) -> float:
    """Return how far off the centre a vehicle of any heading may stand with all four feet on the pad, metres.

    Negative where the feet are wider than the pad.

    Raises:
        BadInput: the pad's file cannot be read.
    """
    return pad_model(settings).disc_radius_m - math.sqrt(2.0) * settings.guidance.cone.feet_aside_m


class Sound(NamedTuple):
    """The largest sound value of a key, and what happens beyond it."""

    key: str
    most: float | Callable[[Settings], float]
    beyond: str


SOUND = (
    Sound("guidance.cone.descent_rate_m_s", 1.5, "a rotor that descends faster flies into its own wake"),
    Sound("guidance.cone.commit_rate_m_s", 0.8, "small feet break at about 1 m/s, and the deck's own speed is added"),
    Sound("guidance.cone.gate_height_m", 1.0, "the commit goes on without a limit of the gate: the deck moves on its way"),
    Sound("guidance.cone.feet_below_m", 0.6, "the contact is expected so much above the deck: measure from the body's origin"),
    Sound("guidance.cone.feet_aside_m", lambda s: pad_model(s).disc_radius_m, "no foot is then on the pad"),
    Sound("guidance.limits.error_m", lambda s: rim_m(s) / _COMMIT_ADDS, "the feet nearly fill this pad: a gust puts one over it"),
    Sound("guidance.limits.sigma_m", rim_m, "nobody knows whether the feet are over the pad"),
    Sound("guidance.limits.relative_speed_m_s", 0.5, "a vehicle that touches at such a speed along the deck tips over its feet"),
    Sound("guidance.limits.commit_sighting_age_s", 3.0, "half a wave has passed since that sighting"),
    Sound("guidance.limits.deck_tilt_gate_deg", 8.0, "feet slide on a wet deck, and the rotors reach it on one side"),
    Sound("guidance.limits.deck_tilt_commit_deg", 8.0, "feet slide on a wet deck, and the rotors reach it on one side"),
    Sound("guidance.limits.deck_rate_m_s", 2.5, "the deck strikes the feet with so much more than the commit's rate"),
    Sound("guidance.limits.deck_rise_m", 0.5, "the deck overtakes a drone that climbs as fast as it can"),
    Sound("guidance.limits.deck_fall_m_s", 1.5, "the deck falls from under the feet, and the drone is in the air again"),
    Sound("guidance.limits.normalized_nis", 10.0, "the sightings contradict the filter three times as far as they claim"),
    Sound("guidance.tries.blind_s", 15.0, "dead reckoning is off by metres after that time"),
    Sound("guidance.tries.blind_sigma_m", 3.0, "what it flies by is as wide as the deck"),
    Sound("guidance.tries.climb_after_s", 3.0, "it stays low over a deck that it does not see for half a wave"),
    Sound("guidance.tries.losses_max", 30.0, "each loss is time low over the deck without sight"),
    Sound("guidance.stale_after_s", 2.0, "it flies by an estimate that is so old"),
)
"""The table. What a key means is in docs/configuration.md."""


def beyond_sound(settings: Settings) -> tuple[str, ...]:
    """Return a line for each limit that is wider than its own meaning allows.

    Raises:
        BadInput: the pad's file cannot be read.
    """
    lines = []
    for key, most, beyond in SOUND:
        value = operator.attrgetter(key)(settings)
        bound = most if isinstance(most, float) else most(settings)
        if value > bound:
            lines.append(f"{in_file(key)} is {value:g}, beyond {max(bound, 0.0):.3g}: {beyond}")
    return tuple(lines)
