"""The position controller at each of its edges: one guidance cycle from a given memory."""

import math

import numpy as np
import pytest
from msgspec import structs

from companion.guidance.pid import Pid, SetPoint, fit_to_steer, pid_step
from companion.settings.guidance import GuidanceOptions, HeadingGains, HorizontalGains, PidOptions, VerticalGains
from estimator.contracts.commands import Hover, Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs

NOW = 100.0
STALE_S = GuidanceOptions().stale_after_s
FREE = PidOptions(
    HorizontalGains(0.0, 0.0, 0.0),
    VerticalGains(0.0, 0.0, 0.0),
    HeadingGains(0.0, 0.0),
    100.0,
    100.0,
    100.0,
    math.degrees(100.0),
    100.0,
    1000.0,
)
"""No gains, and no limit that a test comes near."""
INTEGRAL = structs.replace(
    FREE, horizontal=HorizontalGains(0.0, 1.0, 0.0), vertical=VerticalGains(0.0, 1.0, 0.0), heading=HeadingGains(0.0, 1.0)
)


def at(seconds: float) -> MonoNs:
    return MonoNs(round(seconds * 1e9))


def belief(
    d: tuple[float, float, float], v: tuple[float, float, float] = (0.0, 0.0, 0.0), yaw_rad: float | None = 0.0,
    age_s: float = 0.0, computed_s: float = 0.0,
) -> RelativeState:  # fmt: skip
    return RelativeState(
        at(NOW - computed_s), "ekf", np.array(d), np.array(v), yaw_rad, 1e-4 * np.eye(7), at(NOW - age_s), True
    )  # fmt: skip


def above(height_m: float, yaw_rad: float | None = 0.0) -> SetPoint:
    return SetPoint(np.array([0.0, 0.0, height_m]), yaw_rad)


def cycle(gains: PidOptions, estimate: RelativeState, to: SetPoint, state: Pid | None = None) -> tuple[Pid, list[float]]:
    """Return the new memory; the command forward, right, down, and its rate of turn."""
    after, command = pid_step(Pid.start() if state is None else state, gains, at(NOW), estimate, to, STALE_S)
    assert isinstance(command, Velocity)
    return after, [*command.v_level.tolist(), command.yaw_rate_rad_s]


def test_a_set_point_stands_still_and_keeps_the_heading_where_it_does_not_say_otherwise() -> None:
    point = SetPoint(np.array([0.0, 0.0, 2.0]))
    assert point.yaw_rad is None
    assert point.v_body_level.tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("d", "yaw_rad", "v"),
    [
        (np.zeros(2), None, np.zeros(3)), (np.array([0.0, math.nan, 2.0]), None, np.zeros(3)), (np.zeros(3), None, np.zeros(2)),
        (np.zeros(3), None, np.array([math.inf, 0.0, 0.0])), (np.zeros(3), math.nan, np.zeros(3)),
        (np.zeros(3), -math.inf, np.zeros(3)),
    ],
)  # fmt: skip
def test_a_set_point_that_is_no_place_is_refused(d: F64, yaw_rad: float | None, v: F64) -> None:
    with pytest.raises(ValueError, match="SetPoint"):
        SetPoint(d, yaw_rad, v)


@pytest.mark.parametrize("gains", [(-1e-9, 1.0, 1.0), (1.0, -1e-9, 1.0), (1.0, 1.0, -1e-9), (math.nan, 1.0, 1.0)])
def test_gains_may_be_zero_and_not_less(gains: tuple[float, float, float]) -> None:
    HorizontalGains(0.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="Gains"):
        HorizontalGains(*gains)


def test_a_command_within_the_limits_is_left_alone() -> None:
    gains = PidOptions(HorizontalGains(1.0, 0.0, 0.0), VerticalGains(1.0, 0.0, 0.0), HeadingGains(1.0, 0.0))
    assert cycle(gains, belief((0.3, -0.4, 1.5)), above(1.0, 0.6))[1] == pytest.approx([0.3, -0.4, 0.5, 0.6])
    assert cycle(gains, belief((0.0, 0.0, 1.0)), above(1.0))[1] == [0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(("height_m", "share"), [(2.4, 1.0), (2.5, 1.0), (5.0, 0.5), (25.0, 0.1), (50.0, 0.1)])
def test_high_up_every_horizontal_gain_is_softer_and_no_other(height_m: float, share: float) -> None:
    gains = structs.replace(
        FREE,
        horizontal=HorizontalGains(1.0, 1.0, 1.0),
        vertical=VerticalGains(1.0, 1.0, 1.0),
        heading=HeadingGains(1.0, 1.0),
        soft_above_m=2.5,
    )
    for d, v, integral in (
        ((0.1, 0.1, 0.1), (0.0, 0.0, 0.0), 0.0),
        ((0.0, 0.0, 0.0), (0.1, 0.1, 0.1), 0.0),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.1),
    ):
        seen = belief((d[0], d[1], height_m + d[2]), v)
        _, command = cycle(gains, seen, above(height_m), Pid(np.full(4, integral), at(NOW)))
        assert command[:3] == pytest.approx([0.1 * share, 0.1 * share, 0.1])
        assert command[3] == pytest.approx(integral)


