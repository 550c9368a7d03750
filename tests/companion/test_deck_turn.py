"""The nose follows the arrow of a ship that turns: the deck's rate is found and fed forward, and nothing winds up."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from companion.guidance.controller import Knowledge, Target
from companion.guidance.law.follow_deck import FollowDeck
from companion.settings.load import shipped_response
from estimator.contracts.commands import Lean
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import Rotation, wrap_pi
from estimator.contracts.motion import BodyMotion
from estimator.contracts.time import MonoNs

T = 0.02
ALONG = Target(np.array([0.0, 0.0, 1.0]), yaw_rad=0.0)


def turn_headings(turn_deg_s: float, off_deg: float, seconds: float, lag_s: float = 0.3, noise_deg: float = 0.0) -> list[float]:
    """Return the heading against the arrow, degrees, of a vehicle that takes up a turn rate with a lag."""
    law, rng = FollowDeck(shipped_response("ardrone2"), T), np.random.default_rng(4)
    memory, off, rate, out = law.start(), math.radians(off_deg), 0.0, []
    for k in range(round(seconds / T)):
        now = MonoNs(k * round(T * 1e9))
        seen = wrap_pi(off + math.radians(noise_deg) * rng.standard_normal())
        relative = RelativeState(now, "ekf", ALONG.d_body_pad_level, np.zeros(3), seen, 1e-4 * np.eye(7), now, True)
        body = BodyMotion(
            now, 0.0, np.zeros(3), 1e-4 * np.eye(3), np.array([0.0, 0.0, rate]), Rotation.identity(), 1e-4 * np.eye(3)
        )
        memory, command = law.step(memory, now, Knowledge(now, relative, body), ALONG)
        assert isinstance(command, Lean)
        rate += T / lag_s * (command.yaw_rate_rad_s - rate)
        off = wrap_pi(off + T * (rate - math.radians(turn_deg_s)))
        out.append(math.degrees(off))
    return out


@pytest.mark.parametrize("turn_deg_s", [-2.0, 0.0, 2.0, 5.0])
def test_the_nose_lies_on_the_arrow_of_a_ship_that_turns(turn_deg_s: float) -> None:
    course = turn_headings(turn_deg_s, -20.0, 30.0, noise_deg=0.5)
    assert max(abs(x) for x in course[-500:]) < 1.0


def test_coming_round_to_the_arrow_hardly_overshoots() -> None:
    course = turn_headings(0.0, 60.0, 20.0)
    assert min(course) > -3.0
    assert abs(course[-1]) < 0.3


def test_a_heading_that_is_not_known_requests_no_turn() -> None:
    law, now = FollowDeck(shipped_response("ardrone2"), T), MonoNs(0)
    body = BodyMotion(now, 0.0, np.zeros(3), 1e-4 * np.eye(3), np.zeros(3), Rotation.identity(), 1e-4 * np.eye(3))
    known = RelativeState(now, "ekf", ALONG.d_body_pad_level, np.zeros(3), 0.5, 1e-4 * np.eye(7), now, True)
    for relative, turns in ((known, True), (replace(known, yaw_rad=None), False)):
        _, command = law.step(law.start(), now, Knowledge(now, relative, body), ALONG)
        assert isinstance(command, Lean)
        assert (command.yaw_rate_rad_s != 0.0) == turns
    for astern in (math.pi, -math.pi):
        _, command = law.step(law.start(), now, Knowledge(now, replace(known, yaw_rad=astern), body), ALONG)
        assert isinstance(command, Lean)
        assert command.yaw_rate_rad_s == pytest.approx(0.6), "half a turn goes clockwise, whichever way it is written"
