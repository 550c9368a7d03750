"""The heading to the arrow: what counts as known, and a turn that no vehicle makes."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from companion.base.reason import Reason, ReasonCause
from companion.guidance.mission.progress import HeadingMemory, follow_arrow, heading_to_arrow_rad
from estimator.contracts.estimates import RelativeState
from tests.companion.mission_flights import estimate


def seen(yaw_rad: float | None, sigma_rad: float = 0.01) -> RelativeState:
    cov = np.eye(7)
    cov[6, 6] = sigma_rad**2
    return replace(estimate(1.0, (0.0, 0.0, 2.0)), yaw_rad=yaw_rad, cov=cov)


def test_the_first_heading_is_no_turn() -> None:
    assert follow_arrow(HeadingMemory(), seen(3.0)) == (HeadingMemory(3.0), None)


def test_an_estimate_without_a_heading_leaves_the_last_one() -> None:
    memory = HeadingMemory(1.0)
    assert follow_arrow(memory, seen(None)) == (memory, None)


@pytest.mark.parametrize(
    ("last_deg", "yaw_deg", "turn_deg"), [(0, 91, 91), (0, -91, 91), (135, -120, 105), (-60, 120, 180), (30, 125, 95)]
)
def test_more_than_a_quarter_turn_within_a_cycle_is_a_reason_and_reported_in_degrees(last_deg, yaw_deg, turn_deg):
    memory, reason = follow_arrow(HeadingMemory(math.radians(last_deg)), seen(math.radians(yaw_deg)))
    assert memory.last_rad == math.radians(yaw_deg)
    assert isinstance(reason, Reason)
    assert (reason.cause, reason.measured, reason.limit) == (
        ReasonCause.HEADING_TURNED, pytest.approx(turn_deg), pytest.approx(90.0),
    )  # fmt: skip


@pytest.mark.parametrize(("last_deg", "yaw_deg"), [(0, 90), (0, 0), (0, -89), (170, -170), (-135, 140)])
def test_less_than_that_is_none_across_the_half_turn_too(last_deg: float, yaw_deg: float) -> None:
    assert follow_arrow(HeadingMemory(math.radians(last_deg)), seen(math.radians(yaw_deg)))[1] is None


def test_nothing_turns_by_a_heading_that_is_unknown_or_unsure() -> None:
    assert heading_to_arrow_rad(seen(None)) is None
    assert heading_to_arrow_rad(seen(2.0, math.radians(20.1))) is None
    assert heading_to_arrow_rad(seen(2.0, math.radians(20.0))) == 0.0
    assert heading_to_arrow_rad(seen(-2.0)) == 0.0