@pytest.mark.parametrize(("since_s", "dt_s"), [(0.0, 0.0), (0.1, 0.1), (0.2, 0.2), (0.3, 0.2), (2.0, 0.2), (-1.0, 0.0)])
def test_no_cycle_adds_more_to_the_integrals_than_a_short_time(since_s: float, dt_s: float) -> None:
    state, _ = cycle(INTEGRAL, belief((1.0, -2.0, 4.0)), above(1.0, 0.5), Pid(np.ones(4), at(NOW - since_s)))
    assert state.integral == pytest.approx([1.0 + dt_s, 1.0 - 2.0 * dt_s, 1.0 + 3.0 * dt_s, 1.0 + 0.5 * dt_s])
    assert state.last == at(NOW)


def test_the_first_cycle_integrates_nothing() -> None:
    assert cycle(INTEGRAL, belief((1.0, -2.0, 4.0)), above(1.0, 0.5))[0].integral.tolist() == [0.0] * 4


@pytest.mark.parametrize(("silent_s", "kept"), [(2.0, True), (2.001, False)])
def test_integrals_are_forgotten_after_two_seconds_of_silence_and_no_sooner(silent_s: float, kept: bool) -> None:
    before = Pid(np.full(4, 0.25), at(NOW - silent_s))
    hovering, command = pid_step(before, PidOptions(), at(NOW), None, above(1.0), STALE_S)
    assert command == Hover()
    assert np.all(hovering.integral == (0.25 if kept else 0.0))
    assert hovering.last == (before.last if kept else None)
    steering, _ = cycle(INTEGRAL, belief((0.0, 0.0, 1.0)), above(1.0), before)
    assert steering.integral.tolist() == [0.25 if kept else 0.0] * 4
    assert pid_step(Pid(np.ones(4)), PidOptions(), at(NOW), None, above(1.0), STALE_S)[0].integral.tolist() == [1.0] * 4


@pytest.mark.parametrize("age", ["age_s", "computed_s"])
def test_an_estimate_is_steered_by_up_to_its_age_on_either_side_of_now(age: str) -> None:
    for sign in (1.0, -1.0):
        for age_s, fit in ((1.0, True), (1.001, False)):
            seen = belief((0.0, 0.0, 1.0), **{age: sign * age_s})  # type: ignore[arg-type]
            assert fit_to_steer(seen, at(NOW), 1.0) is fit
            assert isinstance(pid_step(Pid.start(), PidOptions(), at(NOW), seen, above(1.0), 1.0)[1], Velocity) is fit
    assert not fit_to_steer(structs.replace(belief((0.0, 0.0, 1.0)), consistent=False), at(NOW), 1.0)


@pytest.mark.parametrize(("seen", "wanted", "turns"), [(None, 1.0, False), (0.5, None, False), (0.5, 1.0, True)])
def test_it_turns_where_both_headings_are_known(seen: float | None, wanted: float | None, turns: bool) -> None:
    _, command = cycle(PidOptions(), belief((0.0, 0.0, 1.0), yaw_rad=seen), above(1.0, wanted))
    assert command[3] == pytest.approx(0.4 if turns else 0.0)


def test_an_axis_at_its_limit_integrates_only_what_leads_out_of_it() -> None:
    gains = structs.replace(FREE, vertical=VerticalGains(1.0, 1.0, 0.0), descent_rate_max_m_s=0.5, climb_max_m_s=0.5)
    for height_m, integral, after in (
        (2.0, 0.0, 0.0),
        (1.25, 0.0, 0.025),
        (0.75, 2.0, 1.975),
        (1.5, -5.0, -4.95),
        (0.0, 0.0, 0.0),
    ):
        state, _ = cycle(gains, belief((0.0, 0.0, height_m)), above(1.0), Pid(np.array([0.0, 0.0, integral, 0.0]), at(NOW - 0.1)))
        assert state.integral[2] == pytest.approx(after)


def test_an_axis_without_an_integral_gain_keeps_none() -> None:
    state, _ = cycle(FREE, belief((1.0, 1.0, 2.0)), above(1.0, 1.0), Pid(np.ones(4), at(NOW - 0.1)))
    assert state.integral.tolist() == [0.0] * 4


def test_a_set_point_that_flies_takes_the_drone_along_and_damps_only_what_differs_from_it() -> None:
    flying = SetPoint(np.array([0.0, 0.0, 1.0]), 0.0, np.array([0.25, -0.5, 0.125]))
    gains = structs.replace(FREE, horizontal=HorizontalGains(0.0, 0.0, 1.0), vertical=VerticalGains(0.0, 0.0, 1.0))
    assert cycle(gains, belief((0.0, 0.0, 1.0), (-0.25, 0.5, -0.125)), flying)[1] == [0.25, -0.5, 0.125, 0.0]
    assert cycle(gains, belief((0.0, 0.0, 1.0)), flying)[1] == [0.5, -1.0, 0.25, 0.0]
